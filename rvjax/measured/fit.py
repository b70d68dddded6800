"""Orders of a curve that a correction table may hold."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from rvjax import identify
from rvjax.identify import Orders
from rvjax.measured import level
from rvjax.measured.judge import DRIFTS, FASTEST, MOTOR, Judged
from rvjax.measured.search import LOW

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
    found = identify.orders(judged.angle, judged.error - _beyond(judged, most), orders)
    white_sd = found.residual_sd
    share, count = level.factor(judged.model, white_sd, orders, judged.parts.values(), _top(judged, most))
    plain = found.sd
    sd = np.sqrt(found.sd**2 * share + _of_drift(judged, orders) ** 2)
    tries = max(len(orders), 1) / CHANCE
    # Power of noise over the mean of `count` others: beyond x with a chance of (1 + x/count)^-count.
    limit = count * np.expm1(math.log(tries) / count)
    strong = np.flatnonzero(np.abs(found.value) ** 2 > 2 * sd**2 * limit)
    found = dataclasses.replace(found, sd=sd)
    least = white_sd * math.sqrt(2 / len(judged.angle))
    unsure = {}
    for k in strong:
        why = "the stroke does not determine it" if plain[k] > WEAK * least else doubt(judged, float(orders[k]))
        if not why and _may_drift(judged, orders[strong], int(orders[k])):
            why = "it may be a drift"
        if why:
            unsure[int(orders[k])] = why
    seen = np.array([k for k in strong if int(orders[k]) not in unsure], int)
    return Fitted(found, seen, unsure, float(np.max(share, initial=1.0)))


def _top(judged: Judged, most: int) -> float:
    """Highest order whose noise is used for the level."""
    density = len(judged.angle) / (2 * max(judged.sampling.turns, 1e-9))
    return min(judged.sampling.finest, density, 1.5 * most)


def _beyond(judged: Judged, most: int) -> np.ndarray:
    """Curve of the orders beyond the highest one (n,)."""
    model, kept = judged.model, np.isin(judged.model.angle, judged.angle)
    return model.curve([atom for atom in model.atoms if atom.kind == "order" and atom.at > most])[kept]


def _orders(judged: Judged, most: int) -> np.ndarray:
    """Orders that are fitted: all that the number of places admits, and those that were found."""
    points = len(judged.angle)
    spread = points > 1 and judged.sampling.stroke > 0
    few = min(most, (points // SPARE - 1) // 2) if judged.sampling.whole or not spread else 1
    own = [int(atom.at) for atom in judged.found("order") if atom.at <= most]
    if few > 1 and spread and 2 * len({*own, *range(1, few + 1)}) + 1 > points // 2:
        few = 1
    return np.array(sorted({*own, *range(1, few + 1)}), int)


def _of_drift(judged: Judged, orders: np.ndarray) -> np.ndarray:
    """Standard deviation of each order from that of the drift that was taken off (k,)."""
    variance = np.zeros(len(orders))
    for atom in judged.found("drift", "warm-up", "step"):
        covariance = judged.model.size(atom)[1] * judged.noise**2
        kept = np.isin(judged.model.angle, judged.angle)
        column = atom.columns(judged.model.angle)[kept, 0]
        leak = identify.orders(judged.angle, column - column.mean(), orders).value
        variance += np.abs(leak) ** 2 * covariance[0, 0]
    return np.sqrt(variance)


def _may_drift(judged: Judged, strong: np.ndarray, order: int) -> bool:
    """True if a drift explains the curve as well as a low order; few places leave a drift unfound."""
    if order > SLOW or order in judged.parts.values() or judged.found(*DRIFTS):
        return False
    angle, error = judged.angle, judged.error
    columns = {int(k): [np.cos(k * angle), np.sin(k * angle)] for k in strong}
    others = [np.ones_like(angle), *(c for k, own in columns.items() if k != order for c in own)]

    def left(more: list[np.ndarray]) -> float:
        rows = np.stack([*others, *more], axis=1)
        return float(np.sum((error - rows @ np.linalg.lstsq(rows, error, rcond=None)[0]) ** 2))

    return len(angle) * math.log(max(left([angle]), 1e-300) / max(left(columns[order]), 1e-300)) < PLAIN


def doubt(judged: Judged, order: float) -> str:
    """Name the order that this one may be; "" if it is not another one.

    Args:
        judged: the curve.
        order: whole number per revolution.
    """
    sampling, parts = judged.sampling, judged.parts
    lines = [(abs(atom.at - order) * sampling.turns, atom.at) for atom in judged.found("line")]
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
