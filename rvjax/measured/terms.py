"""Terms of a curve, and the search for them: orders, lines, drift, steps, single bad readings.

A model is a set of terms. It is fitted by least squares; its score is minus twice the logarithm of the likelihood of
residuals that remember the last one (first-order autoregression). So noise with memory is no content.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from rvjax.identify import svd
from rvjax.measured.run import Sampling, spectrum

COLLINEAR = 1e-8  # square of the share of a column that others do not explain
TINY = 1e-300
LEAST_NOISE = 1e-9  # of the spread of a curve: rounding


@dataclass(frozen=True)
class Term:
    """One content of a curve.

    Attributes:
        kind: "order", "pair" (of neighbouring orders), "line" (an order that is no whole number), "drift", "warm-up",
            "step" or "glitch".
        at: order, row of a step or of a bad reading, or angle constant of a warm-up, rad.
        name: of the part that causes it, "" if it is unknown.
    """

    kind: str
    at: float = 0.0
    name: str = field(default="", compare=False)

    @property
    def numbers(self) -> int:
        """Parameters: coefficients, and the place that was searched."""
        return {"order": 2, "pair": 4, "line": 2 if self.name else 3, "drift": 1}.get(self.kind, 2)

    def columns(self, angle: np.ndarray) -> np.ndarray:
        """Columns of the fit (n, k).

        Args:
            angle: ascending, rad (n,).
        """
        if self.kind in ("order", "line"):
            return np.stack([np.cos(self.at * angle), np.sin(self.at * angle)], axis=1)
        if self.kind == "pair":
            both = (Term("order", math.floor(self.at) + side).columns(angle) for side in (0, 1))
            return np.concatenate(list(both), axis=1)
        row = np.arange(len(angle))
        gone = (angle - angle[0]) / max(float(np.ptp(angle)), 1e-300)
        if self.kind == "drift":
            return gone[:, None]
        if self.kind == "warm-up":
            return np.asarray(-np.expm1(-(angle - angle[0]) / self.at))[:, None]
        return np.asarray(row >= self.at if self.kind == "step" else row == self.at, float)[:, None]


def memory(residual: np.ndarray) -> float:
    """Correlation of a residual with the next one, 0 where it is negative."""
    square = float(residual @ residual)
    return float(np.clip(residual[1:] @ residual[:-1] / square, 0.0, 0.9999)) if square > 0 else 0.0


def score(residual: np.ndarray, least: float) -> float:
    """Minus twice the logarithm of the likelihood of residuals with memory, without constants.

    Args:
        residual: in the order of time (n,).
        least: standard deviation below which noise is rounding.
    """
    fresh = float(np.mean(residual**2)) * (1 - memory(residual) ** 2)
    return len(residual) * math.log(max(fresh, least**2))


class Model:
    """Atoms fitted to a curve `value` at `angle`, with `basis` (orthonormal columns), `residual` and `score`."""

    def __init__(self, angle: np.ndarray, value: np.ndarray, terms: Sequence[Term]) -> None:
        """Fit terms.

        Args:
            angle: ascending, rad (n,).
            value: (n,).
            terms: in addition to the mean; columns that others explain are not used.
        """
        self.angle, self.value, self.terms = angle, value, tuple(terms)
        self.least = LEAST_NOISE * float(np.std(value)) + 1e-150
        matrix = np.concatenate([np.ones((len(angle), 1)), *(a.columns(angle) for a in terms)], axis=1)
        self.owner = np.array([-1, *(k for k, a in enumerate(terms) for _ in range(a.columns(angle[:2]).shape[1]))])
        self.matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), TINY)
        left, size, right = svd(self.matrix)
        kept = size > math.sqrt(COLLINEAR) * size[0]
        self.basis, self.inverse = left[:, kept], right[kept].T / size[kept]
        self.residual = value - self.basis @ (self.basis.T @ value)
        self.residual -= self.basis @ (self.basis.T @ self.residual)
        self.score = score(self.residual, self.least)

    def more(self, term: Term) -> float:
        """Score with one more term, which is not added."""
        columns = term.columns(self.angle)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), TINY)
        own = columns - self.basis @ (self.basis.T @ columns)
        left, size, _ = svd(own)
        left = left[:, size > math.sqrt(COLLINEAR)]
        return score(self.residual - left @ (left.T @ self.residual), self.least)

    def curve(self, terms: Sequence[Term]) -> np.ndarray:
        """Fitted curve of some terms (n,)."""
        own = np.array([k >= 0 and self.terms[k] in terms for k in self.owner])
        return np.asarray(self.matrix[:, own] @ (self.inverse @ (self.basis.T @ self.value))[own])

    def size(self, term: Term) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the columns of an term, and their covariance for noise of 1.

        Args:
            term: of the model.
        """
        own = self.owner == self.terms.index(term)
        scale = np.maximum(np.linalg.norm(term.columns(self.angle), axis=0), TINY)
        inverse = self.inverse[own] / scale[:, None]
        return inverse @ (self.basis.T @ self.value), inverse @ inverse.T

    def without(self, term: Term) -> "Model":
        """The model with one term less."""
        return Model(self.angle, self.value, [a for a in self.terms if a != term])

    def less(self, term: Term) -> float:
        """Score with one term less, which is not removed: the part of its columns that no others explain is lost.

        Args:
            term: of the model.
        """
        if len(self.owner) > self.basis.shape[1]:  # others explain some columns
            return self.without(term).score
        lost = np.linalg.qr(self.basis @ self.inverse[self.owner == self.terms.index(term)].T)[0]
        return score(self.residual + lost @ (lost.T @ self.value), self.least)


NUMBER = 10.0
"""Loss of likelihood that a further number of a model has to exceed; the wider class of models has to win clearly."""
LEAST = {"order": 25.0, "pair": 50.0, "line": 45.0, "drift": 25.0, "warm-up": 40.0, "step": 60.0, "glitch": 80.0}
"""Gain of minus twice the logarithm of the likelihood at which an term is accepted; one order of a thousand by chance
is at 2 ln(1000/0.001) = 28."""
MOST = 60  # terms
FREE = 4  # readings for each number of a model
LOW = 6  # orders of mountings and housings, which are in the first model
TIMES = (0.01, 3.0)  # least and largest angle constant of a warm-up, of the stroke
PARTIAL = 0.6  # revolutions from which on low orders are in the second start
NOTHING = 6.0  # square of an order over that of its noise: left out without a second look
NEAR = 1e-3  # a line that is closer to a whole number is one


def content(
    angle: np.ndarray, value: np.ndarray, sampling: Sampling, parts: Mapping[str, float], highest: float, timed: bool
) -> Model:
    """Model of a curve whose terms the readings prove.

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
    models = []
    for start in starts:
        first = [order for order in dict.fromkeys(start) if order < top][: max(room // 4, 1 if room > 1 else 0)]
        model = Model(angle, value, [Term("order", float(order)) for order in first])
        models.append(_whole(_grown(model, sampling, parts, top, timed), top))
        if all(term.kind == "order" and term.at in first for term in models[-1].terms):
            break  # nothing that low orders could explain in another way
    return min(models, key=_loss)


def _grown(model: Model, sampling: Sampling, parts: Mapping[str, float], top: float, timed: bool) -> Model:
    """The model with all terms that are proved, one after the other, and without the superfluous ones."""
    first = [term.at for term in model.terms]
    room = (len(model.angle) - 1) // FREE
    while len(model.terms) < MOST:
        if len(model.owner) + 3 < room:
            candidates = _candidates(model, sampling, parts, top, timed)
        elif len(model.owner) + FREE <= len(model.angle):  # few readings still show that one of them is wrong
            candidates = iter([_glitch(model, model.residual)])
        else:
            break
        best = _best(model, candidates)
        several = _two(model) if best is None else [best]
        if best is not None and best.kind == "pair":
            several = [Term("order", float(math.floor(best.at) + k)) for k in (0, 1)]
        if not several:
            break
        more = Model(model.angle, model.value, [*model.terms, *(a for a in several if a not in model.terms)])
        more = _thinned(more, keep=first)
        if _loss(more) >= _loss(model):
            break
        model = more
    return _thinned(model, keep=[1])


def _whole(model: Model, top: float) -> Model:
    """The model with whole orders in place of a line between them, where these say the same with fewer numbers."""
    for line in [term for term in model.terms if term.kind == "line" and not term.name]:
        near = (Term("order", float(math.floor(line.at) + k)) for k in (-1, 0, 1, 2))
        added = [term for term in near if 1 <= term.at < top and term not in model.terms]
        left = [term for term in model.terms if term != line]
        other = _thinned(Model(model.angle, model.value, [*left, *added]), keep=[1])
        model = min(model, other, key=_loss)
    return model


def _loss(model: Model) -> float:
    """Score and the price of its numbers."""
    return model.score + NUMBER * sum(term.numbers for term in model.terms)


def _warm_up(model: Model, sampling: Sampling) -> Term:
    """The warm-up that explains most; it lasts for several readings."""
    least = max(TIMES[0] * sampling.stroke, model.angle[min(3, len(model.angle) - 1)] - model.angle[0])
    minimum = scipy.optimize.minimize_scalar(
        lambda log: model.more(Term("warm-up", math.exp(log) * sampling.stroke)),
        bounds=(math.log(min(least / sampling.stroke, 1.0)), math.log(TIMES[1])),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return Term("warm-up", math.exp(float(minimum.x)) * sampling.stroke)


def _best(model: Model, candidates: Iterator[Term]) -> Term | None:
    """The term that explains most for its numbers; None if none is proved."""
    gains = {}
    for term in candidates:
        if term not in model.terms and term not in gains:
            gains[term] = model.score - model.more(term)
    proved = {term: gain - NUMBER * term.numbers for term, gain in gains.items() if gain > LEAST[term.kind]}
    return max(proved, key=lambda term: proved[term]) if proved else None


def _candidates(
    model: Model, sampling: Sampling, parts: Mapping[str, float], top: float, timed: bool
) -> Iterator[Term]:
    fresh = model.residual.copy()
    fresh[1:] -= memory(model.residual) * model.residual[:-1]
    for values in (model.residual, fresh):
        yield from _waves(model, values, sampling, top)
        yield _glitch(model, values)
        if timed:
            yield _step(model, values)
    if timed:
        yield Term("drift")
        yield _warm_up(model, sampling)
    for name, order in parts.items():
        if order != round(order) and order < top:
            yield Term("line", order, name)


def _waves(model: Model, values: np.ndarray, sampling: Sampling, top: float) -> Iterator[Term]:
    """The strongest whole order, and the strongest line with the whole orders about it."""
    order, size = spectrum(model.angle, values, top)
    power = np.abs(size) ** 2
    whole = np.arange(1, math.floor(top) + 1)
    free = np.setdiff1d(whole, [term.at for term in model.terms if term.kind == "order"]).astype(float)
    if len(free):
        yield Term("order", float(free[np.argmax(np.interp(free, order, power))]))
    inside = (order > 0.4 / sampling.turns) & (order > 0.4)
    if not np.any(inside):
        return
    start = float(order[inside][np.argmax(power[inside])])
    half = 0.5 / sampling.turns
    near = scipy.optimize.minimize_scalar(
        lambda at: model.more(Term("line", float(at))),
        bounds=(max(start - half, 0.3), min(start + half, top)),
        method="bounded",
        options={"xatol": 1e-4 / sampling.turns},
    )
    at = float(near.x)
    if abs(at - round(at)) > NEAR:
        yield Term("line", at)
    yield Term("order", float(max(round(at), 1)))
    if math.floor(at) >= 1 and math.floor(at) + 1 < top:
        yield Term("pair", at)


def _step(model: Model, values: np.ndarray) -> Term:
    """The row from which on a constant explains most of the residual."""
    rows = np.arange(len(values), 0, -1.0)
    after = np.cumsum(values[::-1])[::-1]
    columns = np.cumsum(model.basis[::-1], axis=0)[::-1]
    own = rows - np.sum(columns**2, axis=1)
    good = own > 1e-3 * np.minimum(rows, len(values) - rows + 1)
    good[:3] = good[-2:] = False
    gain = np.where(good, after**2 / np.maximum(own, 1e-9), 0.0)
    return Term("step", float(np.argmax(gain)))


def _glitch(model: Model, values: np.ndarray) -> Term:
    """The reading that is farthest from the others."""
    own = np.maximum(1 - np.sum(model.basis**2, axis=1), 1e-3)
    return Term("glitch", float(np.argmax(np.abs(values) / np.sqrt(own))))


def _two(model: Model) -> list[Term]:
    """Two readings far from the others, each of which hides the other where readings are few; empty if none are."""
    count = len(model.angle)
    if count * math.log(2) > LEAST["glitch"] or len(model.owner) + FREE + 1 > count:
        return []
    first = _glitch(model, model.residual)
    more = Model(model.angle, model.value, [*model.terms, first])
    second = _glitch(more, more.residual)
    gain = model.score - more.more(second)
    least = LEAST["glitch"] + 2 * NUMBER
    return [first, second] if first not in model.terms and first != second and gain > least else []


def _thinned(model: Model, keep: Sequence[float]) -> Model:
    """The model without terms that others have made superfluous.

    Args:
        model: to thin.
        keep: orders that stay.
    """
    while True:
        losses, nothing = dict[Term, float](), set[Term]()
        for term in model.terms:
            if term.kind == "order" and term.at in keep:
                continue
            number, cov = model.size(term)
            noise = float(np.mean(model.residual**2)) * len(model.angle) / max(len(model.angle) - len(model.owner), 1)
            weight = float(number @ np.linalg.pinv(cov) @ number) / max(noise, model.least**2)
            if weight < NOTHING and term.kind == "order":
                nothing.add(term)
            elif weight < 4 * LEAST[term.kind]:  # the quick look; the likelihood decides
                loss = model.less(term) - model.score
                if loss < LEAST[term.kind]:
                    losses[term] = loss
        if nothing:
            model = Model(model.angle, model.value, [a for a in model.terms if a not in nothing])
            continue
        if not losses:
            return model
        model = model.without(min(losses, key=lambda term: losses[term]))
