"""Values of a measured hysteresis curve: width, lost motion, stiffness, energy, and what limits them."""

from collections.abc import Iterator

import numpy as np

from rvjax.measured.branches import WIDEST, Branches
from rvjax.measured.cycle import Read
from rvjax.measured.reversals import Path
from rvjax.measured.run import Finding
from rvjax.units import arcmin

THRESHOLD = 0.03  # of the extreme torque: where lost motion is read
COARSE = 1.01  # of the torque of lost motion: rounding
ACROSS = 0.05  # of the larger extreme that the other one has to reach: less is a loop on one side


def about(loop: Branches, torque: np.ndarray, angle: np.ndarray, rows: np.ndarray) -> Iterator[Finding]:
    """Properties of a loop.

    Args:
        loop: as it was read.
        torque: in the order of time, N m (n,).
        angle: of the same samples, rad (n,).
        rows: of the file (n,).
    """
    torque, angle, rows = (values[slice(*loop.part)] for values in (torque, angle, rows))
    cycle = loop.reads[0].cycle
    ends = (cycle.first.start, cycle.first.end, cycle.second.end)
    low, high = min(ends), max(ends)
    yield from _cycles(loop, rows)
    yield Finding("extreme torque", max(abs(low), abs(high)), "N m", f"cycle between {low:.4g} and {high:.4g} N m")
    yield from _limits(loop, low, high)
    yield from _gap(loop)
    yield from _values(loop, low, high, torque, angle)


def used(loop: Branches, count: int) -> np.ndarray:
    """Branch of each sample: 1 rising, -1 falling, 0 not used.

    Args:
        loop: as the loop was read.
        count: of the samples of the record.
    """
    branch = np.zeros(count, int)
    as_one = loop.reads[0].count > 1
    for cycle in loop.found.used if as_one else ():
        branch[cycle.rising.index], branch[cycle.falling.index] = 1, -1
    for read in loop.reads:
        for path, way, kept in ((read.cycle.rising, 1, read.up), (read.cycle.falling, -1, read.down)):
            branch[loop.part[0] + path.index] = way
            if read.jump is not None and read.jump in path.index and len(path.index) > kept.weight.sum():
                lost = int(len(path.index) - kept.weight.sum())
                start = loop.part[0] + read.jump + 1
                branch[start : start + lost] = 0
    return branch


def _cycles(loop: Branches, rows: np.ndarray) -> Iterator[Finding]:
    cycle, count, whole = loop.reads[0].cycle, len(loop.reads), len(loop.found.used)
    place = f"rows {rows[cycle.span[0]]} to {rows[min(cycle.span[1], len(rows) - 1)]}"
    if cycle.joined:
        text = "one cycle: the record ends on the branch on which it starts"
    elif not cycle.whole:
        low, high = cycle.limits
        text = f"no whole cycle: two branches, {place}, share {low:.4g} to {high:.4g} N m"
    elif (several := loop.reads[0].count) > 1:
        text, count = f"the samples of {several} whole cycles as one, because each has few", several
    elif count > 1:
        text = f"mean of the last {count} of {whole} whole cycles, which agree; the last one is {place}"
    else:
        text = f"the last of {whole} whole cycles, {place}" if whole > 1 else f"one whole cycle, {place}"
    yield Finding("cycles", float(count if cycle.whole else 0), "-", text, warning=not cycle.whole)
    if loop.found.others:
        listed = ", ".join(f"{low:.4g} to {high:.4g} N m" for low, high in loop.found.others)
        text = f"the record also has cycles of other torques ({listed}), which are not used"
        yield Finding("other cycles", float(len(loop.found.others)), "-", text)
    jumps = [read.jump for read in loop.reads if read.jump is not None]
    if loop.part[1] - loop.part[0] == len(rows) and jumps:
        places = ", ".join(f"{rows[jump]}" for jump in jumps)
        text = f"behind row {places} the angle jumps on one branch only: a restart; samples behind it are not used"
        yield Finding("restart", float(len(jumps)), "-", text, warning=True)
    if loop.found.noise > THRESHOLD / 3 * abs(max(cycle.limits, key=abs)):
        text = "noise of the torque; it is removed along each branch, and part of the standard deviation"
        yield Finding("torque noise", loop.found.noise, "N m", text)


def _limits(loop: Branches, low: float, high: float) -> Iterator[Finding]:
    for torque in loop.clipped_at:
        text = f"the torque sensor has hit its end at {torque:.4g} N m: what lies beyond is cut off"
        yield Finding("clipped sensor", torque, "N m", text, warning=True)
    if _one_sided(low, high):
        text = f"the torque goes from {low:.4g} to {high:.4g} N m, on one side of zero: no width at zero torque"
        yield Finding("one-sided loop", np.nan, "-", text, warning=True)
    ends = loop.limits
    inside = max(high - ends[1], ends[0] - low)
    if loop.reach >= WIDEST * (ends[1] - ends[0]):
        text = f"friction takes {loop.reach:.4g} N m to reverse: the branches have parted at few torques or none"
        yield Finding("friction", loop.reach, "N m", text, warning=True)
    if inside > loop.half and loop.reads[0].cycle.whole:
        text = f"from a reversal to where the branches have parted; read from {ends[0]:.4g} to {ends[1]:.4g} N m"
        yield Finding("reversal of the friction", inside, "N m", text)


def _one_sided(low: float, high: float) -> bool:
    return min(high, -low) < ACROSS * max(high, -low)


def _gap(loop: Branches) -> Iterator[Finding]:
    read = loop.reads[0]
    if not np.isfinite(read.gap):
        return
    if not read.open:
        text = f"none is seen: noise alone reaches {read.sure / arcmin:.2g} arcmin"
        yield Finding("closure gap", read.gap, "rad", text)
        return
    text = (
        f"the cycle ends {read.gap / arcmin:.3g} arcmin from its start (creep, a drift, a loose clamp); removed in "
        "proportion to the time, and half of it is in the standard deviation"
    )
    yield Finding("closure gap", read.gap, "rad", text, warning=True)


def _values(loop: Branches, low: float, high: float, torque: np.ndarray, angle: np.ndarray) -> Iterator[Finding]:
    """Width, lost motion, stiffness and energy, as far as the loop determines them."""
    two, at = not _one_sided(low, high), THRESHOLD * min(high, -low)
    if two and (step := max(_step(read, at) for read in loop.reads)) > COARSE * at:
        text = f"at zero, more than the {at:.4g} N m of lost motion: it is not determined, nor is the width at zero"
        yield Finding("coarse steps", step, "N m", text, warning=True)
        two = False
    inside = (loop.limits[0] - loop.half / 2, loop.limits[1] + loop.half / 2)
    if two and inside[0] <= 0 <= inside[1] and loop.reaches(0.0):
        _, width, sd = loop.at(0.0)
        yield Finding("width at zero torque", width, "rad", f"+-{2 * sd / arcmin:.2g} arcmin")
    if two and inside[0] <= -at and at <= inside[1] and loop.reaches(at) and loop.reaches(-at):
        (upper, _, own), (lower, _, other) = loop.at(at), loop.at(-at)
        gap = max(abs(read.gap) / 2 if read.open else 0.0 for read in loop.reads)  # moves both points alike
        sd = np.sqrt(max(own**2 - gap**2, 0.0) + max(other**2 - gap**2, 0.0))
        text = f"midline at +-{at:.4g} N m, 3 % of the extreme torque; +-{sd / arcmin:.2g} arcmin"
        yield Finding("lost motion", upper - lower, "rad", text)
    yield from _stiffness(loop, low, high)
    if not loop.clipped_at and all(r.jump is None and r.cycle.whole and not r.cycle.joined for r in loop.reads):
        energy = [_energy(read, torque, angle) for read in loop.reads]
        yield Finding("energy", float(np.mean(energy)), "N m", "area of the loop, lost in one cycle")


def _step(read: Read, at: float) -> float:
    """Usual step of the torques about zero, on the branch where it is larger, N m."""
    steps = []
    for torque in (read.up.torque, read.down.torque):
        first, last = np.searchsorted(torque, [-2 * at, 2 * at])
        steps.append(float(np.median(np.diff(torque[max(first - 1, 0) : last + 1]))))
    return max(steps)


def _stiffness(loop: Branches, low: float, high: float) -> Iterator[Finding]:
    sides = [side for read in loop.reads for side in _compliances(read, high, low)]
    if not sides:
        return
    compliance, sd = np.mean([c for c, _ in sides]), np.hypot.reduce([s for _, s in sides]) / len(sides)
    if abs(compliance) > sd:
        spread = sd / compliance**2 * arcmin
        where = "between half of the extreme torque and all of it, branches under rising load"
        yield Finding("stiffness", float(1 / compliance), "N m/rad", f"{where}; +-{spread:.2g} N m/arcmin")


def _compliances(read: Read, high: float, low: float) -> list[tuple[float, float]]:
    """Compliance of each branch under rising load, rad/(N m), and its standard deviation."""
    pairs = []
    for samples, path, extreme in ((read.up, read.cycle.rising, high), (read.down, read.cycle.falling, low)):
        outer = (samples.torque - extreme / 2) * np.sign(extreme) >= 0
        loaded = _loads(path, extreme)
        if not loaded or outer.sum() < 5 or extreme == 0:
            continue
        t, y, w = samples.torque[outer], samples.angle[outer], samples.weight[outer]
        line = np.polynomial.polynomial.polyfit(t - extreme, y, 1, w=np.sqrt(w))
        left = y - np.polynomial.polynomial.polyval(t - extreme, line)
        centred = np.sum(w * (t - np.average(t, weights=w)) ** 2)
        spread = np.sum(w * left**2) / max(len(t) - 2, 1) + (line[1] * samples.blur) ** 2
        pairs.append((float(line[1]), float(np.sqrt(spread / centred))))
    return pairs


def _loads(path: Path, extreme: float) -> bool:
    """Check that a branch goes from below half of an extreme torque to nearly all of it."""
    share = np.array([path.start, path.end]) / extreme if extreme else np.zeros(2)
    return bool(share[0] < 0.5 and share[1] > 0.9)


def _energy(read: Read, torque: np.ndarray, angle: np.ndarray) -> float:
    first, last = read.cycle.span
    t, y = torque[first : last + 1], angle[first : last + 1]
    if read.open:
        y = y - read.gap * np.linspace(0, 1, len(y))
    t, y = np.append(t, t[0]), np.append(y, y[0])
    return float(np.sum((t[1:] + t[:-1]) / 2 * np.diff(y)))
