"""`rvjax identify`: from what a bench measured of a unit to the errors of its parts."""

from rvjax.commands.identify.compute import Identified, answer, check
from rvjax.commands.identify.words import direction_lines, elements, headline, in_words, next_lines, verdict_line

__all__ = [
    "Identified",
    "answer",
    "check",
    "direction_lines",
    "elements",
    "headline",
    "in_words",
    "next_lines",
    "verdict_line",
]
