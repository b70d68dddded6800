"""One cycle of a loop: its branches, the gap at its end, a restart within it."""

from dataclasses import dataclass, replace

import numpy as np

from rvjax.measured.local import FEWEST, Samples, samples
from rvjax.measured.reversals import Cycle, Cycles, noise_of

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


def together(found: Cycles, torque: np.ndarray, angle: np.ndarray, step: tuple[float, float]) -> Read:
    """All cycles as one."""
    sides = []
    for paths in ([cycle.rising for cycle in found.used], [cycle.falling for cycle in found.used]):
        passed = [_smooth(torque[path.index], path.rising, found.noise) for path in paths]
        index = np.concatenate([path.index for path in paths])
        sides.append(
            samples(np.concatenate([own for own, _ in passed]), max(b for _, b in passed), angle[index], *step)
        )
    return Read(found.used[0], sides[0], sides[1], np.nan, 0.0, False, None, len(found.used))


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
