"""Differences of two results, and their certificates under the requirements of one study.

Tolerances of one result, certified under another study with the same errors and parts.
"""

import dataclasses
from dataclasses import dataclass

from rvjax.base import progress
from rvjax.commands.compare.inputs import Inputs
from rvjax.commands.compare.results import Topics, compared
from rvjax.records import PyTree
from rvjax.response import BLOCK
from rvjax.study import Study
from rvjax.tolerances import Statistics, monte_carlo


@dataclass(frozen=True)
class Crossed:
    """Result certified under another study.

    Attributes:
        study: with the requirements.
        tolerances: that are certified, a record with a Tolerance or None in each field.
        taken: fields with the tolerance of the result.
        own: fields without a tolerance in the result: they keep the tolerance of the study.
        left: fields without a tolerance in the study: they are excluded from its statistics.
        cost: in the costs of the study.
        statistics: of independent units, with the yield of each requirement and of all at once.
    """

    study: Study
    tolerances: PyTree
    taken: tuple[str, ...]
    own: tuple[str, ...]
    left: tuple[str, ...]
    cost: float
    statistics: Statistics


def crossed(study: Study, tolerances: PyTree, *, samples: int | None = None) -> Crossed:
    """Certify tolerances under the requirements, conditions, design and models of a study.

    Args:
        study: with the requirements.
        tolerances: of the result of another study, a record with a Tolerance or None in each field.
        samples: independent units; by default as many as the study certifies with.

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
            seed=study.seed + 1,  # the allocation uses that of the study
            chunk=BLOCK,
            requirements=study.requirements,
        ),
    )


def put_into(study: Study, tolerances: PyTree) -> PyTree:
    """Replace the tolerances of a study by those of a result, where both have one.

    Limits, distribution and capability of an error are kept as deviations from the nominal values of the study's
    design.

    Args:
        study: whose other tolerances stay.
        tolerances: of the result, a record with a Tolerance or None in each field.

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


def cost_of(study: Study, tolerances: PyTree) -> float:
    """Cost of tolerances in the costs of a study.

    Args:
        study: whose costs count.
        tolerances: a record with a Tolerance in each field that has a cost.
    """
    return sum(float(cost(getattr(tolerances, name).half_width)) for name, cost in study.costs.items())


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two results, or one, side by side.

    Attributes:
        topics: what differs by topic and name, as `compared` gives it; empty for one result.
        crossed: certificates under the study of --on, by letter.
    """

    topics: Topics
    crossed: dict[str, Crossed]


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    if inputs.study is None:
        return ()
    return tuple(map(_drawing, inputs.answers))


def _drawing(letter: str) -> str:
    return f"units of {letter}"


def compute(inputs: Inputs) -> Comparison:
    """Compare two results; certify each under the study of --on."""
    topics = compared(*inputs.results.values()) if len(inputs.results) == 2 else {}
    found = {}
    for letter, (_, tolerances) in inputs.answers.items():
        progress.begin(_drawing(letter))
        assert inputs.study is not None
        found[letter] = crossed(inputs.study, tolerances, samples=inputs.samples)
    return Comparison(topics, found)
