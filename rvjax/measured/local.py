"""Angle of a branch at any torque: parabolas through the samples about it, as wide as its curvature allows."""

from dataclasses import dataclass, replace

import numpy as np

FEWEST = 5  # torques of a parabola
LEVELS = 8  # widths, each half the one before
AGREE = 2.0  # standard deviations within which parabolas of different width agree
CHI = 0.839  # median of chi square of four degrees of freedom, over four


@dataclass(frozen=True)
class Value:
    """Angle of a branch at one torque.

    Attributes:
        angle: rad.
        noise: its standard deviation from the spread of the samples, rad.
        bias: what curvature within the samples may add, with its sign, rad.
    """

    angle: float
    noise: float
    bias: float


@dataclass(frozen=True)
class Samples:
    """Samples of a branch by ascending torque; equal torques are one sample with a weight.

    Attributes:
        torque: N m (m,).
        angle: mean, rad (m,).
        weight: samples of this torque (m,).
        blur: noise of the torque that the spread of the angles does not contain, N m.
        step: of the reading of the angle, rad.
        beat: steps of the readings of angle, rad, and torque, N m, whose errors do not average out; 0: they do.
        spread: standard deviation of a sample about the branch, rad.
    """

    torque: np.ndarray
    angle: np.ndarray
    weight: np.ndarray
    blur: float
    step: float
    beat: tuple[float, float]
    spread: float

    def near(self, at: float, half: float) -> slice:
        """Samples within a distance of a torque, at least the nearest `FEWEST`."""
        low, high = np.searchsorted(self.torque, [at - half, at + half], side="left")
        high += high < len(self.torque) and self.torque[high] <= at + half
        if high - low < FEWEST:
            low = int(np.clip(np.searchsorted(self.torque, at) - FEWEST // 2, 0, len(self.torque) - FEWEST))
            while low > 0 and at - self.torque[low - 1] < self.torque[low + FEWEST - 1] - at:
                low -= 1
            while low + FEWEST < len(self.torque) and self.torque[low + FEWEST] - at < at - self.torque[low]:
                low += 1
            high = low + FEWEST
        return slice(int(low), int(high))

    def value(self, at: float, half: float) -> Value:
        """Angle at a torque from the widest parabola that agrees with all narrower ones, taken one step narrower.

        Args:
            at: torque, N m.
            half: half of the distance to the next torque that is read, N m; samples within twice it are taken.
        """
        parts = [self.near(at, 2.0 ** (2 - level) * half) for level in range(LEVELS)][::-1]
        places = [part for k, part in enumerate(parts) if k == 0 or part != parts[k - 1]]
        fits = [_parabola(self, part, at) for part in places]
        sds = [np.sqrt(fit[1] * (self.spread**2 + (fit[2] * self.blur) ** 2)) for fit in fits]
        widest = 0
        for k in range(1, len(fits)):
            if any(abs(fits[k][0] - fits[j][0]) > AGREE * sds[j] for j in range(k)):
                break
            widest = k
        taken = max(0, widest - 1)
        angle, share, slope, spread = fits[taken]
        part = places[taken]
        noise = share * (max(self.spread, spread) ** 2 + (slope * self.blur) ** 2)
        stuck = np.ptp(self.angle[part]) <= 1.5 * self.step  # one step of the reading: its error does not average out
        noise += self.step**2 / 12 if stuck else (self.beat[0] ** 2 + (slope * self.beat[1]) ** 2) / 12
        wider = fits[min(taken + 1, len(fits) - 1)][0]  # curvature grows at least with the width of the samples
        return Value(float(angle), float(np.sqrt(noise)), float(wider - angle) / 2)


def samples(torque: np.ndarray, blur: float, angle: np.ndarray, step: float, torque_step: float) -> Samples:
    """Samples of a branch.

    Args:
        torque: without noise, N m (n,).
        blur: noise of the torque that has been removed, N m.
        angle: rad (n,).
        step: of the reading of the angle, rad; 0 where there is none.
        torque_step: of the reading of the torque, N m.
    """
    distinct, place, weight = np.unique(torque, return_inverse=True, return_counts=True)
    mean = np.bincount(place, angle) / weight
    # A ramp in finer steps than the reading's passes through all of its errors; one in coarser steps may beat with it.
    moved = [float(np.median(np.abs(np.diff(values)))) for values in (angle, torque)]
    beat = tuple(own if change > 2 * own else 0.0 for own, change in zip((step, torque_step), moved))
    made = Samples(distinct, mean, weight.astype(float), blur, step, (beat[0], beat[1]), 0.0)
    if len(distinct) < FEWEST + 2:
        return made
    squares = []
    for at in np.linspace(distinct[0], distinct[-1], 43)[1:-1]:
        low = int(np.clip(np.searchsorted(distinct, at) - 3, 0, len(distinct) - 7))
        squares.append(_parabola(made, slice(low, low + 7), at)[3] ** 2)
    spread = np.sqrt(np.median(squares) / CHI + step**2 / 12)
    return replace(made, spread=float(spread))


def _parabola(given: Samples, part: slice, at: float) -> tuple[float, float, float, float]:
    """Value at a torque, its variance over that of a sample, slope, and spread of the samples about the parabola."""
    offset = given.torque[part] - at
    scale = max(abs(offset[0]), abs(offset[-1])) or 1.0
    rows = np.stack([np.ones_like(offset), offset / scale, (offset / scale) ** 2])
    weighted = rows * given.weight[part]
    covariance = np.linalg.pinv(weighted @ rows.T, hermitian=True)
    solution = covariance @ (weighted @ given.angle[part])
    left = given.angle[part] - solution @ rows
    spread = np.sqrt(given.weight[part] @ left**2 / max(len(offset) - 3, 1))
    return float(solution[0]), float(covariance[0, 0]), float(solution[1] / scale), float(spread)
