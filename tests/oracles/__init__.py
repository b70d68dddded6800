"""Independent implementations of the models, which tests, census and benchmarks share."""
