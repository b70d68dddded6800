"""Section on a measurement, for every kind of bench file: its properties, and what limits the result."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rvjax.measured import Finding
from rvjax.render import CSV, PAGE, TEXT, Column, Content, Figure, Quantity, Section, Table, Text, column

MOST = 4  # items whose findings the text and the page show; the file has all
LARGE = 0.02  # rad: angles above are read in deg, others in arcsec
MOST_WARNINGS = 12


@dataclass(frozen=True)
class FindingRow:
    """A property of a measurement."""

    measured: str = column(Text("measured"))
    name: str = column(Text("property"))
    value: Quantity | str = column(Column("value"))
    unit: str = column(Text("unit", on=frozenset({CSV})))
    remark: str = column(Text("remark", wraps=True))


def section(found: Mapping[str, Sequence[Finding]], figures: Sequence[Figure] = ()) -> list[Content]:
    """The section; empty without findings.

    Args:
        found: findings by the name of what was measured; "" for a single item.
        figures: plots of the measurement.
    """
    if not any(found.values()):
        return []
    findings = [(name, f, _quantity(f)) for name, several in found.items() for f in several]
    rows = [FindingRow(name, f.name, size, size.shown[0], f.text) for name, f, size in findings]
    content: list[Content] = [Table.of(FindingRow, "measurement", rows, on=frozenset({CSV}))]
    if len(found) <= MOST:
        table = functools.partial(Table.of, FindingRow, "measurement", without=() if len(found) > 1 else ("measured",))
        plain = [row for row, (_, f, _) in zip(rows, findings) if not f.warning]
        content.append(table(plain, caption="The measurement:", on=frozenset({TEXT})))
        content.append(table(rows, on=frozenset({PAGE})))
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
