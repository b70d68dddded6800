"""One cycle of a loop: its branches, the angle of a branch at any torque, the gap at its end, a restart within it."""

from dataclasses import dataclass, replace

import numpy as np

from rvjax.measured.reversals import Cycle, Cycles, noise_of

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


GRID = 21  # torques of the midline of a loop
LEAST = 15  # samples of a branch
GAP = 4.0  # standard deviations from which on a loop is open
JUMP = 6.0  # times the steps of the branch: the record has been started again


@dataclass(frozen=True)
class Read:
    """A cycle as it is read.

    Attributes:
        cycle: its samples in the record.
        up: rising branch.
        down: falling branch.
        gap: angle at its end less that at its start, rad; NaN where it is not known.
        sure: gap that noise does not cause, rad.
        open: the gap is larger; it has been removed in proportion to the time.
        jump: sample behind which the record has been started again; None: nowhere.
        count: of the cycles whose samples it has; the last one is `cycle`.
    """

    cycle: Cycle
    up: Samples
    down: Samples
    gap: float
    sure: float
    open: bool
    jump: int | None
    count: int = 1


def read_cycle(
    where: str, cycle: Cycle, torque: np.ndarray, angle: np.ndarray, noise: float, step: tuple[float, float]
) -> Read:
    """Branches of a cycle; a gap at its end is removed in proportion to the time."""
    first, second, before = cycle.first, cycle.second, cycle.before
    for path in (first, second):
        if len(path.index) < LEAST:
            count = f"{len(path.index)} samples between {path.start:.4g} and {path.end:.4g} N m"
            raise ValueError(f"{where}: only one branch, or too few samples: {count}, needs {LEAST} on each branch")
    passed = {path: _smooth(torque[path.index], path.rising, noise) for path in (first, second)}
    own = {path: samples(*passed[path], angle[path.index], *step) for path in passed}
    led = None
    if before is not None and len(before.index) >= LEAST:
        led = samples(*_smooth(torque[before.index], before.rising, noise), angle[before.index], *step)
    gap, sure = _gap(cycle, own[first], own[second], led)
    jump = _jump(cycle, angle)
    opened = bool(abs(gap) > sure)
    if opened and jump is None:
        middle, length = (first.time[-1] + second.time[0]) / 2, cycle.span[1] - cycle.span[0]
        for path in passed:
            own[path] = samples(*passed[path], angle[path.index] - gap * (path.time - middle) / length, *step)
    read = Read(cycle, own[cycle.rising], own[cycle.falling], gap, sure, opened, jump)
    if jump is None:
        return read
    path = next(path for path in passed if jump in path.index)
    beyond = (passed[path][0] - torque[jump]) * (1 if path.rising else -1)
    # Friction takes up to its whole width to come back to the branch.
    kept = (path.index <= jump) | (beyond > torque_width(read))
    smooth, blur = passed[path]
    rest = samples(smooth[kept], blur, angle[path.index][kept], *step)
    return replace(read, up=rest) if path.rising else replace(read, down=rest)


def together(cycles: Cycles, torque: np.ndarray, angle: np.ndarray, step: tuple[float, float]) -> Read:
    """All cycles as one."""
    sides = []
    for paths in ([cycle.rising for cycle in cycles.used], [cycle.falling for cycle in cycles.used]):
        passed = [_smooth(torque[path.index], path.rising, cycles.noise) for path in paths]
        index = np.concatenate([path.index for path in paths])
        sides.append(
            samples(np.concatenate([own for own, _ in passed]), max(b for _, b in passed), angle[index], *step)
        )
    return Read(cycles.used[0], sides[0], sides[1], np.nan, 0.0, False, None, len(cycles.used))


def _smooth(torque: np.ndarray, rising: bool, noise: float) -> tuple[np.ndarray, float]:
    """Torque of a branch without its noise, and the noise; as it is where it rises or falls all the way."""
    steps = np.diff(torque) * (1 if rising else -1)
    if np.all(steps >= -1e-9 * np.ptp(torque)):
        return torque, 0.0
    from scipy import signal  # slow to import

    half = np.ptp(torque) / (2 * GRID)
    window = max(FEWEST, len(torque) // (2 * GRID), int(9 * (noise / half) ** 2))  # noise of half a step of the grid
    window = min(window, len(torque) * 2 // 3) // 2 * 2 + 1
    return signal.savgol_filter(torque, window, 2, mode="interp"), noise


def step_of(values: np.ndarray) -> float:
    """Step of a reading, by the algorithm of Euclid; 0 where its values lie on no grid."""
    distinct, least = np.unique(values), 1e-7 * np.ptp(values)
    steps = np.diff(distinct)
    step = np.min(steps, where=steps > least, initial=np.inf)
    while least < step < np.inf:
        rest = np.abs(distinct - distinct[0] - step * np.round((distinct - distinct[0]) / step))
        if np.all(rest < 0.02 * step):
            return float(step)
        step = np.min(rest, where=rest >= 0.02 * step, initial=np.inf)
    return 0.0


def _half(given: Samples) -> float:
    return float(np.ptp(given.torque)) / (2 * GRID)


def _gap(cycle: Cycle, first: Samples, second: Samples, led: Samples | None) -> tuple[float, float]:
    """Angle at the end of a cycle less that at its start, and the size from which on it is none of noise."""
    if not cycle.whole:
        return np.nan, 0.0
    rising = cycle.second.rising
    if led is not None:  # both branches lead to the same reversal, at the same torque
        ends = [(one.torque[-1] if rising else one.torque[0]) for one in (led, second)]
        starts, at = led, float(min(ends) if rising else max(ends))
        slack = 0.0
    else:
        starts, at = first, float(first.torque[-1] if rising else first.torque[0])
        near = second.torque[-2:] if rising else second.torque[:2]
        slope = np.ptp(second.angle[-5:] if rising else second.angle[:5]) / np.ptp(
            second.torque[-5:] if rising else second.torque[:5]
        )
        slack = 2 * slope * float(np.ptp(near))  # the reversal lies between two samples
    start, end = starts.value(at, _half(starts)), second.value(at, _half(second))
    own = np.hypot(np.hypot(start.noise, end.noise), np.hypot(start.bias, end.bias))
    return end.angle - start.angle, float(GAP * own + slack)


def _jump(cycle: Cycle, angle: np.ndarray) -> int | None:
    """Sample behind which the angle jumps on one branch and not on the other, where backlash would jump as well."""
    steps = [np.abs(np.diff(angle[path.index])) for path in (cycle.first, cycle.second)]
    for path, own, other in zip((cycle.first, cycle.second), steps, steps[::-1]):
        place = int(np.argmax(own))
        usual = max(JUMP * float(np.quantile(own, 0.9)), 8 * noise_of(angle[path.index]))
        if not cycle.joined and own[place] > usual and np.max(other) < own[place] / 2:
            return int(path.index[place])
    return None


def torque_width(read: Read) -> float:
    """Torque on the rising branch less that on the falling one at the same angle, N m: twice the friction."""
    low = max(read.up.torque[0], read.down.torque[0])
    high = min(read.up.torque[-1], read.down.torque[-1])
    ends = np.linspace(low, high, 4 * GRID + 1)
    curves = []
    for branch in (read.up, read.down):
        place = np.clip(np.searchsorted(ends, branch.torque) - 1, 0, 4 * GRID - 1)
        weight = np.bincount(place, branch.weight, 4 * GRID)
        with np.errstate(invalid="ignore"):
            means = [np.bincount(place, branch.weight * x, 4 * GRID) / weight for x in (branch.torque, branch.angle)]
        curves.append([mean[weight > 0] for mean in means])
    way = np.sign(curves[0][1][-1] - curves[0][1][0]) or 1.0
    (up, rising), (down, falling) = ((t, np.maximum.accumulate(way * y)) for t, y in curves)
    angles = np.linspace(max(rising[0], falling[0]), min(rising[-1], falling[-1]), 4 * GRID)[GRID // 2 : -GRID // 2]
    return float(np.median(np.interp(angles, rising, up) - np.interp(angles, falling, down)))


def continues(read: Read, torque: np.ndarray, angle: np.ndarray, noise: float, step: tuple[float, float]) -> bool:
    """Check that the end of the record continues at its start; a first branch starts half a width away."""
    second = read.cycle.second
    parts = [second.index[second.time >= len(torque)], second.index[second.time < len(torque)]]
    if min(len(part) for part in parts) < FEWEST + 2:
        return False
    head, tail = (samples(*_smooth(torque[part], second.rising, noise), angle[part], *step) for part in parts)
    at = (torque[parts[0][0]] + torque[parts[1][-1]]) / 2
    start, end = head.value(at, _half(head)), tail.value(at, _half(tail))
    other = (read.up if read.cycle.first.rising else read.down).value(at, _half(tail))
    own = np.hypot(np.hypot(start.noise, end.noise), np.hypot(start.bias, end.bias))
    gap, width = abs(start.angle - end.angle), abs(other.angle - end.angle)
    closed = width <= GAP * own and own <= np.ptp(angle) / 100  # no friction
    told = closed or GAP * own <= width / 2  # a first branch starts half a width away
    return bool(told and gap <= max(3 * own, width / 10))
