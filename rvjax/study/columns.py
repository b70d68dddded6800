"""Columns of bench files: the columns of measured curves, loops and frequencies."""

from collections.abc import Mapping
from pathlib import Path

from rvjax import columns as cells
from rvjax.units import KNOWN

UNITS: dict[str, dict[str, float]] = {
    "angle": KNOWN["rad"],
    "error": KNOWN["rad"],
    "torque": KNOWN["N m"],
    "temperature": {"degC": 1.0},
    "speed": KNOWN["rad/s"],
    "frequency": KNOWN["Hz"],
    "sd": KNOWN["Hz"],
}
"""Measurement units of each quantity, with their size in SI (temperatures stay in degC)."""
WORDS = ("direction", "unit")


def read_table(path: str | Path, columns: Mapping[str, object] | None = None) -> cells.Table:
    """A table that a bench has written; see `rvjax.columns.read_table`."""
    return cells.read_table(path, columns, units=UNITS, words=WORDS)
