"""Probabilities of rare failures."""
