"""`rvjax tradeoff`: time and error of the levels of every model, measured here."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import rvjax
from rvjax import levels
from rvjax.commands import Inputs, option, switch
from rvjax.render import Figure, Note, Report, Table, Text, as_json


@dataclass(kw_only=True)
class TradeoffInputs(Inputs):
    """Measure time and error of the levels of every model and recommend when to use each. It takes about two minutes on
    two idle cores, most of it compilation; all levels take about ten.

    examples:
      rvjax tradeoff
      rvjax tradeoff --full --json here.json --picture here.png

    Studies with an [accuracy] table use the measured table that is part of rvjax.
    """

    json: Path | None = option("write the table (default: only print it)", "FILE.json", type=Path, ends=".json")
    picture: Path | None = option("draw error against time (default: none)", "FILE.png", type=Path, ends=".png")
    full: bool = switch("all levels, and more cases (default: the main ones)")
    seed: int = option("seed of the random cases (default: 0)", default=0, type=int)


def compute(inputs: TradeoffInputs) -> tuple[levels.Table, float]:
    """The table of levels, and the seconds that it took."""
    started = time.perf_counter()
    table = levels.measure(
        quick=not inputs.full,
        seed=inputs.seed,
        say=lambda name: print(f"measuring {name}", file=sys.stderr, flush=True),
    )
    return table, time.perf_counter() - started


def report(inputs: TradeoffInputs, found: tuple[levels.Table, float]) -> Report:
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
