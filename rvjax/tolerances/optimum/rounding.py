"""From half-widths to ISO 286 grades: the cheapest whose certificate holds, and the other fields fitted to them."""

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.population import GRADES, it_width
from rvjax.response import is_costly
from rvjax.tolerances.batch.monte_carlo import Statistics
from rvjax.tolerances.optimum.certificate import DRAWS, Certifier
from rvjax.tolerances.optimum.conlin import cheapest, predicted
from rvjax.tolerances.optimum.cost import Cost
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.found import Found, with_grades
from rvjax.tolerances.optimum.margins import Margins
from rvjax.tolerances.optimum.sample_average import Point
from rvjax.tolerances.optimum.search import BEYOND, RADIUS, Search
from rvjax.tolerances.requirements.factors import CUSHION

_DRAWS = 2  # certificates of one set of grades, whose free fields shrink between them
_LAST = 5  # of the set that is left where no cheaper one holds
_EXCHANGES = 6  # certificates of exchanged grades, at most
_TRIED = 12  # sets of exchanged grades evaluated on the learning sample, at most, after each accepted set
_MOVES = 5000  # sets of three or four exchanged grades evaluated on the model, at most
_LEAST_SURPLUS = 0.5  # of what the first certificate added to the cost: other sets of grades may need less
_MET = 0.01  # excess within the error of the sample
_NEAR = 0.01  # beyond a limit, in parts of the way there, within which the model or the sample may err

Places = dict[int, int]  # of graded fields on their ladders


class Rounding:
    """Chooses grades for the fields with a size, and fits the half-widths of the other fields to them."""

    def __init__(self, search: Search, certifier: Certifier, priced: dict[str, Cost]) -> None:
        self.search, self.training, self.certifier, self.priced = search, search.training, certifier, priced
        self.costs, self.cost, self.max_steps = search.costs, search.cost, search.max_steps
        active = search.training.population.active
        self.ladders = {j: _ladder(active[name].size, cost) for j, (name, cost) in enumerate(priced.items())}
        self.known: list[tuple[np.ndarray, Statistics]] = []
        """Certified half-widths, whether their certificate holds or not."""
        self.tried: list[Places] = []
        """Grades to which free fields were fitted."""
        self.surplus = 1.0
        """Cost of certified half-widths over that of the optimum of the sample, at least."""

    def graded(self, half_widths: np.ndarray, certificate: Statistics) -> tuple[np.ndarray, dict[str, str], Statistics]:
        """The loosest grades not wider than certified half-widths, then cheaper ones while a certificate holds.

        A field without a size, or without a grade within its process range that is as fine as its half-width, stays
        free: it uses the remaining margin. With free fields the model orders the sets near these grades, cheapest
        first. Without any one grade at a time becomes coarser, by saving. Exchanges end the search: some fields one
        grade coarser, others finer.

        Returns:
            Half-widths, {field: grade} of the rounded ones, and the certificate of exactly these.
        """
        places: Places = {}
        self.known = [(half_widths, certificate)]
        for j, ladder in self.ladders.items():
            fitting = sum(t <= half_widths[j] * (1 + 1e-9) for _, t in ladder)
            if fitting:
                places[j] = fitting - 1
        if not places:
            return half_widths, {}, certificate
        learned = self.cost(self.search.model_optimum(self.search.look(half_widths), RADIUS)[0])
        self.surplus = 1 + _LEAST_SURPLUS * max(self.cost(half_widths) / learned - 1, 0.0) if learned > 0 else 1.0
        best = self.at(places, half_widths)
        proof: Statistics | None  # none yet: finer than what is certified, and most often not the last word
        if len(places) < len(self.priced):
            places, best, proof = self.cheapest_first(places, best, self.search.look(half_widths))
        else:
            places, best, proof = self.coarsened(places, best)
        fields = list(self.priced)
        certificate = proof or self.certifier.draw(self.training.with_half_widths(best), alone=True)
        if not self.certifier.holds(certificate) and len(places) < len(self.priced):  # finer need not be better
            self.known.append((best, certificate))
            found, drawn = self.certified(places, best, most=math.inf)
            if drawn is not None and self.certifier.holds(drawn):
                best, certificate = found, drawn
        if self.certifier.holds(certificate):
            places, best, certificate = self.exchanged(places, best, certificate)
        return best, {fields[j]: self.ladders[j][place][0] for j, place in places.items()}, certificate

    def coarsened(self, places: Places, best: np.ndarray) -> tuple[Places, np.ndarray, Statistics | None]:
        """One grade after the other coarser, by saving, while a certificate holds; None if none was tried."""
        proof: Statistics | None = None
        open_ = set(places)
        while proof is None or self.certifier.holds(proof):
            open_ = {j for j in open_ if places[j] + 1 < len(self.ladders[j])}
            if not open_:
                break
            j = max(open_, key=lambda j: self.saving(j, places[j]))
            trial = {**places, j: places[j] + 1}
            found, drawn = self.certified(trial, best)
            if drawn is not None and self.certifier.holds(drawn) and self.cost(found) < self.cost(best):
                best, places, proof = found, trial, drawn
            else:
                open_.remove(j)
        return places, best, proof

    def cheapest_first(
        self, places: Places, best: np.ndarray, point: Point
    ) -> tuple[Places, np.ndarray, Statistics | None]:
        """Of some grades and those near them the first set whose certificate holds; None if none does.

        Args:
            places: of the grades.
            best: half-widths with these grades.
            point: whose model orders the sets by cost.
        """
        trials = self.proposed(places, point, best)[:_TRIED]
        for trial in trials if places in trials else [*trials, places]:
            found, drawn = self.certified(trial, best, model=point)
            if drawn is not None and self.certifier.holds(drawn) and self.cost(found) < self.cost(best):
                return trial, found, drawn
        return places, best, None

    def exchanged(
        self, places: Places, best: np.ndarray, certificate: Statistics
    ) -> tuple[Places, np.ndarray, Statistics]:
        """Cheaper grades near certified ones: the model proposes, the sample selects, a certificate decides."""
        most = self.certifier.drawn + _EXCHANGES
        while True:
            point = self.search.look(best)
            for trial in self.proposed(places, point, best)[:_TRIED]:
                found, drawn = self.certified(trial, best, _NEAR, model=point)
                if drawn is not None and self.certifier.holds(drawn) and self.cost(found) < self.cost(best):
                    places, best, certificate = trial, found, drawn
                    break
                if self.certifier.drawn >= most:
                    return places, best, certificate
            else:
                return places, best, certificate

    def proposed(self, places: Places, point: Point, best: np.ndarray) -> list[Places]:
        """Exchanged grades that are feasible and cheaper in the model around a point, the cheapest first.

        Args:
            places: of the grades from which fields move.
            point: of the model.
            best: half-widths that cost more. Free fields are searched and certified, which adds to their cost.
        """
        now = self.cost(best) * (1 - 1e-9)
        trials = [trial for trial in (places, *self.moves(places)) if trial not in self.tried]
        if len(places) < len(self.priced):  # the coarsest free fields cost least, the finest keep the limits best
            now = min(now, (1 + _NEAR) * self.dearest(best))
            trials = [trial for trial in trials if self.cost(self.at(trial, self.search.high)) < now]
            held = self._held(point, [self.at(trial, self.search.low) for trial in trials])
            trials = [trial for trial, yes in zip(trials, held) if yes]
        fits = [self.fitted(trial, point) for trial in trials]
        costs = [self.cost(t) if yes else math.inf for t, yes in zip(fits, self._held(point, fits))]
        return [trials[k] for k in np.argsort(costs, kind="stable") if costs[k] < now]

    def _held(self, point: Point, sets: list[np.ndarray]) -> np.ndarray:
        """Half-widths (n,) that keep every limit in the model around a point, within its error."""
        each = np.reshape(sets, (-1, len(point.half_widths)))
        return np.all(predicted(point, self.training.distance, self.training.powers, each) <= 1 + _NEAR, axis=1)

    def moves(self, places: Places) -> Iterator[Places]:
        """Up to two grades coarser or finer in one or two fields; one grade in up to four where fields are few.

        Without free fields, which finer grades may make cheaper, one becomes coarser at least.
        """
        free = len(places) < len(self.priced)
        for count in range(1, min(len(places), 2 if free else 4) + 1):
            if count > 2 and math.comb(len(places), count) * 2**count > _MOVES:
                return
            for fields in itertools.combinations(places, count):
                for steps in itertools.product((1, -1) if count > 2 else (1, -1, 2, -2), repeat=count):
                    moved = {j: places[j] + step for j, step in zip(fields, steps)}
                    if (free or max(steps) > 0) and all(
                        0 <= place < len(self.ladders[j]) for j, place in moved.items()
                    ):
                        yield places | moved

    def fitted(self, places: Places, point: Point) -> np.ndarray:
        """Half-widths with these grades, the free fields as the model around a point fits them."""
        t = self.at(places, point.half_widths)
        if len(places) == len(self.priced):
            return t
        held = np.array([j in places for j in range(len(t))])
        low, high = (np.where(held, t, end) for end in (self.search.low, self.search.high))
        return cheapest(self.costs, point, self.training.distance, self.training.powers, low, high)[0]

    def certified(
        self,
        places: Places,
        half_widths: np.ndarray,
        beyond: float = BEYOND,
        most: float | None = None,
        model: Point | None = None,
    ) -> tuple[np.ndarray, Statistics | None]:
        """The free fields fitted to some grades, and a certificate unless it is foreseen that it would not hold.

        `beyond` a limit by more than this part of the way there, the learning sample alone decides. They cost less than
        `most`; None: than the half-widths. The search begins where the model around a point fits the free fields.
        """
        dearest, most = (self.dearest(half_widths), self.cost(half_widths)) if most is None else (most, most)
        t, free = self.at(places, half_widths), len(places) < len(self.priced)
        search = Search(self.training, self.priced, self.max_steps)
        if free:
            self.tried.append(places)
            held = np.array([j in places for j in range(len(t))])
            search.low, search.high = np.where(held, t, search.low), np.where(held, t, search.high)
            point = search.look(t if model is None else self.fitted(places, model))
            finest = predicted(point, self.training.distance, self.training.powers, search.low[None])
            if not (finest <= 1 + beyond).all():
                return t, None
            point, _ = search.run(point, dearest)
            if self.cost(search.model_optimum(point, RADIUS)[0]) > dearest:
                return t, None
            t = point.half_widths
        drawn: Statistics | None = None
        for _ in range((_LAST if math.isinf(most) else _DRAWS) if free else 1):
            if free and (ways := self.foreseen(t)).max() > 1:
                t = search.tightened(point, t, 1 / ways)
            refused = self.foreseen(t, -CUSHION).max() > 1 or not self.search.promising(t, beyond)
            if refused or self.cost(t) >= most:
                break
            drawn = self.certifier.draw(self.training.with_half_widths(t), alone=True)
            self.known.append((t, drawn))
            if self.certifier.holds(drawn):
                break
        return t, drawn

    def dearest(self, half_widths: np.ndarray) -> float:
        """Cost of an optimum of the sample beyond which its certificate would cost more than these half-widths."""
        return self.cost(half_widths) / self.surplus if self.search.rays is None else math.inf

    def foreseen(self, half_widths: np.ndarray, more: float = 0.0) -> np.ndarray:
        """Way of each constraint (c,) to its limit, 1 where a certificate would just hold.

        It is that of the certificate with the nearest half-widths, changed as the learning sample changes.
        """
        near, statistics = min(self.known, key=lambda item: float(np.abs(np.log(item[0] / half_widths)).max()))
        seen = 1 / self.certifier.factors(statistics, self.training.distance, more)
        here, there = (1 + self.training.margins(t) / self.training.distance for t in (half_widths, near))
        return seen * np.maximum(here, 1e-3) / np.maximum(there, 1e-3)

    def at(self, places: Places, half_widths: np.ndarray) -> np.ndarray:
        """Half-widths with these grades, the free fields as they are."""
        t = half_widths.copy()
        for j, place in places.items():
            t[j] = self.ladders[j][place][1]
        return t

    def saving(self, j: int, place: int) -> float:
        """Saving of the next coarser grade of a field."""
        now, then = (float(self.costs[j](jnp.asarray(self.ladders[j][k][1]))) for k in (place, place + 1))
        return now - then


def ladders_of(decisions: Decisions) -> list[list[tuple[str, float]]]:
    """Grades of each field that has a cost, finest first, with their half-widths; none without a size."""
    return [_ladder(decisions.base.active[name].size, cost) for name, cost in decisions.priced.items()]


def _ladder(size: Any, cost: Cost) -> list[tuple[str, float]]:
    """Grades within the process range, finest first, with their half-widths."""
    if size is None:
        return []
    steps = [(grade, it_width(grade, size) / 2) for grade in GRADES]
    return [(grade, t) for grade, t in steps if cost.finest <= t * (1 + 1e-9) and t <= cost.coarsest * (1 + 1e-9)]


def graded_by_objective(
    found: Found, margins: Margins, certifier: Certifier, drawn: Callable[[np.ndarray], Statistics]
) -> tuple[Found, dict[str, str]]:
    """Grades of the least cost with losses: one grade at a time moves while that gains on the sample.

    Where a certificate does not hold, the grade that costs least to tighten is the next.

    Args:
        found: the solution.
        margins: on a sample.
        certifier: of the certificates.
        drawn: the certificate of a vector.
    """
    decisions, count = found.decisions, len(found.decisions.fields)
    margins.begin(found.x)
    if is_costly(margins.response):
        margins.follow(found.x)
    ladders = {j: ladder for j, ladder in enumerate(ladders_of(decisions)) if ladder}

    def at(places: dict[int, int]) -> np.ndarray:
        t = decisions.half_widths(found.x)
        t[list(places)] = [ladders[j][place][1] for j, place in places.items()]
        return decisions.with_half_widths(found.x, t)

    def worth(places: dict[int, int]) -> tuple[bool, float]:
        point = margins.look(at(places), sloped=False)
        excess = float(point.margins.max(initial=-math.inf))
        return excess > _MET, point.total if excess <= _MET else excess

    def moved(places: dict[int, int], steps: tuple[int, ...]) -> list[dict[int, int]]:
        return [
            places | {j: place + step}
            for j, place in places.items()
            for step in steps
            if 0 <= place + step < len(ladders[j])
        ]

    wide = np.exp(found.x[:count])
    places = {j: int(np.argmin([abs(math.log(t / wide[j])) for _, t in steps])) for j, steps in ladders.items()}
    best = worth(places)
    while rivals := [(w, p) for p in moved(places, (1, -1)) if (w := worth(p)) < best]:
        best, places = min(rivals, key=lambda item: item[0])
    certificate = drawn(at(places))
    for _ in range(DRAWS):
        finer = moved(places, (-1,))
        if certifier.holds(certificate) or certifier.hopeless() or not finer:
            break
        places = min(finer, key=worth)
        certificate = drawn(at(places))
    x, held = at(places), certifier.holds(certificate)
    there = with_grades(found, x, certificate, margins.total(x), certified=held)
    return there, {decisions.fields[j]: ladders[j][place][0] for j, place in places.items()}
