"""Optimum of design and tolerances together; other optima: in two steps, without scaling laws, at other prices.

Optimum of the geometry without tolerances: least own cost and objective within the nominal limits.

Usual sizing computes it first. Where several points are optimal, the nearest to the start is chosen; distances count in
parts of the ranges. Modifications of the flank are matched to the errors: they belong to the second step, though they
change the curvature of the flank by a few percent.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax.base import progress
from rvjax.records import Array, PyTree
from rvjax.study import Law, Study, StudyError, kind_of
from rvjax.tolerances import Allocation, Memo, Variable, allocate

NEAREST = 1e-5  # weight of the distance to the start, against the change of the cost over the ranges
ITERATIONS = 300
MODIFICATIONS = ("cycloid.equidistant_modification", "cycloid.shift_modification", "cycloid.profile_modification")


def geometry_first(study: Study) -> dict[str, float]:
    """Values of the variables that the nominal limits and prices depend on; the others stay free for the tolerances.

    Args:
        study: with variables.
    """
    fixed = {path: item.first for path, item in study.variables.items() if not item.free}
    later = {path: item.first for path, item in study.variables.items() if path.partition("[")[0] in MODIFICATIONS}
    free = {path: item for path, item in study.variables.items() if path not in fixed and path not in later}
    names = study.without_errors
    if not names or not free:
        return fixed
    response = study.nominal_response()
    nothing = study.design.error_record()
    low = np.array([item.lower for item in free.values()])
    span = np.array([item.upper for item in free.values()]) - low
    start = (np.array([item.first for item in free.values()]) - low) / span

    def outputs(x: Array) -> Array:
        values = dict(zip(free, jnp.asarray(low) + x * jnp.asarray(span)))
        found = response(nothing, values | fixed | later).value
        return jnp.stack([jnp.asarray(found[name], x.dtype) for name in names])

    value, slope = jax.jit(outputs), jax.jit(jax.jacfwd(outputs))
    slopes = np.asarray(slope(start))
    prices = np.array([study.objective[name](1.0) if name in study.objective else 0.0 for name in names])
    spread = float(np.abs(prices @ slopes).sum() + np.abs(_own_slopes(free, low, span, start)).sum()) or 1.0

    def cost(x: np.ndarray) -> float:
        own = sum(item.own_cost(v) for item, v in zip(free.values(), low + x * span))
        return float(prices @ np.asarray(value(x)) + own) / spread + NEAREST * float((x - start) @ (x - start))

    def cost_slope(x: np.ndarray) -> np.ndarray:
        total = prices @ np.asarray(slope(x)) + _own_slopes(free, low, span, x)
        return np.asarray(total / spread + 2 * NEAREST * (x - start))

    limits = [
        (names.index(name), sign, bound)
        for name, item in study.nominal.items()
        for sign, bound in ((1.0, item.lower), (-1.0, item.upper))
        if bound is not None and math.isfinite(bound)
    ]
    rows = np.array([row for row, _, _ in limits], int)
    signs, bounds = (np.array([item[k] for item in limits], float) for k in (1, 2))
    scale = signs / np.where(np.abs(bounds) > 0, np.abs(bounds), 1.0)
    kept = {
        "type": "ineq",
        "fun": lambda x: scale * (np.asarray(value(x))[rows] - bounds),
        "jac": lambda x: scale[:, None] * np.asarray(slope(x))[rows],
    }
    found = optimize.minimize(
        cost, start, jac=cost_slope, bounds=[(0, 1)] * len(free), constraints=[kept] if limits else [],
        method="SLSQP", options={"ftol": 1e-13, "maxiter": ITERATIONS},
    )  # fmt: skip
    chosen = zip(free.items(), low + np.clip(found.x, 0, 1) * span, np.abs(slopes).max(axis=0) > 0)
    return fixed | {path: _listed(item, float(number)) for (path, item), number, seen in chosen if seen}


def _own_slopes(free: dict[str, Variable], low: np.ndarray, span: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Derivatives of the own costs, by differences of half a percent of the range."""
    step, found = 0.005, []
    for item, lower, width, at in zip(free.values(), low, span, x):
        ends = [item.own_cost(lower + width * (at + side)) for side in (-step, step)]
        found.append((ends[1] - ends[0]) / (2 * step))
    return np.array(found)


def _listed(item: Variable, value: float) -> float:
    """The value, or the nearest one of the list."""
    return min(item.among, key=lambda one: abs(one - value)) if item.among else value


JOINT, STEPS, UNSCALED, TRADE = "optimum", "optimum in two steps", "optimum without scaling laws", "trade front"
FACTORS = 8.0  # range of the prices on the trade front, to either side
CHEAPER = 3e-3  # part of the cost by which a point of the front shows that the optimum is in another valley
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

    @property
    def certified(self) -> bool:
        """True if independent units meet all requirements."""
        return self.found.status not in ("NOT_CERTIFIED", "INFEASIBLE")

    def priced(self, study: Study) -> float:
        """Cost of the priced outputs, at the prices of the study."""
        return sum(price(self.outputs[name]) for name, price in study.objective.items())

    def own(self, study: Study) -> float:
        """Own cost of the numbers of the design."""
        return sum(study.variables[path].own_cost(value) for path, value in self.found.values.items())

    def total(self, study: Study) -> float:
        """Cost at the prices of the study."""
        return self.found.cost + (1 - self.factor) * self.priced(study)

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


def optima(study: Study, memo: Memo | None, *, alone: bool, points: int, quiet: bool) -> Designed:
    """All optima that the options require.

    Args:
        study: with variables.
        memo: of an interrupted run.
        alone: the joint optimum and the front only.
        points: of the front.
        quiet: without progress.
    """
    laws = kind_of(study.design).following.called(study.design, study.variables, study.given)
    progress.begin(JOINT)
    joint = _optimum(study, study.variables, memo=memo, quiet=quiet)
    two_step, fixed, unscaled, front = None, dict[str, float](), None, list[Point]()
    if not alone:
        progress.begin(STEPS)
        fixed = geometry_first(study)
        held = dict(study.variables)
        for path, value in fixed.items():
            held[path] = dataclasses.replace(held[path], lower=value, upper=value, start=value, among=())
        two_step = _optimum(study, held, memo=memo, quiet=quiet)
        if any(not law.exact for law, _ in laws):
            progress.begin(UNSCALED)
            unscaled = _optimum(study, _from(study.variables, joint), similar=False, memo=memo, quiet=quiet)
    if points and joint.found.feasible:
        progress.begin(TRADE)
        near = _from(study.variables, joint)
        front = [_optimum(study, near, factor=factor, memo=memo, quiet=quiet) for factor in _factors(points)]
        joint = _cheaper(study, joint, front, memo, quiet)
    return Designed(joint, _outputs(study, {}), two_step, fixed, unscaled, laws, front)


def _cheaper(study: Study, joint: Point, front: list[Point], memo: Memo | None, quiet: bool) -> Point:
    """The optimum, sought again from a point of the front that costs less at the prices of the study."""
    best = min((point for point in front if point.certified), key=lambda point: point.total(study), default=joint)
    if best.total(study) >= (1 - CHEAPER) * joint.found.cost:
        return joint
    again = _optimum(study, _from(study.variables, best), memo=memo, quiet=quiet)
    return again if again.certified and again.found.cost < joint.found.cost else joint


def _factors(count: int) -> list[float]:
    """Factors on the prices, about 1 in equal ratios, without 1."""
    sides = [(k - (count - 1) / 2) / max((count - 1) / 2, 0.5) for k in range(count)]
    return [FACTORS**side for side in sides if side] if count > 1 else [FACTORS]


def _from(variables: Mapping[str, Variable], point: Point) -> dict[str, Variable]:
    """The variables, with the start at an optimum."""
    return {path: dataclasses.replace(item, start=point.found.values.get(path)) for path, item in variables.items()}


def _optimum(
    study: Study,
    variables: Mapping[str, Variable],
    *,
    similar: bool = True,
    factor: float = 1.0,
    memo: Memo | None,
    quiet: bool,
) -> Point:
    units = study.certificate_samples
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
            losses=study.losses,
            middles=study.middles,
            samples=study.samples,
            seed=study.seed,
            certificate_samples=units if factor == 1 else min(units, FRONT_SAMPLES),
            joint_target=study.joint_target,
            memo=memo,
            progress=not quiet,
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
