"""`rvjax identify`: errors of the parts of a unit from bench measurements."""

from rvjax.commands.identify.compute import Identified as Identified, answer as answer, check as check
from rvjax.commands.identify.words import (
    combinations as combinations,
    elements as elements,
    headline as headline,
    in_words as in_words,
    next_lines as next_lines,
    rounded as rounded,
    verdict_line as verdict_line,
)
