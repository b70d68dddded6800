"""Reversals of a torque in the order of time, the branches between them, and the cycles of a loop."""

from dataclasses import dataclass

import numpy as np

SHARE = 0.05  # least share of the span between two reversals
SURE = 8.0  # standard deviations of the noise: range of a thousand samples at rest, with a margin
ALIKE = 0.1  # share of a branch by which the extremes of a cycle may differ
REST = 1e-3  # share of the span within which a torque rests at its extreme
AT_END = 0.5  # share of the largest torque from which on a record starts at an extreme, not on the first branch


@dataclass(frozen=True, eq=False)
class Path:
    """Samples of one way of the torque, without those that rest at its ends.

    Attributes:
        index: of the samples in the record (n,).
        time: of the samples in steps of the record, also where a record is joined to itself (n,).
        start: torque at the reversal before, N m.
        end: torque at the reversal behind, N m.
    """

    index: np.ndarray
    time: np.ndarray
    start: float
    end: float

    @property
    def rising(self) -> bool:
        """True for rising torque."""
        return self.end > self.start


@dataclass(frozen=True, eq=False)
class Cycle:
    """Two branches of a loop, one after the other.

    Attributes:
        first: from one extreme to the other.
        second: back.
        before: the branch that leads to the start of the cycle; None where the record starts there.
        whole: the second branch ends where the first starts.
        joined: the end of the record goes on at its start.
        span: first and last sample of the record, ends included.
        rests: first and last sample that rest at the start, between the branches and at the end.
    """

    first: Path
    second: Path
    before: Path | None
    whole: bool = True
    joined: bool = False
    span: tuple[int, int] = (0, 0)
    rests: tuple[tuple[int, int], ...] = ()

    @property
    def rising(self) -> Path:
        """The rising branch."""
        return self.first if self.first.rising else self.second

    @property
    def falling(self) -> Path:
        """The falling branch."""
        return self.second if self.first.rising else self.first

    @property
    def limits(self) -> tuple[float, float]:
        """Torques that both branches reach, N m."""
        up, down = self.rising, self.falling
        return max(up.start, down.end), min(up.end, down.start)


@dataclass(frozen=True)
class Cycles:
    """Cycles of a record.

    Attributes:
        used: of the largest amplitude, the last one first; they do not overlap.
        others: extremes of the other cycles, N m, one pair for each amplitude.
        noise: standard deviation of the torque, N m.
        part: two branches that share some torques, where no cycle is whole.
    """

    used: tuple[Cycle, ...]
    others: tuple[tuple[float, float], ...]
    noise: float
    part: Cycle | None = None


def noise_of(values: np.ndarray) -> float:
    """Standard deviation of the noise in a smooth sequence, from its second differences.

    Args:
        values: in the order of time (n,).
    """
    return float(np.median(np.abs(np.diff(values, 2))) / (0.6745 * np.sqrt(6)))


def cycles(torque: np.ndarray) -> Cycles:
    """The cycles between reversals at the extremes of a torque; none: the record has one branch, or the first only.

    Args:
        torque: in the order of time, N m (n,).
    """
    span, noise, window = np.ptp(torque), noise_of(torque), 1
    while SURE * noise / np.sqrt(window) > span / 4 and window < len(torque) / 100:
        window += 2
    smooth = _mean(torque, window)
    least = max(SHARE * span, SURE * noise / np.sqrt(window))
    turns = _turns(smooth, least)
    within = max(REST * span, 3 * noise / np.sqrt(window))
    rests = [_rest(smooth, turns, k, within) for k in range(len(turns))]
    paths = [
        _path(np.arange(rests[k][1] + 1, rests[k + 1][0]), smooth[turns[k]], smooth[turns[k + 1]])
        for k in range(len(turns) - 1)
    ]
    before = [None, *paths[:-1]]
    started = 0 if paths and _loaded(paths[0], np.max(np.abs(smooth))) else 1
    pairs = [
        Cycle(
            *(paths[k], paths[k + 1], before[k], _closed(paths[k], paths[k + 1])),
            span=(turns[k], turns[k + 2]),
            rests=tuple(rests[k : k + 3]),
        )
        for k in range(started, len(paths) - 1)
    ]
    if whole := [pair for pair in pairs if pair.whole]:
        return _largest(whole, noise)
    joined = _joined(paths, rests, len(torque))
    reach = [pair.limits[1] - pair.limits[0] for pair in pairs]
    most = max(reach, default=0.0)
    part = next((pair for pair, own in zip(pairs[::-1], reach[::-1]) if own > 0 and own >= 0.99 * most), None)
    return Cycles((joined,) if joined else (), (), noise, part)


def _mean(values: np.ndarray, window: int) -> np.ndarray:
    """Running mean over an odd number of samples; shorter at the ends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    place, half = np.arange(len(values)), window // 2
    first, last = np.maximum(place - half, 0), np.minimum(place + half + 1, len(values))
    return values if window == 1 else (total[last] - total[first]) / (last - first)


def _turns(torque: np.ndarray, least: float) -> list[int]:
    """Start, reversals and end: samples from which the torque goes back by more than `least`."""
    turns, top, bottom, way = [], 0, 0, 0
    for k, value in enumerate(torque):
        if value > torque[top]:
            top = k
        if value < torque[bottom]:
            bottom = k
        if way >= 0 and torque[top] - value > least:
            turns.append(top)
            bottom, way = k, -1
        elif way <= 0 and value - torque[bottom] > least:
            turns.append(bottom)
            top, way = k, 1
    return [*turns, top if way > 0 else bottom] if turns else []


def _rest(torque: np.ndarray, turns: list[int], k: int, within: float) -> tuple[int, int]:
    """First and last sample that rest at a reversal."""
    turn = turns[k]
    low, high = turns[k - 1] if k else 0, turns[k + 1] if k + 1 < len(turns) else len(torque) - 1
    away = np.flatnonzero(np.abs(torque[low : high + 1] - torque[turn]) > within) + low
    back, ahead = away[away < turn], away[away > turn]
    return (back[-1] + 1 if len(back) else low), (ahead[0] - 1 if len(ahead) else high)


def _path(index: np.ndarray, start: float, end: float) -> Path:
    return Path(index, index.astype(float), float(start), float(end))


def _loaded(path: Path, most: float) -> bool:
    """Check that a record starts under a torque: its first branch is part of a loop."""
    against = path.start * path.end < 0 and abs(path.start) >= ALIKE * most
    return abs(path.start) >= AT_END * most or against


def _closed(first: Path, second: Path) -> bool:
    return abs(second.end - first.start) <= ALIKE * abs(first.end - first.start)


def _largest(whole: list[Cycle], noise: float) -> Cycles:
    """Cycles of the largest amplitude that do not overlap, from the end; they share their extremes with the last."""
    size = np.array([cycle.limits[1] - cycle.limits[0] for cycle in whole])
    large = [cycle for cycle, own in zip(whole, size) if own >= (1 - ALIKE) * size.max()]
    last = large[-1]
    used, first, slack = [], np.inf, ALIKE * size.max()
    for cycle in reversed(large):
        alike = np.all(np.abs(np.subtract(cycle.limits, last.limits)) <= slack)
        if cycle.span[1] <= first and alike:
            used.append(cycle)
            first = cycle.span[0]
    others: list[tuple[float, float]] = []
    for cycle in whole:
        known = [last.limits, *others]
        if all(np.any(np.abs(np.subtract(cycle.limits, one)) > slack) for one in known):
            others.append(cycle.limits)
    return Cycles(tuple(used), tuple(others), noise)


def _joined(paths: list[Path], rests: list[tuple[int, int]], count: int) -> Cycle | None:
    """A record that ends where and how it starts is one cycle: its last branch goes on as its first one."""
    if len(paths) != 3 or abs(paths[2].end - paths[0].start) > ALIKE * abs(paths[1].end - paths[1].start):
        return None
    head, tail = paths[0], paths[2]
    index = np.concatenate([tail.index, head.index])
    time = np.concatenate([tail.time, head.time + count])
    if not len(head.index) or not len(tail.index):
        return None
    back = Path(index, time, tail.start, head.end)
    first = rests[1][0]
    return Cycle(paths[1], back, None, joined=True, span=(first, first + count), rests=(rests[1], rests[2], rests[1]))
