"""Findings on a curve: points, stroke, closure, drift, noise, orders that are not distinguishable."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from rvjax.measured.atoms import memory
from rvjax.measured.judge import DRIFTS, Judged, highest
from rvjax.measured.kind import Finding
from rvjax.measured.sampling import WHOLE
from rvjax.measured.search import LOW
from rvjax.units import arcsec, deg

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
    every = [*_sampling(judged), *_closure(judged), *_drift(judged), *_noise(judged), *_lines(judged), *_bad(judged)]
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
    sizes = {int(atom.at): float(np.hypot(*judged.model.size(atom)[0])) for atom in judged.found("order")}
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


def _sampling(judged: Judged) -> Iterator[Finding]:
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
    for atom in judged.found(*DRIFTS):
        number, covariance = model.size(atom)
        size, sd = float(number[0]), judged.noise * math.sqrt(float(covariance[0, 0]))
        if atom.kind == "drift":
            per_turn, own = size / turns, sd / turns
            share = abs(per_turn) / (2 * math.pi)
            text = f"+- {own / arcsec:.2g} arcsec per revolution, taken off before the fit"
            wrong = f"; a ratio that is wrong by {share:.2g} of its value gives such a drift"
            yield Finding("drift per revolution", per_turn, "rad", text + wrong, True)
        elif atom.kind == "warm-up":
            text = f"approached with an angle constant of {atom.at / deg:.3g} deg, taken off before the fit"
            yield Finding("warm-up", size, "rad", text, True)
        else:
            row = judged.rows[int(atom.at)]
            place = f"at {model.angle[int(atom.at)] / deg:.5g} deg (row {row}), taken off before the fit"
            yield Finding("step", size, "rad", place, True)


def _noise(judged: Judged) -> Iterator[Finding]:
    yield Finding("noise of a reading", judged.noise, "rad", "standard deviation about the contents that were found")
    if (again := memory(judged.model.residual)) > 0.3:
        remembers = "correlation of a reading with the next one: low orders have more noise than high ones"
        yield Finding("memory of the noise", again, "-", remembers)


def _lines(judged: Judged) -> Iterator[Finding]:
    for atom in judged.found("line"):
        number, _ = judged.model.size(atom)
        name = atom.name or next((n for n, own in judged.parts.items() if abs(own - atom.at) < 0.02), "unknown cause")
        text = f"{name}: no whole number of periods in a revolution, so no table can hold it"
        yield Finding(f"order {atom.at:.5g}", float(np.hypot(*number)), "rad", text, True)


def _bad(judged: Judged) -> Iterator[Finding]:
    for atom in judged.found("glitch"):
        size, row = float(judged.model.size(atom)[0][0]), int(atom.at)
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
