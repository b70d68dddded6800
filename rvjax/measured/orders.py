"""Orders of a curve that a correction table may hold, and the noise of an order from the orders about it.

Readings with memory (a warm bench, a filter, a drifting zero) have more noise at low orders than at high ones. The
level follows from the spectrum of the residual, without what the measured object causes.
"""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy

from rvjax import identify
from rvjax.identify import Orders
from rvjax.measured.curve_analysis import DRIFTS, FASTEST, MOTOR, Judged
from rvjax.measured.run import spectrum
from rvjax.measured.terms import LOW, TINY, Model, Term

KNOTS = 4  # of a level, equal distances of the logarithm of the order
LOWEST = 5.0  # order from which the level is read; below it is extended, since mountings cause the lowest orders
STEEPEST = -2.0  # power of the order; noise that adds up from reading to reading has -2
COLOURED = 6.25  # likelihood ratio of noise without memory: chance of 0.1 with three degrees of freedom
FEWEST = 16  # orders that determine a level
KNOWN = 1e12  # orders that determine the level of independent readings: it is that of all residuals
REACH, LEAST = 0.6, 3  # logarithm of the order over which a level is one; fewest orders of it
OUTLIER = 2.0  # logarithm of a power beyond which it counts as content, not as noise
EULER, MEDIAN = float(np.euler_gamma), math.log(math.log(2))  # of the logarithm of an exponential number


def noise_level(
    model: Model, sd: float, orders: np.ndarray, parts: Iterable[float], top: float
) -> tuple[np.ndarray, np.ndarray]:
    """Power of the noise at each order, of that of independent readings, at least 1; and how many orders determine it.

    Args:
        model: of the curve.
        sd: of a reading about all orders that are fitted.
        orders: whose noise is required (k,).
        parts: orders that the measured object causes.
        top: highest order of the noise that is used.
    """
    white = np.ones(len(orders)), np.full(len(orders), KNOWN)
    span = float(np.ptp(model.angle)) * len(model.angle) / max(len(model.angle) - 1, 1)
    if not sd > 0 or not span > 0 or top < 2 * LOWEST:
        return white
    step = 2 * math.pi / span
    named = list(parts)
    weak = [a for a in model.terms if a.kind == "order" and LOWEST <= a.at <= 2 * LOWEST and a.at not in named]
    residual = model.residual + model.curve(weak)  # content among the lowest orders of noise is an outlier there
    taken = np.array([-1.0, *(a.at for a in model.terms if a.kind in ("order", "line") and a not in weak)])
    bins = np.arange(math.ceil(LOWEST / step), math.floor(top / step) + 1) * step
    bins = bins[np.min(np.abs(bins[:, None] - taken), axis=1) > 0.9 * step] if len(bins) else bins
    if len(bins) < FEWEST:
        return white
    order, size = spectrum(model.angle, residual, top + step)
    power = np.interp(bins, order, np.abs(size) ** 2) / (len(residual) * sd**2)  # exponential, mean 1
    knots = np.linspace(math.log(bins[0]), math.log(bins[-1]), KNOTS)
    log_power = np.log(np.maximum(power, 1e-12))
    hats = np.array([np.interp(np.log(bins), knots, row) for row in np.eye(KNOTS)]).T

    def cost(numbers: np.ndarray, shape: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the logarithm of the likelihood; a power far above the level counts as content."""
        off = log_power - shape @ numbers
        held = np.exp(np.minimum(off, OUTLIER))
        inside = off < OUTLIER
        return float(np.sum(held - np.minimum(off, OUTLIER))), shape.T @ (inside * (1 - held))

    def fit(shape: np.ndarray) -> scipy.optimize.OptimizeResult:
        first = np.full(shape.shape[1], np.median(log_power) - MEDIAN)
        near = scipy.optimize.least_squares(
            lambda x: shape @ x - log_power - EULER, first, lambda _: shape, loss="soft_l1"
        )
        return scipy.optimize.minimize(cost, near.x, args=(shape,), jac=True, method="BFGS")

    level, flat = fit(hats), fit(np.ones((len(bins), 1)))
    if 2 * (flat.fun - level.fun) < COLOURED:
        return white
    at = np.log(orders)
    falling = np.maximum.accumulate(level.x[::-1])[::-1]  # no less at low orders than at high ones
    slopes = (falling[1:3] - falling[0]) / (knots[1:3] - knots[0])
    size = np.interp(at, knots, falling) + max(float(slopes.min()), STEEPEST) * np.minimum(at - knots[0], 0.0)
    reach = np.abs(np.log(bins) - np.maximum(at, knots[0])[:, None]) < REACH
    return np.maximum(np.exp(size), 1.0), np.maximum(np.sum(reach, axis=1), LEAST).astype(float)


SPARE = 4  # places for every number that is fitted
WEAK = 3.0  # times the noise of a whole revolution: an order that the stroke does not determine
APART = 0.3  # distance, over the resolution of the stroke, at which a line and the order of a part are separable
SLOW = 3  # highest order that resembles a drift
PLAIN = 6.0  # minus twice the logarithm of the likelihood by which a low order must be better than a drift
SIDE = 3  # distance of an order from one of a part at which housings and mountings cause orders
CHANCE = 0.001
"""Chance that at least one of the stored orders is noise."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """Orders of a curve.

    Attributes:
        found: by least squares; `sd` contains the noise of the orders about each, and that of a drift.
        seen: positions of the orders that exceed noise and are no alias (s,).
        unsure: {order: why it is not stored} of the others that exceed noise.
        colour: largest power of the noise of an order, of that of independent readings.
    """

    found: Orders
    seen: np.ndarray
    unsure: dict[int, str]
    colour: float


def fitted(judged: Judged, most: int) -> Fitted:
    """Orders of a curve, and those that its readings prove.

    Args:
        judged: the curve.
        most: highest order.

    Raises:
        ValueError: too few readings.
    """
    orders = _orders(judged, most)
    harmonics = identify.orders(judged.angle, judged.error - _beyond(judged, most), orders)
    white_sd = harmonics.residual_sd
    share, count = noise_level(judged.model, white_sd, orders, judged.parts.values(), _top(judged, most))
    plain = harmonics.sd
    sd = np.sqrt(harmonics.sd**2 * share + _of_drift(judged, orders) ** 2)
    tries = max(len(orders), 1) / CHANCE
    # Power of noise over the mean of `count` others: beyond x with a chance of (1 + x/count)^-count.
    limit = count * np.expm1(math.log(tries) / count)
    strong = np.flatnonzero(np.abs(harmonics.value) ** 2 > 2 * sd**2 * limit)
    harmonics = dataclasses.replace(harmonics, sd=sd)
    least = white_sd * math.sqrt(2 / len(judged.angle))
    unsure = {}
    for k in strong:
        why = "the stroke does not determine it" if plain[k] > WEAK * least else doubt(judged, float(orders[k]))
        if not why and _may_drift(judged, orders[strong], int(orders[k])):
            why = "it may be a drift"
        if why:
            unsure[int(orders[k])] = why
    seen = np.array([k for k in strong if int(orders[k]) not in unsure], int)
    return Fitted(harmonics, seen, unsure, float(np.max(share, initial=1.0)))


def _top(judged: Judged, most: int) -> float:
    """Highest order whose noise is used for the level."""
    density = len(judged.angle) / (2 * max(judged.sampling.turns, 1e-9))
    return min(judged.sampling.finest, density, 1.5 * most)


def _beyond(judged: Judged, most: int) -> np.ndarray:
    """Curve of the orders beyond the highest one (n,)."""
    model, kept = judged.model, np.isin(judged.model.angle, judged.angle)
    return model.curve([term for term in model.terms if term.kind == "order" and term.at > most])[kept]


def _orders(judged: Judged, most: int) -> np.ndarray:
    """Orders that are fitted: all that the number of places admits, and those that were found."""
    points = len(judged.angle)
    spread = points > 1 and judged.sampling.stroke > 0
    few = min(most, (points // SPARE - 1) // 2) if judged.sampling.whole or not spread else 1
    own = [int(term.at) for term in judged.found("order") if term.at <= most]
    if few > 1 and spread and 2 * len({*own, *range(1, few + 1)}) + 1 > points // 2:
        few = 1
    return np.array(sorted({*own, *range(1, few + 1)}), int)


def _of_drift(judged: Judged, orders: np.ndarray) -> np.ndarray:
    """Standard deviation of each order from that of the drift that was taken off (k,)."""
    variance = np.zeros(len(orders))
    for term in judged.found("drift", "warm-up", "step"):
        covariance = judged.model.size(term)[1] * judged.noise**2
        kept = np.isin(judged.model.angle, judged.angle)
        column = term.columns(judged.model.angle)[kept, 0]
        leak = identify.orders(judged.angle, column - column.mean(), orders).value
        variance += np.abs(leak) ** 2 * covariance[0, 0]
    return np.sqrt(variance)


def _may_drift(judged: Judged, strong: np.ndarray, order: int) -> bool:
    """True if a drift explains the curve as well as a low order; few places leave a drift unfound."""
    if order > SLOW or order in judged.parts.values() or judged.found(*DRIFTS):
        return False
    others = [Term("order", float(k)) for k in strong if k != order]
    drift, wave = (
        Model(judged.angle, judged.error, [*others, term]).residual for term in (Term("drift"), Term("order", order))
    )
    return len(wave) * math.log(max(float(drift @ drift), TINY) / max(float(wave @ wave), TINY)) < PLAIN


def doubt(judged: Judged, order: float) -> str:
    """Name the order that this one may be; "" if it is not another one.

    Args:
        judged: the curve.
        order: whole number per revolution.
    """
    sampling, parts = judged.sampling, judged.parts
    lines = [(abs(term.at - order) * sampling.turns, term.at) for term in judged.found("line")]
    near = sorted(line for line in lines if line[0] < 1)
    if near and (len(near) > 1 or order not in parts.values() or near[0][0] < APART):
        return f"order {near[0][1]:.5g} is next to it"
    if order >= sampling.finest:
        return f"it may be order {judged.looks_like(order):g}"
    if names := judged.hidden(order):
        name, own = next(iter(names.items()))
        return f"it may be order {own:.5g} ({name})"
    if order in parts.values() or not math.isfinite(sampling.repeat):
        return ""
    fastest = max(judged.driven)
    other = sampling.repeat - order
    if other > FASTEST * fastest:
        return ""
    named = any(name in MOTOR for name in parts)
    others = [own for name, own in parts.items() if (name not in MOTOR if named else own < fastest - 1)]
    whole = [own for own in others if own == round(own)]
    if order > LOW and min((abs(order - own) for own in whole), default=math.inf) > SIDE:
        return f"it may be order {other:g}"
    several = (n * own for n in range(2, FASTEST + 1) for own in judged.driven)  # also seen from the output
    alias = next((own for own in several if sampling.alike(own, order)), None)
    return "" if alias is None else f"it may be order {alias:.5g}, a harmonic of the fastest part"
