"""Measured time of the equilibria of the loaded reducer, from which the run time of any of its studies follows."""

import tomllib
from collections.abc import Iterable
from functools import cache
from importlib import resources
from typing import Any

from rvjax import models
from rvjax.outputs import Reading, Source
from rvjax.records import PyTree


@cache
def measured() -> dict[str, Any]:
    """Times of `equilibria.toml`: microseconds by kind of reducer, use and contact law, and the computer."""
    return tomllib.loads((resources.files("rvjax.levels") / "equilibria.toml").read_text("utf-8"))


def sources_of(design: PyTree, output: str) -> tuple[Source, ...]:
    """Results that an output reads, if the number of equilibria of each is known, else none.

    Args:
        design: the reducer.
        output: name.
    """
    kind = models.kind(design)
    evaluate = kind.outputs[output].evaluate
    sources = evaluate.sources if isinstance(evaluate, Reading) else ()
    return sources if all(source in kind.work for source in sources) else ()


def seconds(design: PyTree, results: Iterable[tuple[Source, Any]]) -> float | None:
    """Seconds of a unit on the cores of the measurement, None for a kind of equilibrium that was not measured.

    Time is in proportion to the pins of all discs, output pins among them.

    Args:
        design: the reducer.
        results: each with the conditions under which it is computed.
    """
    kind, table, total = models.kind(design), measured().get(design.kind, {}), 0.0
    for source, given in results:
        name, count = kind.work[source](given)
        each = table.get(name, {}).get(given.pin_contact)
        if each is None:
            return None
        total += 1e-6 * each * count * contacts(design) / table["contacts"]
    return total / measured()["measured_on"]["cores"]


def contacts(design: PyTree) -> int:
    """Pins and output pins that touch the discs, counted for each disc.

    Args:
        design: counts are read.
    """
    counts = design.counts
    return int(counts["discs"] * (counts["pins"] + counts.get("output_pins", 0)))
