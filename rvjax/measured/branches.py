"""Midline and width of a torque-angle loop, which a bench records in the order of time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rvjax.measured.cycle import (
    GRID as GRID,
    LEAST,
    Read,
    Samples,
    continues,
    read_cycle,
    step_of,
    together,
    torque_width,
)
from rvjax.measured.reversals import REST, Cycle, Cycles, cycles
from rvjax.units import arcmin

CLIPPED = 0.03  # share of the samples of a cycle at the extreme torque, from which on a sensor may have hit its end
MOVES = 0.1  # of the speed before: an angle that goes on so fast while the torque rests is cut off, not held
ALIKE = 2.0  # mean square of the differences of two cycles over their variance, up to which they agree
WIDEST = 0.4  # share of the torques from which on friction leaves none where the branches have parted
PARTED = 0.9  # share of the width farther inside, from which on branches have parted
ENDS = 4  # samples at the reversals, which are on no branch
SMALLEST = 1e-6 * arcmin  # standard deviation


@dataclass(frozen=True)
class Branches:
    """Midline and width on a grid of torques, and how they were read.

    Attributes:
        torque: N m (n,).
        midline: rad (n,).
        width: falling less rising branch, rad (n,).
        sd: of the midline, rad (n,); half of that of the width.
        reads: cycles whose mean this is, the last one first.
        found: all cycles of the record.
        limits: torques between which the branches have parted, N m.
        reach: torque on the rising branch less that on the falling one at the same angle, N m.
        clipped_at: torques where the sensor has hit its end, N m.
        part: first sample of the record that was read, and the one behind the last.
    """

    torque: np.ndarray
    midline: np.ndarray
    width: np.ndarray
    sd: np.ndarray
    reads: tuple[Read, ...]
    found: Cycles
    limits: tuple[float, float]
    reach: float
    clipped_at: tuple[float, ...]
    part: tuple[int, int]

    @property
    def half(self) -> float:
        """Half-width of the samples about a torque, N m."""
        return (self.limits[1] - self.limits[0]) / (2 * GRID)

    def reaches(self, torque: float) -> bool:
        """Check that both branches have samples on either side of a torque, N m."""
        return all(_held(read, torque, self.half) for read in self.reads)

    def at(self, torque: float) -> tuple[float, float, float]:
        """Midline, width and standard deviation of the midline at a torque of the grid's range, rad."""
        rows = np.array([[_pair(read, torque, self.half)] for read in self.reads])
        midline, width, sd = _mean_of(self.reads, rows)
        return float(midline[0]), float(width[0]), float(sd[0])


def branches(where: str, torque: np.ndarray, angle: np.ndarray) -> Branches:
    """Read the last whole cycle of a loop, or the mean of the last cycles that agree.

    Args:
        where: of the loop, for messages.
        torque: in the order of time, N m.
        angle: of the same samples, rad.

    Raises:
        ValueError: too few samples, or one branch only.
    """
    span = np.ptp(torque)
    if len(torque) < 4 * GRID or span == 0:
        raise ValueError(f"{where} of {len(torque)} samples over {span:.4g} N m: needs {4 * GRID} samples, both ways")
    record, step = cycles(torque), (step_of(angle), step_of(torque))
    try:
        return _read_all(where, record, torque, angle, step)
    except ValueError:
        if len(record.used) < 2:
            raise
    as_one = together(record, torque, angle, step)  # few samples on each branch, and enough on all of them
    return _compared(where, [as_one], record, torque, angle)


def _read_all(where: str, cycles: Cycles, torque: np.ndarray, angle: np.ndarray, step: tuple[float, float]) -> Branches:
    """Read each cycle of the largest amplitude; where the record has been started again, its longer part."""
    reads = [read_cycle(where, cycle, torque, angle, cycles.noise, step) for cycle in cycles.used]
    if reads and reads[0].cycle.joined and not continues(reads[0], torque, angle, cycles.noise, step):
        reads = []
    if not reads and cycles.part is not None:
        reads = [read_cycle(where, cycles.part, torque, angle, cycles.noise, step)]
    if not reads:
        raise ValueError(
            f"{where}: only one branch behind the first; the torque has to rise and to fall once more, "
            "because the first branch is no part of a loop"
        )
    jump, few = reads[0].jump, min(len(reads[0].up.torque), len(reads[0].down.torque)) < 2 * GRID
    if len(reads) > 1 and few and not any(read.open or read.jump is not None for read in reads):
        reads = [together(cycles, torque, angle, step)]
    if jump is None:
        return _compared(where, reads, cycles, torque, angle)
    try:
        if not reads[0].open:
            return _compared(where, reads, cycles, torque, angle)
    except ValueError:  # too few torques are left of the branch
        pass
    first = 0 if 2 * jump >= len(torque) else jump + 1  # the longer part, which has one zero of the angle
    last = jump + 1 if first == 0 else len(torque)
    part = branches(where, torque[first:last], angle[first:last])
    return replace(part, part=(first + part.part[0], first + part.part[1]))


def _compared(where: str, reads: list[Read], cycles: Cycles, torque: np.ndarray, angle: np.ndarray) -> Branches:
    """Mean of the last cycles that agree."""
    last = reads[0]
    for read in reads:
        if (count := len(read.up.torque) + len(read.down.torque) + ENDS) < 4 * GRID:
            raise ValueError(f"{where}: {count} torques in a cycle, both ways: needs {4 * GRID}; take smaller steps")
    low, high, reach = _parted(where, last)
    half = (high - low) / (2 * GRID)
    grid = np.linspace(low + half, high - half, GRID)
    if last.jump is not None:
        grid = np.array([t for t in grid if all(_held(read, t, half) for read in reads)])
    for read in reads:
        for branch in (read.up, read.down):
            _covered(where, branch, grid)
    rows = [np.array([_pair(read, t, half) for t in grid]) for read in reads]
    count = 1
    while count < len(rows) and _agree(rows[0], rows[count]):
        count += 1
    used = tuple(reads[:count])
    midline, width, sd = _mean_of(used, np.array(rows[:count]))
    clipped = _clipped(last.cycle, torque, angle)
    return Branches(grid, midline, width, sd, used, cycles, (low, high), reach, clipped, (0, len(torque)))


def _pair(read: Read, at: float, half: float) -> tuple[float, float, float, float, float]:
    """Midline, width, standard deviation of the midline from noise, and what curvature adds to each branch."""
    up, down = read.up.value(at, half), read.down.value(at, half)
    noise = float(np.hypot(up.noise, down.noise)) / 2
    return (up.angle + down.angle) / 2, down.angle - up.angle, noise, up.bias, down.bias


def _mean_of(reads: Sequence[Read], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Midline, width and standard deviation of the midline of several cycles; rows are (cycles, torques, 5)."""
    midline, width, noise, up, down = np.moveaxis(rows, -1, 0)
    bias = np.hypot(np.mean(up, axis=0), np.mean(down, axis=0)) / 2
    gap = max(abs(read.gap) / 2 if read.open else 0.0 for read in reads)  # how it has grown in a cycle is not known
    sd = np.sqrt(np.mean(noise**2, axis=0) / len(noise) + bias**2 + gap**2)
    return np.mean(midline, axis=0), np.mean(width, axis=0), np.maximum(sd, SMALLEST)


def _agree(one: np.ndarray, other: np.ndarray) -> bool:
    variance = one[:, 2] ** 2 + other[:, 2] ** 2 + SMALLEST**2
    difference = (one[:, 0] - other[:, 0]) ** 2 + (one[:, 1] - other[:, 1]) ** 2 / 4
    return bool(np.mean(difference / variance) / 2 <= ALIKE)


def _parted(where: str, read: Read) -> tuple[float, float, float]:
    """Torques between which the branches have parted, because friction has to reverse first; its width in torque."""
    low = max(read.up.torque[0], read.down.torque[0])
    high = min(read.up.torque[-1], read.down.torque[-1])
    if not high > low:
        raise ValueError(f"{where}: only one branch at each torque; the torque has to rise and to fall")
    reach = torque_width(read)
    if not (high - low) / (2 * GRID) < reach < WIDEST * (high - low):
        return float(low), float(high), reach
    half, limits = (high - low) / (4 * GRID), [float(low), float(high)]
    for side, (end, inward) in enumerate(((low, 1.0), (high, -1.0))):
        _, full, *_ = _pair(read, end + inward * 1.2 * reach, half)
        for share in np.arange(0.95, 0.0, -0.1):
            _, width, noise, *bias = _pair(read, end + inward * share * reach, half)
            if abs(width) < PARTED * abs(full) - 4 * np.hypot(noise, np.hypot(bias[0], bias[1]) / 2):
                limits[side] = float(end + inward * min(1.0, share + 0.15) * reach)
                break
    return limits[0], limits[1], reach


def _held(read: Read, at: float, half: float) -> bool:
    """Check that a torque lies between samples of both branches, or just beyond the last one."""
    for branch in (read.up, read.down):
        steps, place = np.diff(branch.torque), int(np.searchsorted(branch.torque, at))
        near = 1.5 * float(np.median(steps))
        beside = branch.torque[max(place - 1, 0) : place + 1]
        between = 0 < place < len(branch.torque) and np.ptp(beside) <= max(half / 2, near)
        if not between and np.min(np.abs(beside - at)) > near:
            return False
    return True


def _covered(where: str, branch: Samples, grid: np.ndarray) -> None:
    """Raise an error where a branch has a gap of more than two steps of a grid over all of its torques."""
    most = max(2 * np.ptp(branch.torque) / GRID, 2 * branch.blur)
    for t in grid:
        place = int(np.searchsorted(branch.torque, t))
        below, above = branch.torque[max(place - 1, 0)], branch.torque[min(place, len(branch.torque) - 1)]
        if above - below > most or not below - most <= t <= above + most:
            gap = f"no samples between {below:.4g} and {above:.4g} N m on a branch"
            raise ValueError(f"{where}: {gap}; the largest gap may be {most:.4g} N m")


def _clipped(cycle: Cycle, torque: np.ndarray, angle: np.ndarray) -> tuple[float, ...]:
    """Torques where the sensor has hit its end: the angle goes on while the torque rests, N m."""
    torques = []
    paths = (cycle.before, cycle.first, cycle.second)
    length = cycle.span[1] - cycle.span[0]
    for path, (first, last) in zip(paths, cycle.rests):
        rest = torque[first : last + 1]
        if path is None or len(path.index) < LEAST or not len(rest):
            continue
        extreme = rest.max() if path.rising else rest.min()
        held = np.flatnonzero(np.abs(rest - extreme) <= REST * np.ptp(torque)) + first
        if len(held) < CLIPPED * length:
            continue
        back = path.index[-max(3, len(path.index) // 20) :]
        speed = (angle[back[-1]] - angle[back[0]]) / (len(back) - 1)
        third = len(held) // 3
        moved = np.mean(angle[held[third : len(held) - third]]) - angle[back[-1]]
        if speed != 0 and moved / speed > MOVES * len(held):
            torques.append(float(extreme))
    return tuple(dict.fromkeys(torques))
