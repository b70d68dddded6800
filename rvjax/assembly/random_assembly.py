"""Random assembly on independent draws, the reference of a plan."""

from collections.abc import Mapping

import numpy as np

from rvjax.assembly.costs import Costs, Machine, good
from rvjax.assembly.on_demand import OnDemand
from rvjax.assembly.supply import Supply
from rvjax.tolerances import Requirement

MOST_FRESH = 2**21
"""Units of random assembly at most."""


def random_assembly(
    machine: Machine,
    supply: Supply,
    found: Costs | OnDemand,
    drawn: Mapping[str, list[np.ndarray]],
    requirement: Requirement | None,
    seed: int,
    fresh: int,
    most_fresh: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean response and share of good units of random assembly, for every fresh draw.

    Args:
        machine: response and parts.
        supply: stocks.
        found: costs that chose; they are the values where all is known of the parts.
        drawn: fresh errors of each slot.
        requirement: limits of a good unit, or None.
        seed: of the random units.
        fresh: draws.
        most_fresh: units at most over all draws: all combinations where they are no more, else a random part of them.
    """
    weight = supply.weight()
    if fresh == 1 and isinstance(found, Costs):
        every = np.nan_to_num(found.every_mean)
        succeeds = weight * np.isfinite(found.every_mean)
        mean = (succeeds * every).sum() / succeeds.sum() if succeeds.any() else np.nan
        share = np.nan if found.every_good is None else (weight * found.every_good).sum() / weight.sum()
        return np.array([mean]), np.array([share])
    cells, turns = np.argwhere(weight > 0), len(machine.indices)
    likely = weight[weight > 0] / weight.sum()
    most = max(1, most_fresh // fresh)
    rng, sums = np.random.default_rng([seed % 2**64, 3]), np.cumsum(likely)
    if len(cells) * turns <= most:
        cell, turn = (x.ravel() for x in np.meshgrid(np.arange(len(cells)), np.arange(turns), indexing="ij"))
        chosen = [(cell, turn)] * fresh
        share = likely[cell] / turns
    else:
        chosen = [
            (np.searchsorted(sums / sums[-1], rng.random(most), side="right"), rng.integers(turns, size=most))
            for _ in range(fresh)
        ]
        share = np.full(most, 1 / most)
    # All draws at once: a call of few units costs as much as one of many.
    cell, turn = (np.concatenate(x) for x in zip(*chosen))
    draw = np.repeat(np.arange(fresh), len(share))
    values = machine.values(drawn, cells[cell], machine.indices[turn], draw).reshape(fresh, -1)
    right = ~np.isnan(values)
    weighed = np.where(right, share * np.nan_to_num(values), 0.0).sum(axis=1)
    with np.errstate(invalid="ignore"):
        mean = weighed / (share * right).sum(axis=1)
    return mean, (share * good(values, requirement)).sum(axis=1)
