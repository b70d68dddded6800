"""Measurements of a bench: transmission error, hysteresis, natural frequencies. Independent of gears."""

from rvjax.measured.branches import GRID as GRID
from rvjax.measured.curve_analysis import (
    MOTOR as MOTOR,
    Judged as Judged,
    findings as findings,
    foreign as foreign,
    judge as judge,
)
from rvjax.measured.kinds import KINDS as KINDS, Kind as Kind, Loop, Tones, checked as checked
from rvjax.measured.orders import Fitted as Fitted, fitted as fitted
from rvjax.measured.read import Measured, read, read_table as read_table
from rvjax.measured.run import DIRECTIONS as DIRECTIONS, Conditions, Finding as Finding, Run

__all__ = ["Conditions", "Loop", "Measured", "Run", "Tones", "read"]
