"""Cost of other yields: the search again at other targets, from one to the next."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from rvjax.tolerances.allocation.problem import KEPT, STAGES
from rvjax.tolerances.allocation.programme import COARSE, LOOKS, MET, End
from rvjax.tolerances.allocation.search import Search
from rvjax.tolerances.batch.statistics import Statistics


def costs_of_yields(search: Search, end: End, yields: Sequence[float]) -> list[tuple[float, float]]:
    """(least yield of a requirement, cost) of other targets, ascending; yields are those of independent units.

    Args:
        search: of the problem; its sample and wanted rejects are others afterwards.
        end: from which searches go away.
        yields: targets of all shares.
    """
    problem, constraints, certifier = search.problem, search.constraints, search.certifier
    if not yields or not any(row.share for row in constraints.rows):
        return []
    goal = min((item.target for item in problem.requirements.values() if item.of_shares), default=1.0)  # type: ignore[attr-defined]
    points = list[tuple[float, float]]()
    if problem.costly:
        constraints.sample(min(constraints.count, STAGES[0]))
    for side in (sorted((y for y in yields if y < goal), reverse=True), sorted(y for y in yields if y >= goal)):
        x = end.look.x
        for target in side:
            moved = [
                1 - target if row.share and row.item else old for row, old in zip(constraints.rows, constraints.rejects)
            ]
            constraints.rejects = np.array(moved)
            there = search.programme.run(x, most=LOOKS, gain=COARSE)
            if there.look.excess > 2 * MET:
                continue
            x = there.look.x
            samples = min(certifier.run.samples, STAGES[1] if problem.costly else KEPT)
            fresh = dataclasses.replace(
                certifier.run, population=search.decisions.population(x), samples=samples, keep=False
            )
            certifier.solved += samples
            points.append((least_yield(fresh.statistics()), there.look.total))
    return sorted(points)


def least_yield(statistics: Statistics) -> float:
    """The least share of units that keeps one requirement."""
    return min(verdict.estimate.value for verdict in statistics.verdicts.values() if verdict.kind == "share")
