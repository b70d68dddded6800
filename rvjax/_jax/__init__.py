"""All code that depends on internals of JAX or tunes its compiler; each part names its measured gain."""
