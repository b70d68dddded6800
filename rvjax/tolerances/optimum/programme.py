"""Sequential quadratic programme in a trust region: the cheapest vector of decisions that meets all margins.

Every step minimises a quadratic model of the cost under linear models of the margins, which may be exceeded at a high
price (Fletcher 1982). The curvature of the half-widths is that of their costs and of a root sum of squares; that of all
else is learned from slopes (Powell's damped update). Where a margin is the largest of several functions, it has a
corner: slopes of earlier points that are still below it stay in the model, so that every side of the corner counts.
A step that fails is measured again: the margins at its end correct the model once.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from rvjax.tolerances.optimum.local import Local
from rvjax.tolerances.optimum.quadratic import Minimum, minimum

SETTLED = 2e-5
"""Predicted gain, as a part of the cost, below which a search ends."""

MET = 1e-4
"""Excess of a margin, as a part of its way, that counts as met."""

_RADIUS, _LARGEST, _LEAST = 1.0, 2.0, 1e-6
_POOR, _GOOD = 0.1, 0.7  # parts of a predicted gain
_ROUNDING = 1e-7  # of a bound
_PLANES = 3  # slopes of earlier points that a margin keeps
_NEAR = 0.3  # of the radius of a step, by which such a point may lie away, and more
_NOTHING = 1e-3  # of the sum of slopes, a cost that is next to nothing
_FLAT = 0.01  # of the cost, savings that are next to none
_AT = 1e-6  # distance from a bound that is none
_NO_PRICE = 1e-7  # of the cost, price of a way that is rounding
_DEAREST = 1e5  # price of an excess, in costs


@dataclasses.dataclass(frozen=True)
class End:
    """End of a search.

    Attributes:
        point: where it ended.
        prices: (c,) of the margins, cost per way of each; 0 where one does not bind.
        at_low: (n,) rate at which the cost grows with each lower bound, per unit of the vector, not negative.
        at_high: (n,) rate at which it falls with each upper bound, not negative.
        curvature: (n, n) that was learned.
        settled: True if no step promises a gain.
        looks: vectors that were evaluated.
    """

    point: Local
    prices: np.ndarray
    at_low: np.ndarray
    at_high: np.ndarray
    curvature: np.ndarray
    settled: bool
    looks: int

    @property
    def residual(self) -> float:
        """Largest saving of a single entry that no price accounts for, as a part of all savings.

        Inside all bounds and limits an optimum has no savings; there the least that counts is a part of the cost.
        """
        pull = self.point.slopes + self.point.objective_slopes + self.prices @ self.point.jacobian
        left = pull - self.at_low + self.at_high
        total = float(np.abs(self.point.slopes).sum() + np.abs(self.point.objective_slopes).sum())
        total = max(total, _FLAT * abs(self.point.total))
        return float(np.abs(left).max(initial=0.0)) / total if total > 0 else 0.0

    @property
    def excess(self) -> float:
        """Largest margin, in parts of its way; negative where all are met."""
        return float(self.point.margins.max(initial=-np.inf))


@dataclasses.dataclass(frozen=True)
class _Plane:
    """Linear function of the vector that supports a margin, or the objective (group of the last number)."""

    group: int
    at: np.ndarray
    value: float
    slope: np.ndarray


class Programme:
    """Search from one vector of decisions."""

    def __init__(
        self,
        look: Callable[[np.ndarray], Local],
        low: np.ndarray,
        high: np.ndarray,
        reach: np.ndarray,
        most: int,
        *,
        settled: float = SETTLED,
        elastic: np.ndarray | None = None,
    ) -> None:
        """Bounds (n,) of the vector, reach (n,) of a step of radius 1, and the most vectors to evaluate.

        `elastic` (c,) are prices of an excess that stay as they are; without them they rise until all margins are met.
        """
        self._look, self.low, self.high, self.reach, self.most = look, low, high, reach, most
        self.settled_at, self.looks, self._elastic = settled, 0, elastic
        self._planes: list[_Plane] = []

    def look(self, x: np.ndarray) -> Local:
        """Evaluate a vector and count it."""
        self.looks += 1
        return self._look(x)

    def run(self, start: np.ndarray, radius: float = _RADIUS, curvature: np.ndarray | None = None) -> End:
        """The cheapest vector from a start on; `curvature` (n, n) is that of an earlier search nearby."""
        best = self.look(np.clip(start, self.low, self.high))
        count = len(best.margins)
        hessian = self._first(best) if curvature is None else curvature
        elastic = np.full(count, 2 * self._size(best)) if self._elastic is None else self._elastic
        settled = False
        plan = self._plan(best, hessian, elastic, radius)
        while self.looks < self.most:
            broken = self._broken(best)
            promise = self._model_gain(best, plan, hessian, elastic)
            size = self._size(best)
            if promise <= self.settled_at * size or radius < _LEAST:
                worse = broken.max(initial=0.0) > MET and elastic.max() < _DEAREST * size and self._elastic is None
                if worse and radius >= _LEAST:
                    elastic = np.where(broken > MET, 10 * elastic, elastic)
                    plan = self._plan(best, hessian, elastic, radius)
                    continue
                settled = promise <= 10 * self.settled_at * size
                break
            trial = self.look(self._reached(best, plan))
            gain = self._merit(best, elastic) - self._merit(trial, elastic)
            if not gain > _POOR * promise and np.isfinite(trial.margins).all() and self.looks < self.most:
                again = self._plan(best, hessian, elastic, radius, trial)
                other = self.look(self._reached(best, again))
                better = self._merit(best, elastic) - self._merit(other, elastic)
                if better > gain or not np.isfinite(gain):
                    trial, gain, plan = other, better, again
            length = float(np.abs(plan.step / self.reach).max())
            self._keep(trial)
            if not gain > 0:
                radius = min(radius, length) / 4
            else:
                self._keep(best)
                hessian = self._updated(best, trial, hessian, plan)
                if gain > _GOOD * promise:
                    radius = min(_LARGEST, max(radius, 2 * length))
                elif gain < _POOR * promise:
                    radius = min(radius, length) / 2
                best = trial
            if self._elastic is None:
                elastic = np.maximum(elastic, 2 * plan.prices[:count])
            plan = self._plan(best, hessian, elastic, radius)
        return self._end(best, hessian, elastic, settled)

    def _reached(self, best: Local, plan: Minimum) -> np.ndarray:
        """End of a step, at a bound where it is a rounding error away."""
        x = best.x + plan.step
        x = np.where(x < self.low + _ROUNDING, self.low, x)
        return np.where(x > self.high - _ROUNDING, self.high, x)

    def _end(self, best: Local, hessian: np.ndarray, elastic: np.ndarray, settled: bool) -> End:
        """The end, with prices where the step is free to go."""
        free = self._plan(best, hessian, elastic, _NEAR)
        x = best.x + free.step
        bound = np.where(free.at_low > free.at_high, self.low, self.high)
        held = (np.abs(x - bound) <= _AT) & (np.abs(best.x - bound) > _AT) & (free.at_low + free.at_high > 0)
        if held.any():  # a step that gains too little for the search, but a bound has a price
            there = self.look(np.where(held, bound, best.x))
            if self._merit(there, elastic) <= self._merit(best, elastic) + self.settled_at * self._size(best):
                best = there
                free = self._plan(best, hessian, elastic, _NEAR)
                x = best.x + free.step
        prices = np.where(free.prices > _NO_PRICE * self._size(best), free.prices, 0.0)[: len(best.margins)]
        at_low = np.where(x <= self.low + _AT, free.at_low, 0.0)
        at_high = np.where(x >= self.high - _AT, free.at_high, 0.0)
        return End(best, prices, at_low, at_high, hessian, settled, self.looks)

    # The model.

    def _plan(
        self, best: Local, hessian: np.ndarray, elastic: np.ndarray, radius: float, measured: Local | None = None
    ) -> Minimum:
        """Step of the model; the margins as `measured` at the end of an earlier step correct it."""
        self._active = self._rows(best, radius)
        rows = [(g, v, s) for g, v, s in self._active if np.isfinite(v)]
        count = len(best.margins)
        groups = np.array([g for g, _, _ in rows], int)
        excess = np.array([v for _, v, _ in rows])
        slopes = np.reshape([s for _, _, s in rows], (len(rows), len(best.x)))
        if measured is not None:
            step = measured.x - best.x
            for k in range(count):
                own = np.flatnonzero(groups == k)
                if len(own):
                    told = float((excess[own] + slopes[own] @ step).max())
                    excess[own] += float(measured.margins[k]) - told
        low = np.maximum(self.low - best.x, -radius * self.reach)
        high = np.minimum(self.high - best.x, radius * self.reach)
        low, high = np.minimum(low, -1e-9), np.maximum(high, 1e-9)
        size = self._size(best)
        found = minimum(
            best.slopes / size, hessian / size, slopes, excess, groups, np.append(elastic / size, 1.0),
            np.arange(count + 1) == count, low, high,
        )  # fmt: skip
        prices = found.prices * size
        return Minimum(found.step, self._by_row(rows, prices, count), found.at_low * size, found.at_high * size)

    @staticmethod
    def _by_row(rows: list[tuple[int, float, np.ndarray]], prices: np.ndarray, count: int) -> np.ndarray:
        """Prices added up by group (c + 1,)."""
        found = np.zeros(count + 1)
        for (group, _, _), price in zip(rows, prices):
            found[group] += price
        return found

    def _rows(self, best: Local, radius: float) -> list[tuple[int, float, np.ndarray]]:
        """Linear models of the margins and the objective at a point: their own, and those of earlier points below."""
        count, size = len(best.margins), self._size(best)
        found = [(k, float(m), s) for k, (m, s) in enumerate(zip(best.margins, best.jacobian))]
        found.append((count, 0.0, best.objective_slopes / size))
        for plane in self._planes:
            value = plane.value + float(plane.slope @ (best.x - plane.at))
            here = best.objective if plane.group == count else best.margins[plane.group]
            own = found[plane.group][2] * (size if plane.group == count else 1.0)
            tight = 1e-7 * (abs(here) + 1e-3 * (size if plane.group == count else 1.0))
            reach = np.abs((plane.at - best.x) / self.reach).max()
            differs = np.abs(plane.slope - own).max() > 1e-3 * (np.abs(own).max() + 1e-12)
            if value <= here + tight and reach <= radius + _NEAR and differs:
                if plane.group == count:
                    found.append((count, (value - here) / size, plane.slope / size))
                else:
                    found.append((plane.group, value, plane.slope))
        return found

    def _keep(self, point: Local) -> None:
        """Slopes of a point for later steps."""
        for k, (value, slope) in enumerate(zip(point.margins, point.jacobian)):
            if np.isfinite(value):
                self._planes.append(_Plane(k, point.x, float(value), slope))
        if np.abs(point.objective_slopes).any():
            self._planes.append(_Plane(len(point.margins), point.x, point.objective, point.objective_slopes))
        self._planes = self._planes[-_PLANES * (len(point.margins) + 1) :]

    def _first(self, point: Local) -> np.ndarray:
        """Curvature to begin with: of the costs, of roots of sums of squares, and the cost itself for the rest."""
        own = np.maximum(point.bends, 0.0) + 2 * np.maximum(-point.slopes, 0.0)
        return np.diag(np.where(own > 0, own, self._size(point)))

    def _updated(self, old: Local, new: Local, before: np.ndarray, plan: Minimum) -> np.ndarray:
        """Damped update (Powell 1978) by the slopes of cost and priced margins."""
        step, prices = new.x - old.x, plan.prices[: len(old.margins)]
        pull = new.slopes + new.objective_slopes - old.slopes - old.objective_slopes
        pull = pull + prices @ (new.jacobian - old.jacobian)
        towards = before @ step
        along, seen = float(step @ towards), float(step @ pull)
        if not along > 0:
            return before
        part = 1.0 if seen >= 0.2 * along else 0.8 * along / (along - seen)
        pull = part * pull + (1 - part) * towards
        return before - np.outer(towards, towards) / along + np.outer(pull, pull) / float(step @ pull)

    # The order of points.

    @staticmethod
    def _size(point: Local) -> float:
        """Cost by which gains count; where it is next to nothing, a part of what a range of a number may change."""
        slopes = float(np.abs(point.slopes).sum() + np.abs(point.objective_slopes).sum())
        return max(abs(point.cost), abs(point.total), _NOTHING * slopes, 1e-300)

    @staticmethod
    def _broken(point: Local) -> np.ndarray:
        return np.maximum(np.where(np.isfinite(point.margins), point.margins, 1e6), 0.0)

    def _merit(self, point: Local, elastic: np.ndarray) -> float:
        return point.total + float(elastic @ self._broken(point))

    def _model_gain(self, best: Local, plan: Minimum, hessian: np.ndarray, elastic: np.ndarray) -> float:
        """Gain that the model promises for a step."""
        step, size, count = plan.step, self._size(best), len(best.margins)
        after = np.zeros(count)
        raised = -np.inf
        for group, value, slope in self._active:
            reached = value + float(slope @ step)
            if group == count:
                raised = max(raised, reached * size)
            elif np.isfinite(value):
                after[group] = max(after[group], reached)
        model = float(best.slopes @ step + step @ hessian @ step / 2) + raised + float(elastic @ np.maximum(after, 0.0))
        return float(elastic @ self._broken(best)) - model
