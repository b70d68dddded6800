"""Analysis of a measured curve: its terms, the error without drift, lines and bad readings, and findings."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rvjax.measured.run import STRAIGHT, WHOLE, Finding, Run, Sampling, legs, places, repetition, without_spikes
from rvjax.measured.terms import LOW, Model, Term, content, memory
from rvjax.units import arcsec, deg

FASTEST = 12
"""Highest harmonic of the fastest part that is expected: torque of a motor with poles and slots."""
MOTOR = ("sun", "sun against the carrier", "shaft", "shaft against the output")
"""Names of the orders of the part that a motor turns; the fastest part where none of them is given."""
LOST = 4.0  # standard deviations of a reading: a larger step is a lost step, not noise
BAD, FEW = 0.01, 2  # share, or number, of bad readings that are left out
DRIFTS = ("drift", "warm-up", "step")
HOLE = 10.0  # steps: a larger gap in the revolution is no uneven step
FEWEST = 12  # readings of a search


@dataclass(frozen=True, eq=False)
class Judged:
    """A curve and its contents.

    Attributes:
        run: as measured.
        angle: of the places that are used, ascending, rad (n,).
        error: of the places, without drift and lines, rad (n,).
        taken: what was taken off the error, rad (n,).
        sampling: of the angles.
        model: contents that were found.
        parts: {name: order} of what the measured object can cause.
        rows: line of the file of each place of the model.
    """

    run: Run
    angle: np.ndarray
    error: np.ndarray
    taken: np.ndarray
    sampling: Sampling
    model: Model
    parts: Mapping[str, float]
    rows: np.ndarray

    def found(self, *kinds: str) -> list[Term]:
        """Contents of some kinds."""
        return [term for term in self.model.terms if term.kind in kinds]

    @property
    def noise(self) -> float:
        """Standard deviation of a place about the contents, rad."""
        model = self.model
        freedom = max(len(model.angle) - model.basis.shape[1], 1)
        return math.sqrt(float(model.residual @ model.residual) / freedom)

    @property
    def driven(self) -> tuple[float, ...]:
        """Orders of the part that a motor turns, against the housing and against the output."""
        return _driven(self.parts, 0.0)

    def hidden(self, order: float) -> dict[str, float]:
        """Parts whose order is the same numbers at these angles.

        Args:
            order: per revolution.
        """
        return {name: own for name, own in self.parts.items() if self.sampling.alike(own, order)}

    def looks_like(self, order: float) -> float:
        """Lowest order that has the same numbers at these angles.

        Args:
            order: per revolution.
        """
        repeat = self.sampling.repeat
        return abs(order - repeat * round(order / repeat)) if math.isfinite(repeat) else order


def judge(run: Run, parts: Mapping[str, float]) -> Judged:
    """Evaluate a curve.

    Args:
        run: one pass of the angle.
        parts: {name: order per revolution, a whole number or not} of what the measured object can cause.

    Raises:
        ValueError: the angle turns back, or the error jumps.
    """
    return _judged(run, tuple(parts.items()))


@functools.lru_cache(maxsize=128)
def _judged(run: Run, own: tuple[tuple[str, float], ...]) -> Judged:
    angle, error, parts = run.angle, run.error, dict(own)
    rows = np.arange(len(angle)) if run.rows is None else run.rows
    if len(passes := legs(angle)) > 1:
        row = rows[passes[1].start]
        raise ValueError(f"{run.name}: the angle turns back at row {row}; a run goes one way, add a column direction")
    path = without_spikes(angle)
    timed = float(np.ptp(path)) >= STRAIGHT * float(np.sum(np.abs(np.diff(path)))) if len(path) else False
    angle = angle if timed else angle % (2 * math.pi)
    rank = np.argsort(angle, kind="stable")
    readings, (angle, error, place) = len(angle), places(angle[rank], error[rank])
    rows = rows[rank][np.unique(place, return_index=True)[1]] if len(place) else rows
    sampling = _sampling(angle, readings, parts)
    model = Model(angle, error, [])
    if len(angle) >= FEWEST and np.ptp(error) > 0 and np.ptp(angle) > 0:
        model = content(angle, error, sampling, parts, highest(parts), timed)
    bad = [int(term.at) for term in model.terms if term.kind == "glitch"]
    if len(bad) > max(FEW, BAD * len(angle)):  # heavy tails are noise
        bad = []
    made = Judged(run, angle, error, np.zeros(len(angle)), sampling, model, parts, rows)
    _check_steps(made)
    drift = model.curve(made.found(*DRIFTS))
    taken = drift - np.mean(drift) + model.curve(made.found("line"))
    kept = np.delete(np.arange(len(angle)), bad)
    if not bad and not made.found("line", *DRIFTS):
        return made
    return Judged(run, angle[kept], (error - taken)[kept], taken[kept], sampling, model, parts, rows)


def _driven(parts: Mapping[str, float], default: float) -> tuple[float, ...]:
    fastest = max(parts.values(), default=default)
    return tuple(parts[name] for name in MOTOR if name in parts) or (fastest, fastest - 1)


def highest(parts: Mapping[str, float]) -> float:
    """Highest order that is searched.

    Args:
        parts: {name: order per revolution} of what the measured object can cause.
    """
    return max([FASTEST * max(_driven(parts, 100.0)), *parts.values()])


def _sampling(angle: np.ndarray, readings: int, parts: Mapping[str, float]) -> Sampling:
    steps = np.diff(angle)
    step = float(np.median(steps)) if len(steps) else 0.0
    stroke = float(np.ptp(angle)) + step if len(angle) else 0.0
    gap = 2 * math.pi - float(np.ptp(angle)) if len(angle) else math.inf
    if len(steps) and gap < 5 * float(np.mean(steps)):  # uneven places all round
        stroke = max(stroke, 2 * math.pi)
    top = max(parts.values(), default=100.0)
    around = np.sort(angle % (2 * math.pi))
    gaps = np.diff(around, append=around[0] + 2 * math.pi) if len(angle) else np.zeros(1)
    hole = float(np.max(gaps))
    hole = hole if hole > HOLE * max(float(np.mean(gaps)), step) else 0.0
    return Sampling(len(angle), readings, stroke, step, hole, repetition(angle, highest(parts) + 3 * top))


def _check_steps(curve: Judged) -> None:
    """Raise ValueError for a lost step."""
    for term in curve.found("step"):
        size = float(curve.model.size(term)[0][0])
        if abs(size) > LOST * curve.noise:
            at = curve.angle[int(term.at)] / deg
            gap = f"jumps by {size / arcsec:.3g} arcsec at {at:.5g} deg (row {curve.rows[int(term.at)]})"
            raise ValueError(f"{curve.run.name}: the error {gap}: a lost step; measure again")


ENDS = 40  # part of the readings that is an end of the curve, one in
OPEN = 5.0  # standard deviations from which on the ends do not meet
FOREIGN = 1 / 3
"""Rms of orders that no part makes, over that of the others. Large errors of several parts reach 1/10 in equilibria."""
NAMED = 4  # of these orders


def findings(judged: Judged) -> tuple[Finding, ...]:
    """Findings on a curve, warnings last.

    Args:
        judged: the curve.
    """
    every = [*_of_sampling(judged), *_closure(judged), *_drift(judged), *_noise(judged), *_lines(judged), *_bad(judged)]
    every += _alike(judged)
    return tuple(sorted(every, key=lambda finding: finding.warning))


def foreign(judged: Judged, multiples: Sequence[int]) -> tuple[Finding, ...]:
    """Warning of orders that no part of the measured object makes: another cause, or the curve of another object.

    Args:
        judged: the curve.
        multiples: numbers of which every order of a part is a multiple; none: any order may be one.
    """
    if not multiples:
        return ()
    sizes = {int(term.at): float(np.hypot(*judged.model.size(term)[0])) for term in judged.found("order")}
    other = {k: size for k, size in sizes.items() if k > LOW and all(k % each for each in multiples)}
    made = (size for k, size in sizes.items() if k > LOW and k not in other)
    rms, own = (math.hypot(*each) / math.sqrt(2) for each in (other.values(), made))
    if rms <= FOREIGN * own:
        return ()
    strongest = sorted(sorted(other, key=lambda k: -other[k])[:NAMED])
    name = f"order{'s' if strongest[1:] else ''} {', '.join(map(str, strongest))}"
    whole = " or ".join(map(str, multiples))
    text = (
        f"no part of this drive makes orders that are not multiples of {whole}. Above order {LOW} they have "
        f"{rms / arcsec:.3g} arcsec (rms), the others {own / arcsec:.3g}. Check that the curve is of this drive"
    )
    return (Finding(name, rms, "rad", text, True),)


def _of_sampling(judged: Judged) -> Iterator[Finding]:
    sampling = judged.sampling
    several = sampling.readings > sampling.points
    repeated = f"{sampling.readings} readings; the mean of each place counts" if several else ""
    yield Finding("points", float(sampling.points), "-", repeated)
    span = float(np.ptp(judged.model.angle)) if len(judged.model.angle) else 0.0
    rest = "the table continues its orders over the rest"
    if sampling.whole:
        yield Finding("stroke", sampling.stroke, "rad")
    elif sampling.stroke >= WHOLE:
        yield Finding("gap in the revolution", sampling.gap, "rad", f"not measured; {rest}", True)
    else:
        yield Finding("stroke", span, "rad", f"{span / deg:.4g} deg of 360 are measured; {rest}", True)
    if math.isfinite(sampling.repeat):
        equal = (
            f"{sampling.repeat:.5g} equal steps per revolution: order k and order {sampling.repeat:.5g} - k are alike"
        )
        yield Finding("highest resolved order", float(math.ceil(sampling.finest) - 1), "-", equal)
    elif judged.parts:
        searched = highest(judged.parts)
        yield Finding("highest resolved order", searched, "-", "no two orders up to it are alike at these angles")


def _closure(judged: Judged) -> Iterator[Finding]:
    """End less start of the curve, without its orders."""
    model, drifts = judged.model, judged.found(*DRIFTS)
    if not judged.sampling.whole or len(model.angle) < ENDS:
        return
    left, count = model.residual + model.curve(drifts), max(3, len(model.angle) // ENDS)
    gap = float(np.mean(left[-count:]) - np.mean(left[:count]))
    again = memory(model.residual)
    sd = judged.noise * math.sqrt(2 / count * (1 + again) / (1 - again))
    text = f"end less start of the curve without its orders, +- {sd / arcsec:.2g} arcsec"
    yield Finding("closure", gap, "rad", text, abs(gap) > OPEN * sd and not drifts)


def _drift(judged: Judged) -> Iterator[Finding]:
    model, turns = judged.model, float(np.ptp(judged.model.angle)) / (2 * math.pi)
    for term in judged.found(*DRIFTS):
        number, covariance = model.size(term)
        size, sd = float(number[0]), judged.noise * math.sqrt(float(covariance[0, 0]))
        if term.kind == "drift":
            per_turn, own = size / turns, sd / turns
            share = abs(per_turn) / (2 * math.pi)
            text = f"+- {own / arcsec:.2g} arcsec per revolution, taken off before the fit"
            wrong = f"; a ratio that is wrong by {share:.2g} of its value gives such a drift"
            yield Finding("drift per revolution", per_turn, "rad", text + wrong, True)
        elif term.kind == "warm-up":
            text = f"approached with an angle constant of {term.at / deg:.3g} deg, taken off before the fit"
            yield Finding("warm-up", size, "rad", text, True)
        else:
            row = judged.rows[int(term.at)]
            place = f"at {model.angle[int(term.at)] / deg:.5g} deg (row {row}), taken off before the fit"
            yield Finding("step", size, "rad", place, True)


def _noise(judged: Judged) -> Iterator[Finding]:
    yield Finding("noise of a reading", judged.noise, "rad", "standard deviation about the contents that were found")
    if (again := memory(judged.model.residual)) > 0.3:
        remembers = "correlation of a reading with the next one: low orders have more noise than high ones"
        yield Finding("memory of the noise", again, "-", remembers)


def _lines(judged: Judged) -> Iterator[Finding]:
    for term in judged.found("line"):
        number, _ = judged.model.size(term)
        name = term.name or next((n for n, own in judged.parts.items() if abs(own - term.at) < 0.02), "unknown cause")
        text = f"{name}: no whole number of periods in a revolution, so no table can hold it"
        yield Finding(f"order {term.at:.5g}", float(np.hypot(*number)), "rad", text, True)


def _bad(judged: Judged) -> Iterator[Finding]:
    for term in judged.found("glitch"):
        size, row = float(judged.model.size(term)[0][0]), int(term.at)
        text = f"row {judged.rows[row]}, {judged.model.angle[row] / deg:.5g} deg: left out"
        used = len(judged.angle) == len(judged.model.angle)
        yield Finding("bad reading", size, "rad", text.replace("left out", "one of many, used") if used else text, True)


def _alike(judged: Judged) -> Iterator[Finding]:
    """Parts whose orders are others at these angles; a warning where such an order may be taken for one of a part."""
    sampling, seen = judged.sampling, dict[float, str]()
    for name, order in judged.parts.items():
        if order >= sampling.finest:
            seen.setdefault(order, name)
    whole = [0.0, *(order for order in judged.parts.values() if order == round(order))]
    for order, name in seen.items():
        low = judged.looks_like(order)
        seen_as = f"looks like {low:.4g}" if low != order else "shows one phase only"  # two points in a period
        text = f"{sampling.points} points: order {order:.5g} ({name}) {seen_as}"
        near = order in whole or min(abs(low - own) for own in whole) < LOW + 1
        yield Finding("orders alike", low, "-", text, near)
