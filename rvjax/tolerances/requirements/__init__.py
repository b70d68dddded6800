"""Kinds of requirements on a response."""
