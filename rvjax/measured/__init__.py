"""Measurements of a bench: transmission error, hysteresis, natural frequencies. Independent of gears."""

from rvjax.measured.branches import GRID as GRID
from rvjax.measured.conditions import DIRECTIONS as DIRECTIONS, Conditions
from rvjax.measured.curve import checked as checked
from rvjax.measured.findings import findings as findings, foreign as foreign
from rvjax.measured.fit import Fitted as Fitted, fitted as fitted
from rvjax.measured.judge import MOTOR as MOTOR, Judged as Judged, judge as judge
from rvjax.measured.kind import Finding as Finding, Kind as Kind
from rvjax.measured.loop import Loop
from rvjax.measured.read import KINDS as KINDS, Measured, read, read_table as read_table
from rvjax.measured.run import Run
from rvjax.measured.tones import Tones

__all__ = ["Conditions", "Loop", "Measured", "Run", "Tones", "read"]
