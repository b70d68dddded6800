"""Search for what a curve contains: whole orders, and what a correction table cannot hold."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import scipy

from rvjax.measured.atoms import Atom, Model, memory
from rvjax.measured.sampling import Sampling, spectrum

NUMBER = 10.0
"""Loss of likelihood that a further number of a model has to exceed; the wider class of models has to win clearly."""
LEAST = {"order": 25.0, "pair": 50.0, "line": 45.0, "drift": 25.0, "warm-up": 40.0, "step": 60.0, "glitch": 80.0}
"""Gain of minus twice the logarithm of the likelihood at which an atom is accepted; one order of a thousand by chance
is at 2 ln(1000/0.001) = 28."""
MOST = 60  # atoms
FREE = 4  # readings for each number of a model
LOW = 6  # orders of mountings and housings, which are in the first model
TIMES = (0.01, 3.0)  # least and largest angle constant of a warm-up, of the stroke
PARTIAL = 0.6  # revolutions from which on low orders are in the second start
NOTHING = 6.0  # square of an order over that of its noise: left out without a second look
NEAR = 1e-3  # a line that is closer to a whole number is one


def content(
    angle: np.ndarray, value: np.ndarray, sampling: Sampling, parts: Mapping[str, float], highest: float, timed: bool
) -> Model:
    """Model of a curve whose atoms the readings prove.

    Args:
        angle: ascending, rad (n,).
        value: (n,).
        sampling: of the angles.
        parts: {name: order per revolution} of what the measured object can cause.
        highest: order that is searched.
        timed: the readings are in the order of time, so that drift and steps have a meaning.
    """
    top = min(highest, math.nextafter(sampling.finest, 0))
    room = (len(angle) - 1) // FREE
    known = [order for order in dict.fromkeys(parts.values()) if order == round(order) and order < top]
    starts = [[1, *known]]
    if sampling.turns > PARTIAL:
        starts += [[1, *known, *range(2, LOW + 1)]]
    found = []
    for start in starts:
        first = [order for order in dict.fromkeys(start) if order < top][: max(room // 4, 1 if room > 1 else 0)]
        model = Model(angle, value, [Atom("order", float(order)) for order in first])
        found.append(_whole(_grown(model, sampling, parts, top, timed), top))
        if all(atom.kind == "order" and atom.at in first for atom in found[-1].atoms):
            break  # nothing that low orders could explain in another way
    return min(found, key=_loss)


def _grown(model: Model, sampling: Sampling, parts: Mapping[str, float], top: float, timed: bool) -> Model:
    """The model with all atoms that are proved, one after the other, and without the superfluous ones."""
    first = [atom.at for atom in model.atoms]
    room = (len(model.angle) - 1) // FREE
    while len(model.atoms) < MOST:
        if len(model.owner) + 3 < room:
            candidates = _candidates(model, sampling, parts, top, timed)
        elif len(model.owner) + FREE <= len(model.angle):  # few readings still show that one of them is wrong
            candidates = iter([_glitch(model, model.residual)])
        else:
            break
        found = _best(model, candidates)
        several = _two(model) if found is None else [found]
        if found is not None and found.kind == "pair":
            several = [Atom("order", float(math.floor(found.at) + k)) for k in (0, 1)]
        if not several:
            break
        more = Model(model.angle, model.value, [*model.atoms, *(a for a in several if a not in model.atoms)])
        more = _thinned(more, keep=first)
        if _loss(more) >= _loss(model):
            break
        model = more
    return _thinned(model, keep=[1])


def _whole(model: Model, top: float) -> Model:
    """The model with whole orders in place of a line between them, where these say the same with fewer numbers."""
    for line in [atom for atom in model.atoms if atom.kind == "line" and not atom.name]:
        near = (Atom("order", float(math.floor(line.at) + k)) for k in (-1, 0, 1, 2))
        added = [atom for atom in near if 1 <= atom.at < top and atom not in model.atoms]
        left = [atom for atom in model.atoms if atom != line]
        other = _thinned(Model(model.angle, model.value, [*left, *added]), keep=[1])
        model = min(model, other, key=_loss)
    return model


def _loss(model: Model) -> float:
    """Score and the price of its numbers."""
    return model.score + NUMBER * sum(atom.numbers for atom in model.atoms)


def _warm_up(model: Model, sampling: Sampling) -> Atom:
    """The warm-up that explains most; it lasts for several readings."""
    least = max(TIMES[0] * sampling.stroke, model.angle[min(3, len(model.angle) - 1)] - model.angle[0])
    found = scipy.optimize.minimize_scalar(
        lambda log: model.more(Atom("warm-up", math.exp(log) * sampling.stroke)),
        bounds=(math.log(min(least / sampling.stroke, 1.0)), math.log(TIMES[1])),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return Atom("warm-up", math.exp(float(found.x)) * sampling.stroke)


def _best(model: Model, candidates: Iterator[Atom]) -> Atom | None:
    """The atom that explains most for its numbers; None if none is proved."""
    gains = {}
    for atom in candidates:
        if atom not in model.atoms and atom not in gains:
            gains[atom] = model.score - model.more(atom)
    proved = {atom: gain - NUMBER * atom.numbers for atom, gain in gains.items() if gain > LEAST[atom.kind]}
    return max(proved, key=lambda atom: proved[atom]) if proved else None


def _candidates(
    model: Model, sampling: Sampling, parts: Mapping[str, float], top: float, timed: bool
) -> Iterator[Atom]:
    fresh = model.residual.copy()
    fresh[1:] -= memory(model.residual) * model.residual[:-1]
    for values in (model.residual, fresh):
        yield from _waves(model, values, sampling, parts, top)
        yield _glitch(model, values)
        if timed:
            yield _step(model, values)
    if timed:
        yield Atom("drift")
        yield _warm_up(model, sampling)
    for name, order in parts.items():
        if order != round(order) and order < top:
            yield Atom("line", order, name)


def _waves(
    model: Model, values: np.ndarray, sampling: Sampling, parts: Mapping[str, float], top: float
) -> Iterator[Atom]:
    """The strongest whole order, and the strongest line with the whole orders about it."""
    order, size = spectrum(model.angle, values, top)
    power = np.abs(size) ** 2
    whole = np.arange(1, math.floor(top) + 1)
    free = np.setdiff1d(whole, [atom.at for atom in model.atoms if atom.kind == "order"]).astype(float)
    if len(free):
        yield Atom("order", float(free[np.argmax(np.interp(free, order, power))]))
    inside = (order > 0.4 / sampling.turns) & (order > 0.4)
    if not np.any(inside):
        return
    start = float(order[inside][np.argmax(power[inside])])
    half = 0.5 / sampling.turns
    near = scipy.optimize.minimize_scalar(
        lambda at: model.more(Atom("line", float(at))),
        bounds=(max(start - half, 0.3), min(start + half, top)),
        method="bounded",
        options={"xatol": 1e-4 / sampling.turns},
    )
    at = float(near.x)
    if abs(at - round(at)) > NEAR:
        yield Atom("line", at)
    yield Atom("order", float(max(round(at), 1)))
    if math.floor(at) >= 1 and math.floor(at) + 1 < top:
        yield Atom("pair", at)


def _step(model: Model, values: np.ndarray) -> Atom:
    """The row from which on a constant explains most of the residual."""
    rows = np.arange(len(values), 0, -1.0)
    after = np.cumsum(values[::-1])[::-1]
    columns = np.cumsum(model.basis[::-1], axis=0)[::-1]
    own = rows - np.sum(columns**2, axis=1)
    good = own > 1e-3 * np.minimum(rows, len(values) - rows + 1)
    good[:3] = good[-2:] = False
    gain = np.where(good, after**2 / np.maximum(own, 1e-9), 0.0)
    return Atom("step", float(np.argmax(gain)))


def _glitch(model: Model, values: np.ndarray) -> Atom:
    """The reading that is farthest from the others."""
    own = np.maximum(1 - np.sum(model.basis**2, axis=1), 1e-3)
    return Atom("glitch", float(np.argmax(np.abs(values) / np.sqrt(own))))


def _two(model: Model) -> list[Atom]:
    """Two readings far from the others, each of which hides the other where readings are few; empty if none are."""
    count = len(model.angle)
    if count * math.log(2) > LEAST["glitch"] or len(model.owner) + FREE + 1 > count:
        return []
    first = _glitch(model, model.residual)
    more = Model(model.angle, model.value, [*model.atoms, first])
    second = _glitch(more, more.residual)
    gain = model.score - more.more(second)
    least = LEAST["glitch"] + 2 * NUMBER
    return [first, second] if first not in model.atoms and first != second and gain > least else []


def _thinned(model: Model, keep: Sequence[float]) -> Model:
    """The model without atoms that others have made superfluous.

    Args:
        model: to thin.
        keep: orders that stay.
    """
    while True:
        losses, nothing = {}, set()
        for atom in model.atoms:
            if atom.kind == "order" and atom.at in keep:
                continue
            number, cov = model.size(atom)
            noise = float(np.mean(model.residual**2)) * len(model.angle) / max(len(model.angle) - len(model.owner), 1)
            weight = float(number @ np.linalg.pinv(cov) @ number) / max(noise, model.least**2)
            if weight < NOTHING and atom.kind == "order":
                nothing.add(atom)
            elif weight < 4 * LEAST[atom.kind]:  # the quick look; the likelihood decides
                less = model.without(atom)
                if less.score - model.score < LEAST[atom.kind]:
                    losses[atom] = (less.score - model.score, less)
        if nothing:
            model = Model(model.angle, model.value, [a for a in model.atoms if a not in nothing])
            continue
        if not losses:
            return model
        model = min(losses.values(), key=lambda pair: pair[0])[1]
