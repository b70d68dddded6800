"""Report of `rvjax reproduce`: table, counts of the verdicts, sources of contradictions."""

from collections.abc import Sequence

from rvjax.commands.reproduce.inputs import Inputs
from rvjax.published import Comparison, show
from rvjax.render import Note, Report, Table, Text


def report(inputs: Inputs, found: Sequence[Comparison]) -> Report:
    """The report on the comparisons.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    return report_on(found, notes=inputs.notes)


def report_on(rows: Sequence[Comparison], *, notes: bool = False) -> Report:
    """Published and computed values, with the counts of the verdicts.

    Args:
        rows: comparisons.
        notes: with the claim and the note under each row.
    """
    columns = [Text(t) for t in ("figure", "published", "computed", "unit", "physically right", "verdict")]
    cells = [[row.id, show(row.published), show(row.computed), row.unit, show(row.right), row.status] for row in rows]
    under = [f"    {row.claim}" + (f" -- {row.note}" if row.note else "") for row in rows] if notes else []
    verdicts = sorted({row.status for row in rows})
    counts = ", ".join(f"{sum(row.status == verdict for row in rows)} {verdict}" for verdict in verdicts)
    said = [f"{len(rows)} figures: {counts}", *_whose_error(rows)]
    return Report(
        title="Published values",
        content=(Table("comparison", columns, cells, under=under), Note("\n".join(said))),
        data=[row.as_json() for row in rows],
    )


def _whose_error(rows: Sequence[Comparison]) -> list[str]:
    """Explain that contradicted values are not errors of this package."""
    wrong = [row.id.split(".")[0] for row in rows if row.status == "contradicted"]
    if not wrong:
        return []
    sources = ", ".join(f"{wrong.count(source)} in {source}" for source in dict.fromkeys(wrong))
    return [
        f"contradicted: the error is the source's ({sources}), not the error of rvjax: such a value contradicts "
        "other values of the source, geometry or equilibrium; --notes names what each value contradicts"
    ]
