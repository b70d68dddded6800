"""Units on the whole reducer: the limits of a four-bar or lost-motion study, and what a loaded study does not limit.

A few hundred units are solved by the loaded model. What a loaded study does not limit is compared with usual limits.
For another study the share of units that meet its limits there is one line. Control: a linear regression of the loaded
outputs on the errors, fitted to the other folds of these units, predicts the margin of many units; it sorts them into
strata. In each stratum the share of good units is that of the solved ones, with the score interval of Wilson; the
intervals are added in squares (Zou and Donner, Stat. Med. 27, 1693, 2008). A useless control leaves the interval of
plain sampling.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax._jax.sizes import AT_ONCE
from rvjax.commands.sections.cells import limit_text, share
from rvjax.errors import described
from rvjax.population import Estimate, Population, deviate_of, drawn, root_key, score_interval
from rvjax.render import Cell, Interval, Number, Quantity, Table, Text, Titled
from rvjax.response import elements, is_costly, parts
from rvjax.status import succeeded
from rvjax.study import CURVE, Response, Study
from rvjax.tolerances import Requirement, monte_carlo
from rvjax.units import with_unit

UNITS, MANY = 2 * AT_ONCE, 16384
FOLDS = 4
EDGES = np.array([-1.5, 0.0, 1.5])
"""Limits of the strata: predicted margin in standard deviations of its error; above 0 a unit is predicted to fail."""
ANGLES = {"samples": 24, "probe_angles": 4}
SEED = 5  # added to that of the study
_RIDGE = 1e-3  # of the units, in squares of standardised errors


SHARE = 0.99
"""Of the units: what is not limited is listed at this share."""


@dataclass(frozen=True)
class Unlimited:
    """An output of a loaded study that no requirement limits, next to its usual limit.

    Attributes:
        nominal: value of the unit without errors, SI; nan if it fails.
        reached: value that `SHARE` of the units keep, SI: a quantile of the side that has a limit.
        lower: usual limit, SI.
        upper: usual limit, SI.
        share: of the units within the usual limit; failed units are not.
        meaning: of the limit.
        units: solved ones.
        failed: those of them without a value.
    """

    nominal: float
    reached: Estimate
    lower: float
    upper: float
    share: Estimate
    meaning: str
    units: int
    failed: int

    @property
    def missed(self) -> bool:
        """True if less than `SHARE` of the units keep the usual limit."""
        return self.share.value < SHARE

    @property
    def limit(self) -> Requirement:
        """The usual limit."""
        return Requirement(lower=self.lower, upper=self.upper, target=SHARE)


def not_limited(study: Study) -> Response | None:
    """Outputs with a usual limit that a loaded study does not limit, as far as its design and conditions allow them."""
    usual = models.kind(study.design).usual if study.costly else {}
    names = []
    for name in (name for name, limit in usual.items() if name not in study.requirements):
        try:
            Response.of(study.design, (name,), study.conditions)
        except ValueError:
            continue
        names += [name] if usual[name].limits(study.design) else []
    return Response.of(study.design, tuple(names), study.conditions) if names else None


def unlimited(study: Study, tolerances: Any) -> dict[str, Unlimited]:
    """Measure the outputs that a loaded study does not limit, on units with some tolerances.

    Args:
        study: with the design and the conditions.
        tolerances: of the units.
    """
    response, population = not_limited(study), Population.of(tolerances)
    if response is None:
        return {}
    usual = {name: models.kind(study.design).usual[name] for name in response.outputs}
    ends = {name: limit.limits(study.design) or (-math.inf, math.inf) for name, limit in usual.items()}
    limits = {name: Requirement(lower=low, upper=high, target=SHARE) for name, (low, high) in ends.items()}
    seed, quantiles = study.seed + SEED, (1 - SHARE, SHARE)
    found = monte_carlo(
        response, tolerances, samples=UNITS, seed=seed, chunk=UNITS, requirements=limits, quantiles=quantiles
    )
    nominal, count = dict[str, float](), sum(math.prod(tolerance.shape) for tolerance in population.active.values())
    for part in parts(response, population):
        nominal |= dict(zip(part.names, part.of_elements(population, np.zeros((count, 1)))[0][:, 0].tolist()))
    return {
        name: Unlimited(
            nominal=nominal[name],
            reached=found.quantiles[SHARE if math.isfinite(limit.upper) else 1 - SHARE][name],
            lower=limit.lower,
            upper=limit.upper,
            share=found.yield_[name],
            meaning=usual[name].meaning,
            units=found.samples,
            failed=found.failed,
        )
        for name, limit in limits.items()
    }


@dataclass(frozen=True)
class Whole:
    """Units of a study on the whole reducer.

    Attributes:
        share: of the units that meet all limits there.
        units: solved ones.
        within: {requirement: share of the solved units within its limit}.
        mean: {requirement: mean of the solved units, SI}.
        output: {requirement: output of the loaded model in its place}.
        failed: units that cannot be solved; they do not meet the limits.
        unread: errors with a tolerance that the loaded model does not read.
    """

    share: Estimate
    units: int
    within: Mapping[str, float]
    mean: Mapping[str, float]
    output: Mapping[str, str]
    failed: int
    unread: tuple[str, ...]


def counterparts(study: Study) -> dict[str, str]:
    """Outputs of the whole reducer, by requirement; empty where the study has none or its design lacks parts."""
    design, outputs = study.design, models.kind(study.design).outputs
    found = {n: outputs[n].exact or n for n, item in study.requirements.items() if item.limits_values}
    lacks = any(getattr(design, part, None) is None for part in ("stiffness", "contact"))
    if study.costly or lacks or not getattr(study.conditions, "output_torque", 0.0) or found == {n: n for n in found}:
        return {}
    return found


def whole(study: Study, tolerances: Any) -> Whole | None:
    """Measure the units of some tolerances on the whole reducer; None where nothing of the study is measured there.

    Args:
        study: with requirements of the four-bar or lost-motion model.
        tolerances: of the units.
    """
    outputs = counterparts(study)
    if not outputs:
        return None
    given = study.conditions
    rated = given.output_torque if given.rated_torque is None else given.rated_torque
    conditions = dataclasses.replace(given, rated_torque=rated, **ANGLES)
    response = Response.of(study.design, tuple(dict.fromkeys(outputs.values())), conditions)
    population = Population.of(tolerances)
    z = np.asarray(drawn(population, root_key(study.seed + SEED), jnp.uint32(0), count=MANY))
    errors = np.asarray(elements(population, jnp.asarray(z)), float)
    values, known, curves = dict[str, np.ndarray](), dict[str, np.ndarray](), dict[str, np.ndarray]()
    status = np.zeros(UNITS, np.int32)
    for part in parts(response, population):
        costly = is_costly(part.response)
        rows, own, _ = part.solve(population, z[:, :UNITS] if costly else z)
        values |= dict(zip(part.names, rows[:, :UNITS]))
        known |= {} if costly else dict(zip(part.names, rows))
        status = np.where(succeeded(np.asarray(status)), own[:UNITS], status)
        if getattr(part.response, "curve", False):
            curves |= dict.fromkeys(part.names, part.rows(population, z[:, :UNITS], CURVE))
    solved = succeeded(np.asarray(status)) & np.all([np.isfinite(row) for row in values.values()], axis=0)
    margins = {n: np.asarray(study.requirements[n].margin(values[outputs[n]])) for n in outputs}
    good = solved & np.all([row <= 0 for row in margins.values()], axis=0)
    limited = [
        Limited(study.requirements[n].margin, values[o], curves.get(o), known.get(o)) for n, o in outputs.items()
    ]
    scores = crossed(errors, limited, solved)
    return Whole(
        share=stratified(good, *scores, confidence=0.95),
        units=UNITS,
        within={n: float(np.mean(solved & (row <= 0))) for n, row in margins.items()},
        mean={n: float(values[outputs[n]][solved].mean()) if solved.any() else math.nan for n in outputs},
        output=outputs,
        failed=int((~solved).sum()),
        unread=tuple(name for name in population.active if name in described(tolerances, "bounds")),
    )


@dataclass(frozen=True, eq=False)
class Limited:
    """One output with limits, of the solved units.

    Attributes:
        margin: value -> distance beyond the limits.
        values: of the solved units (n,).
        curves: whose peak to peak is the value (n, angles), or None.
        known: values of all units (many,) where they cost nothing, or None.
    """

    margin: Callable[[np.ndarray], Any]
    values: np.ndarray
    curves: np.ndarray | None = None
    known: np.ndarray | None = None


def crossed(errors: np.ndarray, limited: Sequence[Limited], solved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predicted margins of solved units (n,), each by the other folds, and of all units by each fold (folds, many).

    Args:
        errors: of all units, the solved ones first (elements, many).
        limited: outputs.
        solved: which of the n units have values.
    """
    n = len(solved)
    scale = errors.std(axis=1, keepdims=True)
    x = ((errors - errors.mean(axis=1, keepdims=True)) / np.where(scale > 0, scale, 1.0)).T
    fold = np.arange(n) % FOLDS
    own, every = np.full(n, -math.inf), np.full((FOLDS, len(x)), -math.inf)
    for k in range(FOLDS):
        fit = np.flatnonzero((fold != k) & solved)
        for one in limited if len(fit) > 2 else ():
            predicted, sd = _predicted(x, fit, one)
            every[k] = np.fmax(every[k], np.asarray(one.margin(predicted)) / (sd or 1e-300))
        own[fold == k] = every[k][:n][fold == k]
    return own, every


def _predicted(x: np.ndarray, fit: np.ndarray, one: Limited) -> tuple[np.ndarray, float]:
    """Values of all units by a regression on some, and the standard deviation of their error."""
    values = one.values[fit]
    if one.known is not None:
        return one.known, 1e-3 * float(np.std(values))
    target = (one.values[:, None] if one.curves is None else one.curves)[fit]
    mean, middle = target.mean(axis=0), x[fit].mean(axis=0)
    own = x[fit] - middle
    slopes = np.linalg.solve(own.T @ own + _RIDGE * len(fit) * np.eye(x.shape[1]), own.T @ (target - mean))
    rows = mean + (x - middle) @ slopes
    found = rows[:, 0] if one.curves is None else np.ptp(rows, axis=1)
    found = found + np.mean(values - found[fit])
    return found, float(np.std(values - found[fit]))


def stratified(good: np.ndarray, own: np.ndarray, every: np.ndarray, *, confidence: float) -> Estimate:
    """Share of good units, from strata of their predicted margin whose sizes are known from many units.

    Args:
        good: of the solved units (n,).
        own: their predicted margins (n,).
        every: predicted margins of many units, by each fold (folds, many).
        confidence: of the interval.
    """
    z, strata = deviate_of(confidence), np.searchsorted(EDGES, own)
    sizes = np.bincount(np.searchsorted(EDGES, every.ravel()), minlength=len(EDGES) + 1) / every.size
    groups: list[tuple[float, np.ndarray]] = []
    for k, size in enumerate(sizes):
        inside = good[strata == k]
        if groups and (not len(inside) or not len(groups[-1][1])):  # joins its neighbour
            groups[-1] = (groups[-1][0] + size, np.concatenate([groups[-1][1], inside]))
        else:
            groups.append((size, inside))
    value = spread = below = above = 0.0
    for size, inside in groups:
        share = float(inside.mean())
        lower, upper = score_interval(share, len(inside), z)
        value, spread = value + size * share, spread + size * share**2
        below, above = below + (size * (share - lower)) ** 2, above + (size * (upper - share)) ** 2
    sizes_unknown = z**2 * max(spread - value**2, 0.0) / every.shape[1]
    below, above = math.sqrt(below + sizes_unknown), math.sqrt(above + sizes_unknown)
    value = min(1.0, value)  # the sizes may add up to more by rounding
    return Estimate(value, (below + above) / (2 * z), max(0.0, value - below), min(1.0, value + above))


def whole_text(found: Whole, study: Study) -> str:
    """One line on the units of a four-bar or lost-motion study on the whole reducer.

    Args:
        found: what was measured.
        study: with the limits.
    """
    said = []
    for name, output in found.output.items():
        unit, size = study.output(name).shown
        mean = f", mean {with_unit(found.mean[name] / size, unit, '.3g')}" if output != name else ""
        said.append(f"{output} {100 * found.within[name]:.3g} % within the limit{mean}")
    known = "errors without a tolerance" + "".join(f", {name} (it has no place)" for name in found.unread)
    failed = f"; {found.failed} failed" if found.failed else ""
    return (
        f"On the whole reducer {share(found.share).text()} of these units meet all limits. Of {found.units} solved "
        f"units: {'; '.join(said)}{failed}. Not included: {known}."
    )


def unlimited_texts(found: Mapping[str, Unlimited], study: Study) -> list[str]:
    """A line for each usual limit that less than `SHARE` of the units keep.

    Args:
        found: what was measured.
        study: that does not limit it.
    """
    return [
        f"Not limited: {name}. {100 * (1 - one.share.value):.3g} % of the units miss a usual limit, "
        f"{limit_text(one.limit, study.output(name))} ({one.meaning})."
        for name, one in found.items()
        if one.missed
    ]


def unlimited_tables(found: Mapping[str, Unlimited], study: Study) -> list[Table]:
    """Outputs without a limit: value without errors and at `SHARE` of the units, next to a usual limit.

    Args:
        found: what was measured.
        study: that does not limit it.
    """
    rows: list[list[Cell]] = []
    for name, one in found.items():
        output = study.output(name)
        nominal = Quantity(one.nominal, output.unit, read_in=output.read_in)
        reached = Quantity.of(one.reached, output.unit, output.read_in)
        limit = limit_text(one.limit, output)
        rows.append([Titled(name, output.meaning), nominal, reached, limit, share(one.share), one.meaning])
    units = f"{100 * SHARE:g} % of the units"
    columns = [Text("not limited"), Number("without errors"), Interval(f"{units} [interval]", file_title=units)]
    columns += [Text("usual limit"), Interval("within it [interval]", file_title="within it"), Text("why", wraps=True)]
    return [Table("not_limited", columns, rows)] if rows else []
