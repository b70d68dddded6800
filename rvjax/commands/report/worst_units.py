"""The worst units of a sample: which they are, what they do, and the errors that make them so."""

from dataclasses import dataclass

import jax
import numpy as np

from rvjax.commands.allocate import Answer
from rvjax.tolerances import sample

EACH = 2  # worst units of a requirement


@dataclass(frozen=True)
class WorstUnit:
    """One unit with the allocated tolerances.

    Attributes:
        index: number of the unit; `tolerances.sample` with the seed of the sample replays it.
        requirement: that it is worst in, or "" for a unit that failed.
        status: name of its status.
        values: {response: value}, SI; nan where it failed.
        errors: {field: value of every element}, SI.
    """

    index: int
    requirement: str
    status: str
    values: dict[str, float]
    errors: dict[str, np.ndarray]


def worst_units(answer: Answer) -> list[WorstUnit]:
    """Of the sample behind the histograms: the first failed unit of each status, then the worst of each requirement."""
    study, side = answer.study, answer.after
    found = [(index, "", status) for status, index in side.failed.items()]
    for name, requirement in study.requirements.items():
        if not requirement.of_units:
            continue
        margin = np.asarray(requirement.margin(side.values[name]))
        order = np.argsort(np.where(np.isfinite(margin), margin, -np.inf))[::-1]
        found += [(int(index), name, "CONVERGED") for index in order[:EACH] if np.isfinite(margin[index])]
    if not found:
        return []
    indices = np.array([index for index, _, _ in found], np.uint32)
    drawn = jax.jit(jax.vmap(lambda index: sample(side.tolerances, index, seed=side.seed)))(indices)
    return [
        WorstUnit(
            index=index,
            requirement=name,
            status=status,
            values={other: float(side.values[other][index]) for other in study.requirements},
            errors={f: np.atleast_1d(np.asarray(getattr(drawn, f))[k]).ravel() for f in study.fields},
        )
        for k, (index, name, status) in enumerate(found)
    ]
