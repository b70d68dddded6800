"""`rvjax assemble`: from a list of measured parts to the list of units for the bench."""

from rvjax.commands.assemble.compute import Price as Price, prices as prices
from rvjax.commands.assemble.inputs import Assembly as Assembly
from rvjax.commands.assemble.parts import Bench as Bench, bench as bench
