"""Report of `rvjax tradeoff`: the table of levels and advice, a plot."""

from pathlib import Path

import rvjax
from rvjax import levels
from rvjax.commands.tradeoff.inputs import Inputs
from rvjax.render import Figure, Note, Report, Table, Text, as_json


def report(inputs: Inputs, found: tuple[levels.Table, float]) -> Report:
    """The report on the levels.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    table, seconds = found
    plot = Figure("tradeoff", "Error against time", lambda: rvjax.plotting.tradeoff(table).axes[0])
    files: dict[Path, bytes] = {inputs.json: as_json(table.as_json()) + b"\n"} if inputs.json else {}
    files |= {inputs.picture: plot.content()} if inputs.picture else {}
    models = [
        Table("levels", [Text(title, wraps=k == 0) for k, title in enumerate(one.titles)], one.rows, one.head, one.foot)
        for one in levels.blocks(table)
    ]
    return Report(
        title="Levels",
        content=(*models, Note(levels.measured_on(table)), Note(f"{seconds:.1f} s, compilation included")),
        data=table.as_json(),
        exports=files,
    )
