"""`rvjax reproduce`: published and computed values, with a verdict."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from rvjax import published
from rvjax.commands import Inputs, switch
from rvjax.published import Comparison, show
from rvjax.render import Note, Report, Table, Text


@dataclass(kw_only=True)
class ReproduceInputs(Inputs):
    """Compute the published values of the literature and print them next to the published ones. It takes about a
    minute, most of it compilation.

    examples:
      rvjax reproduce --notes
      rvjax reproduce --json > values.json

    verdicts: reproduced (within the published rounding), reproduced_with_reading (under an interpretation in the
    note), close (within 10 %), consistent (an inequality holds), contradicted (the value contradicts what the note
    names), not_computable (the source omits an input). exit code 0 for any verdicts.
    """

    json: bool = switch("the same as --format json: a list")
    notes: bool = switch("print the reading or the reason under each value")


def compute(inputs: ReproduceInputs) -> list[Comparison]:
    """Compare every published value with the computed value."""
    return published.reproduce(say=lambda text: print(text, file=sys.stderr, flush=True))


def report(inputs: ReproduceInputs, found: Sequence[Comparison]) -> Report:
    """Published and computed values, with the counts of the verdicts.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    columns = [Text(t) for t in ("figure", "published", "computed", "unit", "physically right", "verdict")]
    cells = [[row.id, show(row.published), show(row.computed), row.unit, show(row.right), row.status] for row in found]
    under = [f"    {row.claim}" + (f" -- {row.note}" if row.note else "") for row in found] if inputs.notes else []
    verdicts = sorted({row.status for row in found})
    counts = ", ".join(f"{sum(row.status == verdict for row in found)} {verdict}" for verdict in verdicts)
    said = [f"{len(found)} figures: {counts}", *_whose_error(found)]
    return Report(
        title="Published values",
        content=(Table("comparison", columns, cells, under=under), Note("\n".join(said))),
        data=[row.as_json() for row in found],
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
