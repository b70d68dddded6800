"""Root sum of squares: the moments of a response from its derivatives at the mean errors."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax._jax.sizes import PULLED
from rvjax.population import Correlation, Population, batch_correlation, drawn, root_key
from rvjax.records import PyTree
from rvjax.response import (
    BLOCK,
    Response,
    by_name,
    by_response,
    elements,
    evaluate,
    gradients,
    per_response,
    respond_units,
    response_names,
)
from rvjax.status import succeeded
from rvjax.tolerances.limits import Limits

_TERMS = 23  # of Hermite series
_SEEN = 16384  # units behind mean and sd of a response with a kink
_PROBES = 255  # units whose gradients decide whether the response has a kink, and replace it
_WHOLE, _MEAN = 0.1, 0.03  # of the sd of the units: Cpk is wrong by a third of these at most
_STEP = 1e-3  # of a unit's deviations: a smooth gradient is nearly constant so near the mean


@dataclasses.dataclass(frozen=True)
class Moments:
    """Mean and spread of a response; every field but `method` has its structure.

    Attributes:
        mean: unit of the response.
        sd: standard deviation.
        cpk: min(U - mean, mean - L)/(3 sd); None without requirement.
        yield_: share within the limits if the response were normal; None without requirement.
        contributions: {field: share of the variance}, summing to 1 (all 0 if nothing varies).
        sensitivities: {field: derivative of the response per element}; its root mean square over
            units where the method is "sampled".
        method: "first order", "second order", or "sampled" where units show that slope and curvature at the mean do
            not describe the response.
    """

    mean: PyTree
    sd: PyTree
    cpk: PyTree
    yield_: PyTree
    contributions: PyTree
    sensitivities: PyTree
    method: PyTree


@checked
def rss(
    response: Response,
    tolerances: object,
    *,
    order: int = 1,
    requirements: object = None,
    correlation: Correlation = None,
) -> Moments:
    """Moments of a response by propagation of the errors' moments.

    Order 1: mean f(E e), variance g' Sigma g with the gradient g at the mean errors. Order 2 adds the
    curvature and the third and fourth moments of the errors: exact for a quadratic response of
    independent errors, or of normal errors with batch factors.

    A peak-to-peak value has a kink where its errors vanish: the gradient there does not describe its
    neighbourhood. Where gradients of 255 random units close to the mean show such a jump, or where slope and
    curvature there miss the values of these units (by 10 % of their sd, or by 3 % of it in the mean, as many weak
    kinks together do), mean and sd come from 16384 units and the shares from mean squared gradients; `method` is then
    "sampled".

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        order: 1 or 2. Use 1 where contact makes the curvature unbounded.
        requirements: `Requirement`, or a dict of them by name of the response; for cpk and yield.
        correlation: {(field or element, field or element): correlation of their z}. The share of a field is
            then its part of g' Sigma g, which may be negative.

    Raises:
        ValueError: another order, or order 2 of correlated errors that are not normal.
    """
    if order not in (1, 2):
        raise ValueError(f"order = {order!r}: must be 1 or 2")
    population = Population.of(tolerances, correlation)
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    law = Spread(population)
    found = _by_name(response, population, names, law, order)
    for name in (name for name, item in found.items() if item.method == "sampled"):
        mean, variance = _seen(response, population, name)
        found[name] = dataclasses.replace(found[name], mean=mean, total=variance)
    results = {name: _figures(item, required.get(name), law) for name, item in found.items()}
    moments = by_name(Moments, results)
    if not any(item.of_units for item in required.values()):
        moments = dataclasses.replace(moments, cpk=None, yield_=None)
    return moments


def _by_name(
    response: Response, population: Population, names: tuple[str, ...], law: "Spread", order: int
) -> dict[str, "_Propagated"]:
    """Moments of each response from the gradients; NaN mean and sd of a response with a kink."""
    value, at_mean, near, far, away, beyond = _derivatives(response, population, law.mean, names)
    found = {}
    for k, name in enumerate(names):
        gradient = at_mean[k]
        changes = beyond[k] - value[k]
        if _kink(gradient, near[k], far[k], law.sd) or _missed(changes, gradient, near[k], away, abs(value[k])):
            found[name] = _sampled(far[k], law)
        elif order == 1:
            found[name] = _Propagated(float(value[k]), law.shares(gradient), gradient, "first order")
        else:
            mean = jnp.asarray(law.mean, jnp.result_type(float))
            hessian = np.asarray(_hessian(response, population, mean, name=name), float)
            found[name] = _second_order(float(value[k]), gradient, hessian, law)
    return found


class Spread:
    """Moments of all active elements in one vector, field after field."""

    def __init__(self, population: Population) -> None:
        self.population, self.fields, rows = population, population.active, [np.zeros((0, 4))]
        for tolerance in self.fields.values():
            columns = [np.broadcast_to(moment, tolerance.shape).reshape(-1) for moment in tolerance.moments()]
            rows.append(np.stack(columns, axis=1))
        self.mean, self.variance, self.third, self.fourth = np.concatenate(rows).T
        self.sd = np.sqrt(self.variance)
        mixing = population.mixing
        z_matrix = batch_correlation(self.fields) if mixing is None else np.asarray(mixing @ mixing.T)
        self.correlation = _of_errors(z_matrix, population)
        coupled = any(t.law.couples for t in self.fields.values())
        self.independent = not coupled and bool((self.correlation == np.eye(len(self.mean))).all())

    def block(self, name: str) -> np.ndarray:
        """Covariance of the elements of one field.

        Args:
            name: of the field.
        """
        own = self.rows(np.arange(len(self.mean)))[name]
        return self.correlation[np.ix_(own, own)] * np.outer(self.sd[own], self.sd[own])

    def shares(self, gradient: np.ndarray) -> dict[str, float]:
        """Parts of g' Sigma g by field.

        Args:
            gradient: of a response (elements,).
        """
        scaled = gradient * self.sd
        return self.sums(scaled * (self.correlation @ scaled))

    def sums(self, values: np.ndarray) -> dict[str, float]:
        """Sums of a vector over all elements, by field.

        Args:
            values: of the elements (elements,).
        """
        return {n: float(part.sum()) for n, part in self.population.by_field(values).items()}

    def rows(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Rows (elements of the field, n) of an array (elements, n), by field.

        Args:
            values: a row for each element.
        """
        ends = np.cumsum([math.prod(t.shape) for t in self.fields.values()])
        return dict(zip(self.fields, np.split(values, ends[:-1])))


def _of_errors(z_matrix: np.ndarray, population: Population) -> np.ndarray:
    """Correlation of the errors from that of their z, through the maps q(Phi(z)).

    By the Hermite series of the maps, corr(q_i, q_j) = sum_k rho^k a_ik a_jk with a_k = E[q He_k]/sqrt(k!),
    normalised to sum a_k^2 = 1; for normal errors it is rho itself.
    """
    found, start = z_matrix.copy(), 0
    if not (z_matrix == np.eye(len(z_matrix))).all():
        a = _hermite_series(population)
        found = np.sum([z_matrix**k * np.outer(a[:, k - 1], a[:, k - 1]) for k in range(1, _TERMS + 1)], axis=0)
        np.fill_diagonal(found, 1.0)
    for name, tolerance in population.active.items():
        stop = start + math.prod(tolerance.shape)
        if tolerance.law.couples:
            if np.delete(z_matrix[start:stop], np.arange(start, stop), axis=1).any() or tolerance.batch:
                raise ValueError(
                    f"{name}: rss does not include correlated {tolerance.distribution} vectors; use monte_carlo"
                )
            block = tolerance.law.correlation(tolerance)
            for first in range(start, stop, len(block)):
                found[first : first + len(block), first : first + len(block)] = block
        start = stop
    return found


def _hermite_series(population: Population) -> np.ndarray:
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    basis = np.polynomial.hermite_e.hermevander(nodes, _TERMS)[:, 1:] * weights[:, None]
    scale = np.array([math.sqrt(math.factorial(k)) for k in range(1, _TERMS + 1)])
    rows = []
    for tolerance in population.active.values():
        series, size = np.eye(_TERMS)[0], 1.0
        if not (tolerance.law.is_normal(tolerance) or tolerance.law.couples):
            mapped = np.asarray(tolerance.deviate(jnp.asarray(nodes)), float) @ basis / scale
            length = float(np.linalg.norm(mapped))
            series, size = (mapped, length) if length else (series, size)
        rows += [series / size] * math.prod(tolerance.shape)
    return np.array(rows).reshape(-1, _TERMS)


@dataclasses.dataclass(frozen=True)
class _Propagated:
    mean: float
    variances: dict[str, float]  # by field; their sum is the variance, but for `extra`
    gradient: np.ndarray
    method: str
    total: float | None = None  # variance where it is not the sum of the shares


def _figures(item: _Propagated, requirement: Limits | None, law: Spread) -> dict[str, object]:
    shared = sum(item.variances.values())
    sd = math.sqrt(max(0.0, shared if item.total is None else item.total))
    limits = requirement if requirement is not None and requirement.of_units else None
    return dict(
        mean=item.mean,
        sd=sd,
        cpk=limits.capability(item.mean, sd)[1] if limits else None,
        yield_=limits.normal_yield(item.mean, sd) if limits else None,
        contributions={n: v / shared if shared > 0 else 0.0 for n, v in item.variances.items()},
        sensitivities={n: v if v.shape else float(v) for n, v in law.population.by_field(item.gradient).items()},
        method=item.method,
    )


def _second_order(value: float, g: np.ndarray, h: np.ndarray, law: Spread) -> _Propagated:
    """Moments of f + g'd + d'Hd/2; exact second moments of the quadratic form."""
    covariance, curvature = law.correlation * np.outer(law.sd, law.sd), np.diag(h)
    mean = value + 0.5 * float((h * covariance).sum())
    normal = all(t.law.is_normal(t) for t in law.fields.values())
    if not (law.independent or normal):
        raise ValueError("order = 2: correlated errors must be normal; use order = 1 or monte_carlo")
    rows = 0.5 * ((h @ covariance) * (h @ covariance).T).sum(axis=1)  # tr(H Sigma H Sigma)/2, by element
    # What the third and fourth moments add to the normal distribution, for independent elements.
    rows += g * curvature * law.third + 0.25 * curvature**2 * (law.fourth - 3 * law.variance**2) * law.independent
    bent = law.sums(rows)
    variances = {n: share + bent[n] for n, share in law.shares(g).items()}
    return _Propagated(mean, variances, g, "second order")


def _kink(gradient: np.ndarray, near: np.ndarray, far: np.ndarray, sd: np.ndarray) -> bool:
    """Does the gradient jump within a thousandth of a unit's deviations, by more than 10 % of its size there?"""
    if not np.isfinite(gradient).all():
        return bool(np.isfinite(far).any())
    jump, size = (((v * sd) ** 2).sum(axis=1) for v in (near - gradient, far))
    seen = np.isfinite(jump) & np.isfinite(size)
    return bool(seen.any() and jump[seen].mean() > 0.01 * size[seen].mean())


def _missed(changes: np.ndarray, gradient: np.ndarray, near: np.ndarray, away: np.ndarray, size: float) -> bool:
    """Do slope and curvature at the mean miss the changes of the response at whole units (units,)?

    A jump of the gradient close to the mean is a kink there, which grows with the deviation, or curvature, which grows
    with its square: what misses more either way counts. The first order leaves curvature out on purpose.
    """
    straight, jump = gradient @ away, ((near - gradient) * away.T).sum(axis=1)
    sound = np.isfinite(changes) & np.isfinite(jump)
    if sound.sum() < 2 or not np.isfinite(gradient).all():
        return False
    sd, rounding = changes[sound].std(), 8 * float(jnp.finfo(jnp.result_type(float)).eps) * size

    def miss(part: np.ndarray) -> bool:
        rest = (changes - straight - part)[sound]
        certain = max(_MEAN * sd, 3 * rest.std() / math.sqrt(len(rest)), rounding)
        return bool(rest.std() > max(_WHOLE * sd, rounding) or abs(rest.mean()) > certain)

    return bool(np.abs(jump[sound].mean()) > _MEAN * sd) or (miss(jump) and miss(jump / (2 * _STEP)))


def _sampled(gradients: np.ndarray, law: Spread) -> _Propagated:
    """Shares and mean squares of the gradients of whole units."""
    gradients = gradients[np.isfinite(gradients).all(axis=1)]
    of_units = [law.shares(gradient) for gradient in gradients]
    shares = {n: sum(unit[n] for unit in of_units) / max(1, len(of_units)) for n in law.fields}
    return _Propagated(math.nan, shares, np.sqrt((gradients**2).mean(axis=0)), "sampled")


def _seen(response: Response, population: Population, name: str) -> tuple[float, float]:
    """Mean and variance of a response over units."""
    blocks = [respond_units(response, population, root_key(0), i, count=BLOCK) for i in range(0, _SEEN, BLOCK)]
    found = [np.asarray(values[name], float)[succeeded(np.asarray(status))] for values, status in blocks]
    valid = np.concatenate(found)
    valid = valid[np.isfinite(valid)]
    return float(valid.mean()), float(valid.var(ddof=1))


def _derivatives(
    response: Response, population: Population, mean: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, ...]:
    """Values (k,) and gradients (k, n) at the mean; gradients (k, units, n) near it and at whole units.

    Then the deviations of these units (n, units) and their values (k, units).
    """
    z = np.asarray(drawn(population, root_key(0), np.uint32(0), count=BLOCK))[:, :PULLED]  # shapes that are compiled
    units = np.asarray(elements(population, z))[:, :_PROBES]
    away = units - mean[:, None]
    points = np.concatenate([mean[:, None], mean[:, None] + _STEP * away, units], axis=1)
    # One batch element per point and value: one reverse pass, units last, compiles in half the time of a Jacobian.
    count, cotangents = points.shape[1], np.repeat(np.eye(len(names)), points.shape[1], axis=1)
    values, _, found = gradients(response, population, np.tile(points, len(names)), cotangents)
    found = found.reshape(-1, len(names), count).transpose(1, 2, 0)
    beyond = values[:, 1 + _PROBES : count]
    return values[:, 0], found[:, 0], found[:, 1 : 1 + _PROBES], found[:, 1 + _PROBES :], away, beyond


@per_response(static=("name",))
def _hessian(response: Response, population: Population, mean: jax.Array, *, name: str) -> jax.Array:
    def value(vector: jax.Array) -> jax.Array:
        values, _ = evaluate(response, population.fill(population.by_field(vector)))
        return values[name]

    return jax.hessian(value)(mean)
