"""Levels, measured."""

import sys
import time

from rvjax import levels
from rvjax.commands.tradeoff.inputs import Inputs


def compute(inputs: Inputs) -> tuple[levels.Table, float]:
    """The table of levels, and the seconds that it took."""
    started = time.perf_counter()
    table = levels.measure(
        quick=not inputs.full,
        seed=inputs.seed,
        say=lambda name: print(f"measuring {name}", file=sys.stderr, flush=True),
    )
    return table, time.perf_counter() - started
