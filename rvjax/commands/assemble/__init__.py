"""`rvjax assemble`: from a list of measured parts to the list of units for the bench."""

from rvjax.commands.assemble.inputs import Assembly
from rvjax.commands.assemble.parts import Bench, bench
from rvjax.commands.assemble.prices import Price, prices

__all__ = ["Assembly", "Bench", "Price", "bench", "prices"]
