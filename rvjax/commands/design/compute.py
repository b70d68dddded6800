"""Optimum of design and tolerances together; other optima: in two steps, without scaling laws, at other prices."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from rvjax import progress
from rvjax.commands.design.geometry_first import geometry_first
from rvjax.commands.design.inputs import Inputs
from rvjax.commands.speak import READING, WRITING
from rvjax.records import PyTree
from rvjax.study import Law, Study, StudyError, laws_of
from rvjax.tolerances import Allocation, Memo, Variable, allocate

JOINT, STEPS, UNSCALED, TRADE = "optimum", "optimum in two steps", "optimum without scaling laws", "trade front"
FACTORS = 8.0  # range of the prices on the trade front, to either side
FRONT_SAMPLES = 65_536  # of the certificate of a point of the front


@dataclass(frozen=True)
class Point:
    """An optimum, of one way to look for it.

    Attributes:
        found: the optimum.
        design: with its numbers.
        outputs: without errors, by name: those that are priced or limited without errors.
        factor: on the prices of the objective.
    """

    found: Allocation
    design: PyTree
    outputs: Mapping[str, float]
    factor: float = 1.0

    def priced(self, study: Study) -> float:
        """Cost of the priced outputs, at the prices of the study."""
        return sum(price(self.outputs[name]) for name, price in study.objective.items())

    def own(self, study: Study) -> float:
        """Own cost of the numbers of the design."""
        return sum(study.variables[path].own_cost(value) for path, value in self.found.values.items())

    def of_tolerances(self, study: Study) -> float:
        """Cost of half-widths and moved mid-points."""
        return self.found.cost - self.factor * self.priced(study) - self.own(study)


@dataclass(frozen=True)
class Designed:
    """Result of `rvjax design`.

    Attributes:
        joint: the optimum.
        start: outputs without errors of the design of the study.
        two_step: geometry first, tolerances after; None where it was not computed.
        fixed: numbers of the first step.
        unscaled: the optimum without scaling laws; None where it was not computed, or no scaling law is used.
        laws: scaling laws that are used, each with the numbers that follow.
        front: further optima at other prices of the objective, in the order of their prices.
    """

    joint: Point
    start: Mapping[str, float]
    two_step: Point | None
    fixed: Mapping[str, float]
    unscaled: Point | None
    laws: list[tuple[Law, list[str]]]
    front: list[Point]


def phases(asked: Inputs) -> dict[str, float]:
    """Phases of the command with their seconds.

    Args:
        asked: what is computed.
    """
    once = 60.0 if asked.study.costly else 15.0
    more = {} if asked.alone else {STEPS: once, UNSCALED: once}
    return {READING: 6.0, JOINT: once} | more | ({TRADE: once * asked.front} if asked.front else {}) | {WRITING: 10.0}


def compute(asked: Inputs) -> Designed:
    """All optima that the options require."""
    study, laws = asked.study, laws_of(asked.study.design, asked.study.variables, asked.study.given)
    memo = asked.memo
    progress.begin(JOINT)
    joint = _optimum(asked, study.variables, memo=memo)
    two_step, fixed, unscaled, front = None, dict[str, float](), None, list[Point]()
    if not asked.alone:
        progress.begin(STEPS)
        fixed = geometry_first(study)
        held = {path: _fixed(item, fixed[path]) if path in fixed else item for path, item in study.variables.items()}
        two_step = _optimum(asked, held, memo=memo)
        if any(law.name != "gears" for law, _ in laws):
            progress.begin(UNSCALED)
            unscaled = _optimum(asked, _from(study.variables, joint), similar=False, memo=memo)
    if asked.front and joint.found.feasible:
        progress.begin(TRADE)
        near = _from(study.variables, joint)
        front = [_optimum(asked, near, factor=factor, memo=memo) for factor in _factors(asked.front)]
    return Designed(joint, _outputs(study, {}), two_step, fixed, unscaled, laws, front)


def _factors(count: int) -> list[float]:
    """Factors on the prices, about 1 in equal ratios, without 1."""
    sides = [(k - (count - 1) / 2) / max((count - 1) / 2, 0.5) for k in range(count)]
    return [FACTORS**side for side in sides if side] if count > 1 else [FACTORS]


def _fixed(item: Variable, value: float) -> Variable:
    """The variable with one value."""
    return dataclasses.replace(item, lower=value, upper=value, start=value, among=())


def _from(variables: Mapping[str, Variable], point: Point) -> dict[str, Variable]:
    """The variables, with the start at an optimum."""
    return {path: dataclasses.replace(item, start=point.found.values.get(path)) for path, item in variables.items()}


def _optimum(
    asked: Inputs, variables: Mapping[str, Variable], *, similar: bool = True, factor: float = 1.0, memo: Memo | None
) -> Point:
    study, units = asked.study, asked.study.certificate_samples
    if memo is not None and not similar:
        memo = memo.apart("without scaling laws")  # the same numbers of a design mean another reducer
    try:
        found = allocate(
            study.design_response(similar=similar),
            study.tolerances,
            study.requirements | study.nominal,
            costs=study.costs,
            variables=variables,
            objective={name: factor * price(1.0) for name, price in study.objective.items()},
            middles=study.middles,
            samples=study.samples,
            seed=study.seed,
            certificate_samples=units if factor == 1 else min(units, FRONT_SAMPLES),
            joint_target=study.joint_target,
            memo=memo,
            progress=not asked.quiet,
        )
    except ValueError as error:
        raise StudyError(f"{study.name}: {error}") from None
    return Point(
        found, study.design_with(found.values, similar=similar), _outputs(study, found.values, similar), factor
    )


def _outputs(study: Study, values: Mapping[str, float], similar: bool = True) -> dict[str, float]:
    """Nominal and priced outputs without errors."""
    if not study.without_errors:
        return {}
    found = study.nominal_response(similar=similar)(study.design.error_record(), values)
    return {name: float(value) for name, value in found.value.items()}
