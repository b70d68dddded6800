"""Foundation of all packages: words, shapes, printing, files and progress; no JAX program and no reducer."""
