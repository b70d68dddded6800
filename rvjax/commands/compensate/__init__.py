"""`rvjax compensate`: from measured curves of the transmission error to the tables of a controller."""

from rvjax.commands.compensate.compute import Corrections as Corrections, Curve as Curve, corrections as corrections
