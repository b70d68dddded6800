"""Identification of many units at once, separately or with shared elements, and the process that made them.

Mean and standard deviation of a process by expectation maximisation (Dempster, Laird and Rubin 1977, J. R. Stat. Soc.
B 39, 1). The elements of unit i are u_i = mu + D M z_i; their distribution given mu, D and the linearised data is
normal. The next mu is the mean of the units' expectations, the next D^2 the mean of their squared distances from mu
plus their variances.
"""

import dataclasses
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax.identify.elements import FAR, Elements, Spectrum, mapped_values, standard
from rvjax.identify.gauss_newton import Mode, info_of, weights_of
from rvjax.identify.goodness_of_fit import ADEQUATE, Fit, goodness, largest
from rvjax.identify.identification import Model, Problem, counted, integer
from rvjax.identify.observation import Noise
from rvjax.identify.posterior import limits_of, outcome
from rvjax.identify.search import APART, FAINT, ended_near, evidence_of, follow, lower_points, peak_of
from rvjax.identify.shared import Split, Units, joint_mode, linear_rows, triangular
from rvjax.population import Correlation, deviate_of
from rvjax.records import PyTree
from rvjax.status import SolveInfo, Status

ROUNDS = 1000
SETTLED = 1e-6
"""Largest change of a mean or spread, in standard deviations of the prior, that ends the iteration."""


@dataclasses.dataclass(frozen=True, eq=False)
class Process:
    """Mean and spread over units of every element; without information in the data they are those of the prior.

    Attributes:
        names: of the elements (p,).
        u_mean: mean of the standard numbers, 0 for the process of the drawing (p,).
        u_sd: their spread, 1 for the process of the drawing (p,).
        u_mean_sd: standard deviation of the mean; beyond about 1 the data do not determine it (p,).
        mean: {element: value at u_mean, SI}.
        sd: {element: half the distance of the values one spread to each side, SI}.
        cp: {element: distance of the limits over six spreads}, on the scale of u; inf for distributions within their
            limits.
        cpk: {element: distance of the mean from the nearer limit over three spreads}.
        units: how many were used.
    """

    names: tuple[str, ...]
    u_mean: np.ndarray
    u_sd: np.ndarray
    u_mean_sd: np.ndarray
    mean: dict[str, float]
    sd: dict[str, float]
    cp: dict[str, float]
    cpk: dict[str, float]
    units: int


def process(elements: Elements, names: tuple[str, ...], factors: np.ndarray) -> Process:
    """Estimate the process from its units.

    Args:
        elements: of the prior.
        names: of the elements that each unit has for itself.
        factors: triangular factors of [slopes over u, linearised data] of each unit (units, p + 1, p + 1).

    Raises:
        ValueError: fewer than two units.
    """
    if len(factors) < 2:
        raise ValueError(f"population: {len(factors)} units with a mode, a spread needs at least 2")
    places = [elements.names.index(name) for name in names]
    mixing = elements.mixing[places]
    mean, spread = _maximise(factors[:, :-1, :-1], factors[:, :-1, -1], mixing)
    every = np.zeros((3, elements.count))
    every[:, places] = mean + np.array([[0.0], [-1.0], [1.0]]) * spread
    values = mapped_values(elements, every)[:, places]
    low, high = _limits(elements)[:, places]
    cp = (high - low) / (6 * spread)
    cpk = np.minimum(high - mean, mean - low) / (3 * spread)

    def named(numbers: np.ndarray) -> dict[str, float]:
        return {name: float(number) for name, number in zip(names, numbers)}

    return Process(
        names=names,
        u_mean=mean,
        u_sd=spread,
        u_mean_sd=_mean_sd(factors[:, :-1, :-1], mixing, spread),
        mean=named(values[0]),
        sd=named(np.abs(values[2] - values[1]) / 2),
        cp=named(cp),
        cpk=named(cpk),
        units=len(factors),
    )


def _maximise(slopes: np.ndarray, data: np.ndarray, mixing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean, spread = np.zeros(len(mixing)), np.ones(len(mixing))
    eye = np.eye(mixing.shape[1])
    for _ in range(ROUNDS):
        over = slopes @ (spread[:, None] * mixing)
        turned = np.swapaxes(over, -1, -2)
        covariance = np.linalg.inv(eye + turned @ over)
        expected = covariance @ (turned @ (data - slopes @ mean)[..., None])
        root = spread[:, None] * mixing
        shift = (root @ expected)[..., 0]
        variance = ((root @ covariance) * root).sum(axis=-1)
        step = shift.mean(axis=0)
        new = np.sqrt(((shift - step) ** 2 + variance).mean(axis=0))
        change = max(np.abs(step).max(), np.abs(new - spread).max())
        mean, spread = mean + step, new
        if change < SETTLED:
            break
    return mean, spread


def _mean_sd(slopes: np.ndarray, mixing: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Standard deviation of the mean, from the information of all units and their spread; large without information."""
    over = slopes @ (spread[:, None] * mixing)
    inner = np.linalg.inv(np.eye(over.shape[-2]) + over @ np.swapaxes(over, -1, -2))
    information = (np.swapaxes(slopes, -1, -2) @ inner @ slopes).sum(axis=0)
    return np.sqrt(np.diag(np.linalg.inv(information + 1e-12 * np.eye(len(information)))))


def _limits(elements: Elements) -> np.ndarray:
    """Limits of the drawing on the scale of u (2, p), infinite where a distribution never reaches them."""
    ends = limits_of(elements, None)
    vectors = np.array([elements.population.active[field].is_vector for field in elements.fields])
    ends[0, vectors] = -ends[1, vectors]  # a component has the limit of the length to both sides
    places = np.asarray(standard(elements.population, jnp.asarray(ends)))
    return np.where(np.abs(places) > FAR - 1, np.sign(places) * np.inf, places)


SIDES = 512
"""Points in a call of the density next to a kink."""


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Identified errors of n units; the numbers of a unit are NaN where its `info` reports that no mode was found.

    Attributes:
        names: of the elements that each unit has for itself (p,).
        u: their most probable standard numbers (n, p).
        u_sd: posterior standard deviations (n, p), in those of the prior.
        value: most probable values, structure of the prior with the units on axis 0 of every leaf, SI.
        lower: lower ends of their intervals.
        upper: upper ends.
        shared_names: of the elements common to all units (q,).
        shared_u: their most probable standard numbers (q,).
        shared_u_sd: posterior standard deviations (q,).
        fit: how well model and prior explain each unit, arrays (n,).
        status: NONFINITE, MAX_STEPS, REJECTED, MULTIMODAL (with starts > 1) or CONVERGED of each unit (n,).
        info: of the solver alone, arrays (n,); `rvjax.check` takes the result.
        problem: model, prior and noise.
        factors: triangular factors of [slopes over the separate u, linearised data] of each unit (n, p + 1, p + 1).
    """

    names: tuple[str, ...]
    u: np.ndarray
    u_sd: np.ndarray
    value: PyTree
    lower: PyTree
    upper: PyTree
    shared_names: tuple[str, ...]
    shared_u: np.ndarray
    shared_u_sd: np.ndarray
    fit: Fit
    status: np.ndarray
    info: SolveInfo
    problem: Problem = dataclasses.field(repr=False)
    factors: np.ndarray = dataclasses.field(repr=False)

    def population(self) -> Process:
        """Estimate mean and standard deviation of the process, with Cp and Cpk, for every separate element.

        The most probable values of the units themselves lean towards the prior, each by as much as its data leave open.
        Units without a mode are excluded. What was shared stays at its most probable value.
        """
        return process(self.problem.elements, self.names, self.factors[np.isfinite(self.u).all(axis=1)])


@checked
def solve_many(
    model: Model,
    prior: object,
    data: object,
    *,
    noise: Noise,
    shared: str | Iterable[str] = (),
    nuisance: str | Iterable[str] = (),
    correlation: Correlation = None,
    starts: int = 1,
    seed: int = 0,
    max_steps: int = 50,
    chunk: int = 256,
    confidence: float = 0.95,
) -> Batch:
    """Identify the errors of many units from their measurements.

    Args:
        model: pure function, values of the prior's structure -> observation of one unit.
        prior: record or dict (nested ones too) with a `Tolerance`, a constant or None in each field.
        data: measured observations, the units on axis 0 of every leaf, NaN where missing.
        noise: of the observation of one unit.
        shared: names of fields that all units have in common, such as the stiffness of one test bench.
        nuisance: names of fields or elements that are not of interest; the model check does not count what they
            explain.
        correlation: {(field or element, field or element): correlation of their u}.
        starts: the mid-point of the prior, and units sampled from it; use several where a model may have several modes.
        seed: of the starts.
        max_steps: most steps of the solver.
        chunk: units (starts of units) that are in memory at once.
        confidence: of the intervals.

    Raises:
        ValueError: an argument that does not fit, or a correlation between shared and separate elements.
    """
    problem = Problem.of(model, prior, noise=noise, nuisance=nuisance, correlation=correlation)
    deviate = deviate_of(confidence)
    for name, value in (("starts", starts), ("max_steps", max_steps), ("chunk", chunk)):
        counted(name, value, 1)
    y = problem.layout.data(data, batched=True)
    rng = np.random.default_rng(integer("seed", seed) % 2**64)
    points = rng.standard_normal((starts, problem.elements.mixing.shape[1]))
    points[0] = 0.0
    split = Split.of(problem.elements, shared)
    together = min(len(y), max(1, chunk // starts))
    rows = [slice(start, start + together) for start in range(0, len(y), together)]
    if split.shared.size:
        joint = joint_mode(problem, split, y, points, max_steps, rows)
        by_chunk = (joint.units(part) for part in rows)
        shared_u, shared_sd = joint.shared_u, joint.shared_sd
    else:
        by_chunk = (_separate(problem, y[part], points, max_steps, together) for part in rows)
        shared_u = shared_sd = np.zeros(0)
    parts = [_figures(problem, split, y[part], units, deviate) for part, units in zip(rows, by_chunk)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if name != "worst"}
    elements = problem.elements
    return Batch(
        names=tuple(elements.names[i] for i in split.own),
        u=whole["u"][:, split.own],
        u_sd=whole["u_sd"][:, split.own],
        value=elements.structure(whole["value"]),
        lower=elements.structure(whole["lower"]),
        upper=elements.structure(whole["upper"]),
        shared_names=tuple(elements.names[i] for i in split.shared),
        shared_u=shared_u,
        shared_u_sd=shared_sd,
        fit=Fit(
            **{f.name: whole[f.name] for f in dataclasses.fields(Fit) if f.name != "worst"},
            worst=tuple(names for part in parts for names in part["worst"]),
        ),
        status=whole["outcome"],
        info=info_of(whole["status"], whole["steps"], whole["away"]),
        problem=problem,
        factors=whole["factors"],
    )


def _separate(problem: Problem, y: np.ndarray, points: np.ndarray, max_steps: int, together: int) -> Units:
    """Modes of largest weight of separate units y (k, m); one program for any number of units in the last chunk."""
    starts = len(points)
    at = np.tile(points, (len(y), 1))
    ends = follow(problem, np.repeat(y, starts, axis=0), at, max_steps, together=together * starts)
    lanes = jax.tree.map(lambda leaf: leaf.reshape(len(y), starts, *leaf.shape[1:]), ends)
    _accept_kinks(problem, y, lanes)
    good = lanes.info.status == Status.CONVERGED
    z = np.where(good[..., None], lanes.z, 0.0)
    slopes = np.where(good[..., None, None], lanes.slopes, 0.0)
    residual = np.where(good[..., None], lanes.residual, 0.0)
    rows = linear_rows(problem, slopes, z @ problem.elements.mixing.T, residual)
    spectrum = Spectrum.of(np.sqrt(problem.discount) * rows[..., :-1] @ problem.elements.mixing)
    evidence = evidence_of(problem, z, residual, spectrum.nats, ~np.isnan(y)[:, None])
    # Without any mode the lowest finite point is returned, and a point that is not finite only where all are not.
    rank = np.where(good, evidence, np.where(np.isfinite(lanes.phi), -1e300, -2e300))
    best = np.argmax(rank, axis=1)
    own = np.arange(len(y))
    apart = z - z[own, best][:, None]
    across = np.einsum("ksji,ksj->ksi", spectrum.right, apart) ** 2 * (1 + spectrum.eigenvalues)
    lighter = np.exp(np.minimum(rank - rank[own, best][:, None], 0.0))
    several = (good & (across.sum(axis=-1) >= APART**2) & (lighter > FAINT)).any(axis=1)
    info, z, residual, rows, spectrum = jax.tree.map(
        lambda leaf: leaf[own, best], (lanes.info, z, residual, rows, spectrum)
    )
    mixing = problem.elements.mixing
    u_sd = np.linalg.norm(mixing @ spectrum.root, axis=-1)
    return Units(z @ mixing.T, u_sd, residual, rows, several, info.status, info.steps, info.residual)


def _accept_kinks(problem: Problem, y: np.ndarray, lanes: Mode) -> None:
    """Accept the lowest end of a unit (k, starts) without a mode, where it is the lowest point of a kink."""
    near = ended_near(lanes.info)
    wanting = near.any(axis=1) & (lanes.info.status != Status.CONVERGED).all(axis=1)
    for unit in np.flatnonzero(wanting):
        lane = int(np.argmin(np.where(near[unit], lanes.phi[unit], np.inf)))
        peak = peak_of(problem, y[unit], lanes, (int(unit), lane))
        if not lower_points(problem, y[unit], peak, SIDES, bent=True):
            lanes.info.status[unit, lane] = Status.CONVERGED


def _figures(problem: Problem, split: Split, y: np.ndarray, units: Units, deviate: float) -> dict[str, PyTree]:
    """Compute all results of some units of a batch."""
    elements, seen, good = problem.elements, ~np.isnan(y), units.status == Status.CONVERGED
    u = np.where(good[:, None], units.u, 0.0)
    slopes, datum = units.rows[..., :-1], units.rows[..., -1]
    judged = goodness(slopes, elements.mixing, problem.nuisance, datum, seen, problem.dof)
    weights = seen * weights_of(units.residual, problem.dof)
    middle, one, other = (
        mapped_values(elements, u + sign * deviate * np.where(good[:, None], units.u_sd, 1.0)) for sign in (0, -1, 1)
    )
    common = np.einsum("kmp,kp->km", slopes[..., split.shared], u[:, split.shared])
    own = np.concatenate([slopes[..., split.own], (datum - common)[..., None]], axis=-1)
    factors = triangular(own if problem.dof is None else np.sqrt(weights)[..., None] * own)
    adequate = judged["p_model"] >= ADEQUATE

    def known(numbers: np.ndarray) -> np.ndarray:
        return np.where(good.reshape(-1, *[1] * (np.ndim(numbers) - 1)), numbers, np.nan)

    figures = {name: known(item) if item.dtype.kind == "f" else item for name, item in judged.items()}
    names = problem.layout.names
    return figures | dict(
        u=known(u),
        u_sd=known(units.u_sd),
        value=known(middle),
        lower=known(np.minimum(one, other)),
        upper=known(np.maximum(one, other)),
        weights=known(weights),
        worst=[largest(residual, names) for residual in units.residual],
        outcome=np.array(
            [str(outcome(int(s), bool(a), 1 + bool(h), True)) for s, a, h in zip(units.status, adequate, units.several)]
        ),
        status=units.status,
        steps=units.steps,
        away=units.away,
        factors=factors,
    )
