"""All code that depends on internals of JAX or tunes its compiler; each file states how it works and its gain."""
