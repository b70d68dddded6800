"""Comparison with the literature: the ledger of published values and their computation."""

from rvjax.published.ledger import SOURCES, Comparison, compare, figures, ours, parse, reproduce, show

__all__ = ["SOURCES", "Comparison", "compare", "figures", "ours", "parse", "reproduce", "show"]
