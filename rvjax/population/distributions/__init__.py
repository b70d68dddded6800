"""The distributions of part errors."""
