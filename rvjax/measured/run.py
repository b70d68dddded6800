"""Runs of a bench: conditions and findings, and the sampling of a curve.

A sampling has passes of the angle, repeated readings, stroke, and the order at which the angles repeat.
"""

import dataclasses
import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np

from rvjax.units import deg, rpm

DIRECTIONS = {"forward": 1, "backward": -1}


@dataclass(frozen=True)
class Conditions:
    """Conditions of a measurement.

    Attributes:
        unit: name of the unit, "" where the file has no column for it.
        torque: N m, None where the file does not say.
        direction: "forward" or "backward".
        temperature: degC, None where the file does not say.
        speed: of the input, rad/s, None where the file does not say.
        stated: whether the file has directions; without them every run is forward.
    """

    unit: str = ""
    torque: float | None = None
    direction: str = "forward"
    temperature: float | None = None
    speed: float | None = None
    stated: bool = dataclasses.field(default=True, compare=False)

    @property
    def sign(self) -> int:
        """1 forward, -1 backward: load opposes motion, so it is the sign of the torque of the discs on the carrier."""
        return DIRECTIONS[self.direction]

    def text(self) -> str:
        """Text such as "412 N m forward, 25 degC"."""
        torque = "" if self.torque is None else f"{self.torque:g} N m "
        speed = "" if self.speed is None else f", {self.speed / rpm:g} r/min"
        return f"{torque}{self.direction}{speed}" + ("" if self.temperature is None else f", {self.temperature:g} degC")


@dataclass(frozen=True, eq=False)
class Run:
    """Transmission error along a turn of the output.

    Attributes:
        source: name of the file.
        at: under which conditions.
        angle: of the output, ascending or descending without jumps, rad (n,).
        error: > 0: output ahead, rad (n,).
        rows: lines of the file (n,); None where the run has none.
    """

    source: str
    at: Conditions
    angle: np.ndarray
    error: np.ndarray
    rows: np.ndarray | None = None

    @property
    def name(self) -> str:
        """File, unit and conditions, for a message."""
        unit = f"unit {self.at.unit!r}, " if self.at.unit else ""
        return f"{self.source}: {unit}run {self.at.text()}"


@dataclass(frozen=True)
class Finding:
    """Property of a measurement that limits a result.

    Attributes:
        name: such as "stroke".
        value: in SI; NaN where the text alone says it.
        unit: SI unit of the value.
        text: a sentence; "" where the number is enough.
        warning: it makes a result wrong or less certain.
    """

    name: str
    value: float
    unit: str
    text: str = ""
    warning: bool = False


WHOLE = 359 * deg  # a stroke that counts as a whole revolution
ALIKE = 0.5
"""Correlation of two orders at the measured angles from which on a fit does not separate them."""
LEG = 0.5  # share of the range of angles that a pass covers at least
STRAIGHT = 0.8  # net travel of a pass over its total travel; less is a file whose rows are in no order
REPEATED = 0.01  # of a usual step: a smaller one is a repeated reading at the same place
MANY = 1 / 3  # share of the steps that are repeated readings where the readings of a place are averaged
FINE = 0.3  # rad: largest phase of the highest order across one bin of angles


@dataclass(frozen=True)
class Sampling:
    """Angles at which a curve was measured.

    Attributes:
        points: number of places.
        readings: number of readings, not less than places.
        stroke: range of the angles and one step, rad.
        step: usual distance of two places, rad.
        gap: largest distance of two neighbouring places of the revolution, if it is much larger than the others, rad;
            else 0.
        repeat: order at which the angles repeat, such as the number of equal steps of a revolution; inf if there
            is none in the range that was searched.
    """

    points: int
    readings: int
    stroke: float
    step: float
    gap: float
    repeat: float

    @property
    def turns(self) -> float:
        """Revolutions."""
        return self.stroke / (2 * math.pi)

    @property
    def whole(self) -> bool:
        """True if it covers a revolution."""
        return self.stroke >= WHOLE and self.gap == 0

    @property
    def finest(self) -> float:
        """Order below which orders are resolved."""
        return self.repeat / 2

    def alike(self, one: float, other: float) -> bool:
        """Compare two different orders: True if they are the same numbers at these angles.

        Args:
            one: per revolution.
            other: per revolution.
        """
        if not math.isfinite(self.repeat) or abs(one - other) < 1e-9:
            return False
        off = [abs((one + side * other) / self.repeat) for side in (-1, 1)]
        lobe = 0.6 / max(self.turns, 1e-9)  # distance at which the correlation of two orders is 0.5
        return any(round(x) >= 1 and abs(x - round(x)) * self.repeat < lobe for x in off)


def legs(angle: np.ndarray) -> list[slice]:
    """Passes of an angle in the order of time: one, or several between reversals.

    Args:
        angle: unwrapped, rad (n,).
    """
    angle = without_spikes(angle)
    span = np.ptp(angle) if len(angle) else 0.0
    if len(angle) < 8 or span == 0:
        return [slice(0, len(angle))]
    turns, first, low, high = [0], 0, 0, 0
    for k in range(1, len(angle)):  # extremes that are at least half of the range apart
        low, high = (k if angle[k] < angle[low] else low), (k if angle[k] > angle[high] else high)
        for extreme, away in ((high, angle[high] - angle[k]), (low, angle[k] - angle[low])):
            if away >= LEG * span and extreme > first:
                turns.append(extreme)
                first = low = high = extreme
                low, high = (k, extreme) if angle[k] < angle[extreme] else (extreme, k)
                break
    bounds = [*turns, len(angle) - 1]
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))])
    for start, end in itertools.pairwise(bounds):
        total = travel[end] - travel[start]
        if total > 0 and abs(angle[end] - angle[start]) < STRAIGHT * total:
            return [slice(0, len(angle))]
    starts = [0, *(k + 1 for k in turns[1:]), len(angle)]
    return [slice(a, b) for a, b in itertools.pairwise(starts) if b - a > 1]


def without_spikes(values: np.ndarray) -> np.ndarray:
    """Median of each value and its two neighbours, which is a value of every ascending sequence itself.

    Args:
        values: in the order of time (n,). The ends are compared with a straight line (Tukey 1977, end-point rule).
    """
    if len(values) < 3:
        return values
    medians = values.copy()
    medians[1:-1] = np.median([values[:-2], values[1:-1], values[2:]], axis=0)
    for end, one, two in ((0, 1, 2), (-1, -2, -3)):
        medians[end] = np.median([values[end], medians[one], 3 * medians[one] - 2 * medians[two]])
    return medians


def places(angle: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle and mean value of every place, and the place of every reading; as given where readings do not repeat.

    Args:
        angle: ascending, rad (n,).
        value: readings (n,).
    """
    own = np.arange(len(angle))
    steps = np.diff(angle)
    usual = np.quantile(steps, 0.9) if len(steps) else 0.0
    if usual > 0 and np.mean(steps < REPEATED * usual) < MANY:
        return angle, value, own
    large = steps[steps > REPEATED * usual]
    if not len(large):  # more than nine readings of a place: the usual step is that of the places
        large = steps[steps > 0]
    if not len(large):
        return angle, value, own
    place = np.concatenate([[0], np.cumsum(steps > REPEATED * np.median(large))])
    count = np.bincount(place)
    return np.bincount(place, angle) / count, np.bincount(place, value) / count, place


def repetition(angle: np.ndarray, highest: float) -> float:
    """Smallest order, up to the highest one, that has nearly one phase at all angles; inf if there is none.

    Args:
        angle: rad (n,).
        highest: order.
    """
    return _repetition(np.ascontiguousarray(angle).tobytes(), highest) if len(angle) > 2 else math.inf


@functools.lru_cache(maxsize=64)  # the runs of a bench have the same angles
def _repetition(angles: bytes, highest: float) -> float:
    angle = np.frombuffer(angles)
    span = np.ptp(angle)
    if span == 0:
        return math.inf
    order, size = spectrum(angle, np.ones(len(angle)), highest)
    main = order < 3 * 2 * math.pi / span  # the sampling of one order is not that of its neighbours
    size = np.where(main, 0.0, np.abs(size) / len(angle))
    above = np.flatnonzero(size > ALIKE)
    if not len(above):
        return math.inf
    near = above[order[above] < order[above[0]] + 2 * 2 * math.pi / span]
    best = float(order[near[np.argmax(size[near])]])
    whole = round(best)
    exact = abs(np.mean(np.exp(1j * whole * angle)))
    return float(whole) if exact > max(ALIKE, size[near].max() - 0.02) else best


def spectrum(angle: np.ndarray, value: np.ndarray, highest: float) -> tuple[np.ndarray, np.ndarray]:
    """Orders in steps of a quarter of their resolution, and sum value exp(-i order angle) at each.

    The values are collected in bins of the angle; the phase of the highest order across a bin is 0.3 rad at most.

    Args:
        angle: rad (n,).
        value: (n,).
        highest: order.
    """
    start, span = float(np.min(angle)), float(np.ptp(angle))
    bins = max(2, math.ceil(span * highest / FINE))
    width = span / bins
    place = np.minimum((angle - start) / width, bins - 1e-6)
    low = np.floor(place).astype(int)
    part = place - low
    held = np.bincount(low, value * (1 - part), bins + 2) + np.bincount(low + 1, value * part, bins + 2)
    length = 1 << math.ceil(math.log2(4 * bins))
    sums = np.fft.rfft(held, length)
    order = np.arange(len(sums)) * (2 * math.pi / (length * width))
    kept = order <= highest
    smooth = np.sinc(order[kept] * width / (2 * math.pi)) ** 2  # of a linear share between two bins
    return order[kept], sums[kept] * np.exp(-1j * order[kept] * start) / smooth
