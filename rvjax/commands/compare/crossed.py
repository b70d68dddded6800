"""The tolerances of one answer under the question of another study, of the same errors of the same parts."""

import dataclasses
from dataclasses import dataclass
from typing import Any

from rvjax.response import BLOCK
from rvjax.study import Study
from rvjax.tolerances import Statistics, monte_carlo


@dataclass(frozen=True)
class Crossed:
    """An answer certified under another study.

    Attributes:
        study: that asks.
        tolerances: with which it was asked, a record with a Tolerance or None in each field.
        taken: fields whose tolerance is that of the answer.
        own: fields that the answer has not: they keep the tolerance of the study.
        left: fields that the study has not: it does not ask after them, and they have no part in its figures.
        cost: in the costs of the study.
        statistics: of independent units, with the yield of each requirement and of all at once.
    """

    study: Study
    tolerances: Any
    taken: tuple[str, ...]
    own: tuple[str, ...]
    left: tuple[str, ...]
    cost: float
    statistics: Statistics


def crossed(
    study: Study, tolerances: Any, *, samples: int | None = None, seed: int | None = None, progress: bool = False
) -> Crossed:
    """Certify tolerances under the requirements, conditions, design and models of a study.

    Args:
        study: that asks.
        tolerances: of an answer to another study, a record with a Tolerance or None in each field.
        samples: fresh units; by default as many as the study certifies with.
        seed: of the units; by default the one after that of the study, which its answers learn from.
        progress: show a progress bar.

    Raises:
        ValueError: tolerances of another kind of reducer, or none that the study has.
    """
    together = put_into(study, tolerances)
    given = [f.name for f in dataclasses.fields(tolerances) if getattr(tolerances, f.name) is not None]
    taken = tuple(name for name in given if name in study.fields)
    return Crossed(
        study=study,
        tolerances=together,
        taken=taken,
        own=tuple(name for name in study.fields if name not in taken),
        left=tuple(name for name in given if name not in taken),
        cost=cost_of(study, together),
        statistics=monte_carlo(
            study.response(),
            together,
            samples=study.certificate_samples if samples is None else samples,
            seed=study.seed + 1 if seed is None else seed,
            chunk=BLOCK,
            requirements=study.requirements,
            progress=progress,
        ),
    )


def put_into(study: Study, tolerances: Any) -> Any:
    """The tolerances of a study with those of an answer in their place, where both have one.

    Limits, law and capability of an error are taken as they are, as deviations from the nominal numbers of the study's
    design.

    Args:
        study: whose other tolerances stay.
        tolerances: of the answer, a record with a Tolerance or None in each field.

    Raises:
        ValueError: tolerances of another kind of reducer, or none that the study has.
    """
    if type(tolerances) is not type(study.tolerances):
        theirs, ours = (type(record).__name__ for record in (tolerances, study.tolerances))
        raise ValueError(f"study {study.name}: has requirements on {ours}, the result is about {theirs}")
    found = {name: one for name in study.fields if (one := getattr(tolerances, name)) is not None}
    if not found:
        raise ValueError(f"study {study.name}: has none of the errors of the result")
    for name, one in found.items():
        if one.shape != (shape := getattr(study.tolerances, name).shape):
            raise ValueError(f"tolerances.{name}: {one.shape} elements in the result, {shape} in study {study.name}")
    return study.tolerances.replace(**found)


def cost_of(study: Study, tolerances: Any) -> float:
    """Cost of tolerances in the costs of a study.

    Args:
        study: whose costs count.
        tolerances: a record with a Tolerance in each field that has a cost.
    """
    return sum(float(cost(getattr(tolerances, name).half_width)) for name, cost in study.costs.items())
