"""`rvjax compensate`: from measured curves of the transmission error to the tables of a controller."""

from rvjax.commands.compensate.compute import Corrections, Curve, corrections

__all__ = ["Corrections", "Curve", "corrections"]
