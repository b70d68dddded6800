"""Section on a measurement, for every kind of bench file: its properties, and what limits the result."""

import itertools
from collections.abc import Mapping, Sequence

from rvjax.measured import Finding
from rvjax.render import CSV, PAGE, TEXT, Column, Content, Figure, Quantity, Section, Table, Text

MOST = 4  # items whose findings the text and the page show; the file has all
LARGE = 0.02  # rad: angles above are read in deg, others in arcsec
MOST_WARNINGS = 12


def section(found: Mapping[str, Sequence[Finding]], figures: Sequence[Figure] = ()) -> list[Content]:
    """The section; empty without findings.

    Args:
        found: findings by the name of what was measured; "" for a single item.
        figures: plots of the measurement.
    """
    if not any(found.values()):
        return []
    rows = [[name, f.name, _quantity(f), f.text] for name, several in found.items() for f in several]
    shown = rows if len(found) <= MOST else []
    columns: list[Column] = [Text("measured"), Text("property"), Column("value"), Text("remark", wraps=True)]
    columns = columns if len(found) > 1 else columns[1:]
    short = [row if len(found) > 1 else row[1:] for row in shown]
    plain = [row for row, f in zip(short, itertools.chain(*found.values())) if not f.warning]
    every = [Text("measured"), Text("property"), Column("value"), Text("unit"), Text("remark")]
    units = [[*row[:3], row[2].shown[0] if isinstance(row[2], Quantity) else "", row[3]] for row in rows]
    content: list[Content] = [Table("measurement", every, units, on=frozenset({CSV}))]
    if shown:
        content.append(Table("measurement", columns, plain, "The measurement:", on=frozenset({TEXT})))
        content.append(Table("measurement", columns, short, on=frozenset({PAGE})))
    return [Section("The measurement", (*content, *figures))]


def warnings(found: Mapping[str, Sequence[Finding]]) -> list[str]:
    """A line for each warning.

    Args:
        found: findings by the name of what was measured.
    """
    lines = []
    for name, several in found.items():
        for finding in several:
            if finding.warning:
                size = finding.name if finding.unit == "-" else f"{finding.name}, {_quantity(finding).text('.4g')}"
                lead = f"{name}: " if name and len(found) > 1 else ""
                lines.append(f"warning: {lead}{size}: {finding.text}")
    left = len(lines) - MOST_WARNINGS
    return lines if left <= 0 else [*lines[:MOST_WARNINGS], f"warning: {left} more; the file measurement.csv has all"]


def as_data(several: Sequence[Finding]) -> list[dict[str, object]]:
    """Findings as JSON values, SI.

    Args:
        several: of one item.
    """
    return [{"name": f.name, "value": f.value, "unit": f.unit, "text": f.text, "warning": f.warning} for f in several]


def _quantity(finding: Finding) -> Quantity:
    """The number in the unit that a person reads."""
    angle = "deg" if abs(finding.value) > LARGE else "arcsec"
    return Quantity(finding.value, finding.unit, read_in=angle if finding.unit == "rad" else None)
