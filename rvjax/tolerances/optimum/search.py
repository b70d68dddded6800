"""Search for the cheapest half-widths: steps of a separable model in a trust region, and an audit of its end.

Residual of half-widths in the conditions of an optimum (Karush 1939, Kuhn and Tucker 1951).
"""

import copy
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy

from rvjax.tolerances.optimum.conlin import cheapest, total_cost
from rvjax.tolerances.optimum.cost import Cost
from rvjax.tolerances.optimum.jackknife import half_interval
from rvjax.tolerances.optimum.rays import Rays
from rvjax.tolerances.optimum.sample_average import Point, Training

_STEP = 1e-4  # of the differences of a cost, logarithm of a half-width
_AT = 4e-3  # a field nearer to the end of its range, as a part of it, is there: twice what a search settles to
_TINY = 1e-300
_MAY_BIND = 0.05  # nearer to its limit than this part of the way a constraint may bind


def residual(costs: tuple[Cost, ...], point: Point, distance: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Largest saving of a single field that no price of the constraints accounts for, as a part of all savings.

    Savings are derivatives of the cost to the logarithms of the half-widths; the prices (not negative) are those
    that leave the least of them, found by a linear program. A cost with a kink has two derivatives, and any between
    them will do. A field at the end of its range may keep a saving beyond it.

    Args:
        costs: of the fields.
        point: margins and slopes at the half-widths.
        distance: (c,) of the nominal response from each limit.
        low: (j,) finest half-widths.
        high: (j,) coarsest half-widths.
    """
    t = point.half_widths
    loosened, tightened = (
        np.array([_saving(cost, float(x), sign) for cost, x in zip(costs, t)]) for sign in (1.0, -1.0)
    )
    total = float(np.maximum(loosened, tightened).sum())
    if total <= 0:
        return 0.0
    binding = np.isfinite(point.margins) & (point.margins > -_MAY_BIND * distance)
    pull = (point.slopes[binding] / distance[binding, None]).T  # (j, c)
    above, below = t > low * (1 + _AT), t < high * (1 - _AT)
    rows = np.concatenate([-pull[below], pull[above]])  # savings of loosening left over, then those of tightening
    most = np.concatenate([-loosened[below], tightened[above]]) / total
    if not len(rows):
        return 0.0
    rows = np.column_stack([rows / np.maximum(np.abs(rows).max(axis=0, initial=0.0), _TINY), -np.ones(len(rows))])
    found = scipy.optimize.linprog(np.eye(rows.shape[1])[-1], rows, most)  # prices and residual, none negative
    return float(found.fun) if found.success else math.nan


def _saving(cost: Cost, half_width: float, sign: float) -> float:
    here, there = (float(cost(jnp.asarray(x))) for x in (half_width, half_width * math.exp(sign * _STEP)))
    return sign * (here - there) / _STEP


RADIUS = 1.5  # first step, at most, in logarithms of the half-widths
SETTLED = 2e-3  # steps and violations (as parts of the way to the limit) smaller than this end the search
NOISE = 0.02  # violation within the error of the sample; the certificate corrects it
BEYOND = 0.05  # beyond a limit by this part of the way there no certificate is tried
GAIN = 1e-4  # a step that saves less than this part of the cost ends the search
_COARSE = 5.0  # on SETTLED and GAIN where units are costly: their sample gives the optimum no better

_BINDING = 0.1  # a constraint with a larger margin, in parts of the way to its limit, has no effect

_PROBE = 0.1  # of the audit, logarithm of a half-width
_ASTRAY = 0.4  # part of a probe by which a margin may deviate from its slopes: few units cross
_MANY, _FEWEST = 40, 8  # units beyond a limit that these bounds are for, and the least that a quantile leaves
STATIONARY = 0.1  # residual of an optimum by derivatives: costs less than half its square
_STATIONARY_APART = 0.2  # the same where slopes are differences of a sample
_TELLING = 0.005  # change of the least cost that is not an error of the search
_MOVES = (0.05, 0.2)  # of a limit, parts of the way to it; the second where the first changes nothing
_INWARD = 0.99  # of a set that is not quite within the constraints
_RENEWALS = 3  # searches of costly units after a failed audit
_LOOSER = (0.3, 0.1, 0.03, 0.01)  # a single field, logarithms of the half-width


class Search:
    """Search that evaluates and stores sets of half-widths, and moves to the cheapest that meets all constraints."""

    def __init__(
        self,
        training: Training,
        priced: dict[str, Cost],
        max_steps: int,
        advance: Callable[[int], Any] = lambda count: None,  # of a progress bar
    ) -> None:
        self.training, self.costs, self.max_steps = training, tuple(priced.values()), max_steps
        self.advance = advance
        self.low = np.array([float(cost.finest) for cost in self.costs])
        self.high = np.array([float(cost.coarsest) for cost in self.costs])
        self.history: list[dict[str, Any]] = []
        self.rays: Rays | None = None  # once derivatives have misled
        self.audited = False  # they have not
        coarse = 1.0 if training.followed is None else _COARSE
        self.settled, self.gain = coarse * SETTLED, coarse * GAIN
        self.near = 0.0 if training.followed is None else RADIUS  # a step that promises little is left out
        beyond = min(training.samples * (1 - getattr(r, "target", 0.0)) for r in training.requirements.values())
        self.doubt = math.sqrt(max(1.0, _MANY / max(beyond, _FEWEST)))  # few units beyond a limit give poor slopes

    def cost(self, half_widths: np.ndarray) -> float:
        """Total cost."""
        return float(total_cost(self.costs, half_widths))

    def look(self, half_widths: np.ndarray) -> Point:
        """Evaluate the sample and note it."""
        point = (self.rays or self.training).point(half_widths)
        self.advance(1)
        names = [name or "response" for name in self.training.requirements]
        names += ["failed"] if self.training.most_failed is not None else []
        margins = dict(zip([*names, "joint"], map(float, point.margins)))  # the joint one is last, if there is one
        named = dict(zip(self.training.fields, map(float, half_widths)))
        self.history.append(dict(cost=self.cost(half_widths), margins=margins, half_widths=named))
        return point

    def begin(self, start: np.ndarray) -> Point:
        """The given half-widths, or the finest where so many units fail that no quantile is left."""
        point = self.look(np.clip(start, self.low, self.high))
        return point if np.isfinite(point.margins).all() else self.look(self.low)

    def opened(self, start: np.ndarray) -> tuple[Point, bool]:
        """Start of a search, and True if half-widths meet every requirement on the sample."""
        point = self.begin(start)
        if self.training.recentred(point.half_widths):
            point = self.begin(point.half_widths)
        few = self.training.margins_of_few(self.low)
        finest = self.excess(self.training.margins(self.low) if few is None else few)
        if finest <= 0 or not np.isfinite(point.margins).all():
            return point, finest <= 0
        point, _ = self.run(point)  # finer need not be better: errors may take up errors
        reached = self.excess(point.margins)
        return point, reached <= NOISE and reached < finest / 2

    def promising(self, half_widths: np.ndarray, beyond: float = BEYOND) -> bool:
        """True if a certificate may hold: the sample exceeds no limit by more than `beyond` of the way there."""
        return self.excess(self.training.margins(half_widths)) <= beyond

    def excess(self, margins: np.ndarray) -> float:
        """The worst margin, in parts of the way to its limit."""
        return float((margins / self.training.distance).max())

    def find(self, point: Point, start: np.ndarray) -> tuple[Point, bool]:
        """Cheapest half-widths from a point on, and True if they are an optimum of the sample.

        By derivatives first. Where an audit finds that these mislead, by differences along rays from what was
        found, from the start and from the finest half-widths; for costly units by solving all of them there.
        """
        if self.rays is None:
            point, settled = self.run(point)
            self.audited = self.audited or (settled and self.stands(point))
            if len(self.history) >= self.max_steps or (settled and self.audited):
                return point, settled
            if self.training.followed is not None:
                return self._renewed(point)
            self.rays = Rays(self.training)
            corners = [self.inside(self.rays.scaled(t)) for t in (point.half_widths, start, self.low)]
            corners = sorted((t for t in corners if self.rays.met(t)), key=self.cost)
            starts = [*corners[:1], self.low]
        else:
            starts = [self.inside(self.rays.scaled(point.half_widths))]
        ends = [self.loosened(self.run(self.look(t))[0].half_widths) for t in starts]
        best = self.look(min([t for t in ends if self.rays.met(t)] or ends, key=self.cost))
        return best, len(self.history) < self.max_steps and self.residual(best) <= _STATIONARY_APART * self.doubt

    def _renewed(self, point: Point) -> tuple[Point, bool]:
        """A search of costly units from a point on whose audit failed, and True if it ends at an optimum.

        Differences along rays would solve all units some hundred times a step. Instead all are solved where the
        search ended: predicted values have misled, or its steps were too coarse.
        """
        self.settled, self.gain = SETTLED, GAIN
        for _ in range(_RENEWALS):
            self.training.renew(point.half_widths)
            point, settled = self.run(self.look(point.half_widths))
            self.audited = settled and self.stands(point)
            if self.audited or len(self.history) >= self.max_steps:
                break
        return point, settled and self.audited

    def run(self, best: Point, dearest: float = math.inf) -> tuple[Point, bool]:
        """Cheapest point from a given one, and True if the steps settled there.

        Ends early where the model promises no cost up to `dearest`.
        """
        distance, radius = self.training.distance, RADIUS
        while len(self.history) < self.max_steps:
            wanted, prices = self.model_optimum(best, radius)
            if radius >= RADIUS and self.cost(wanted) > dearest:
                return best, False
            step = float(np.abs(np.log(wanted / best.half_widths)).max())
            excess = self.excess(best.margins)
            met = excess <= self.settled
            penalty = np.maximum(self.cost(best.half_widths) / distance, 2 * prices)
            promised = self._merit(best, penalty) - self.cost(wanted)
            little = step < min(radius, self.near) and promised < self.gain * self.cost(best.half_widths)
            if radius < self.settled or (met and (step < self.settled or little)):
                return best, excess <= NOISE
            new = self.look(wanted)
            gain = self._merit(best, penalty) - self._merit(new, penalty)
            if gain <= 0:
                radius = step / 3
                continue
            best, radius = new, max(radius, 2 * step)
            if met and gain < self.gain * self.cost(best.half_widths) and self.excess(best.margins) <= self.settled:
                return best, True
        return best, False

    def shrinks(self, point: Point) -> bool:
        """True if every constraint that may bind gains where all half-widths shrink together."""
        binding = point.margins > -_BINDING * self.training.distance
        return bool((point.slopes[binding].sum(axis=1) >= 0).all())

    def stands(self, point: Point) -> bool:
        """Audit of an end: prices account for all savings, and the sample moves as its slopes predict.

        Every field is loosened alone. Units that fail, or a response in steps, show by margins that jump or stay.
        """
        if self.residual(point) > STATIONARY:
            return False
        way = (point.margins + self.training.distance) / self.training.distance
        for j, slopes in enumerate((point.slopes / self.training.distance[:, None]).T):
            probe = point.half_widths.copy()
            probe[j] *= math.exp(_PROBE)
            if probe[j] > self.high[j]:
                continue
            seen = self.training.margins(probe) / self.training.distance + 1
            powers = self.training.powers
            grown = way**powers + way ** (powers - 1) * slopes * np.expm1(powers * _PROBE)
            told = np.maximum(grown, 0.0) ** (1 / powers)
            astray = (np.abs(seen - told) > _ASTRAY * self.doubt * _PROBE) & (np.maximum(seen, told) > 1 - NOISE)
            if astray.any():
                return False
        return True

    def residual(self, point: Point) -> float:
        """Residual of a point in the conditions of an optimum, as a part of the savings of looser half-widths."""
        return residual(self.costs, point, self.training.distance, self.low, self.high)

    def loosened(self, half_widths: np.ndarray) -> np.ndarray:
        """Move half-widths within the constraints, then loosen one field at a time while they hold."""
        rays = self.rays or Rays(self.training)
        t = half_widths if rays.met(half_widths) else self.inside(rays.scaled(half_widths))
        while not rays.met(t):  # the ray may leave and enter again
            if np.array_equal(t, self.low):
                return t
            t = np.maximum(_INWARD * t, self.low)
        for step in _LOOSER:
            again = True
            while again:
                again = False
                for j in range(len(t)):
                    wider = t.copy()
                    wider[j] = min(t[j] * math.exp(step), self.high[j])
                    if self.cost(wider) < self.cost(t) and rays.met(wider):
                        t, again = wider, True
        return t

    def inside(self, half_widths: np.ndarray) -> np.ndarray:
        """Clipped to the process ranges."""
        return np.clip(half_widths, self.low, self.high)

    def model_optimum(self, point: Point, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Cheapest half-widths within a factor exp(radius) under the model around a point, and its multipliers."""
        low, high = (np.clip(point.half_widths * math.exp(r), self.low, self.high) for r in (-radius, radius))
        return cheapest(self.costs, point, self.training.distance, self.training.powers, low, high)

    def prices(self, point: Point) -> np.ndarray:
        """Reduction of the cost per outward move of the limit of each requirement."""
        if self.rays is None:
            return self.model_optimum(point, RADIUS)[1] @ point.weights
        return np.array([self.price(self.rays, point, k) for k in range(len(self.training.requirements))])

    def intervals(self, point: Point, confidence: float) -> dict[str, tuple[float, float]]:
        """Intervals of the prices of followed units, by their sampling error."""
        if self.rays is not None or self.training.followed is None:
            return {}
        several = [self.prices(there) for there in self.training.parts(point)]
        by = half_interval(several, confidence)
        both = zip(self.training.requirements, self.prices(point), by)
        return {name: (float(price - wide), float(price + wide)) for name, price, wide in both}

    def tightened(self, point: Point, half_widths: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """The cheapest half-widths, none looser, where each constraint keeps what `factors` (c,) on all of them do.

        The slopes of `point` select the fields. Without slopes (units that fail) all shrink together.
        """
        low = np.minimum(self.low, half_widths)
        found = self._scaled(point, half_widths, factors, low, half_widths)
        together = np.maximum(half_widths * factors.min(), low)
        return together if np.array_equal(found, half_widths) else found

    def loosened_to(self, point: Point, half_widths: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """The cheapest half-widths, none finer, where each constraint keeps what `factors` (c,) on all of them do."""
        return self._scaled(point, half_widths, factors, half_widths, np.maximum(self.high, half_widths))

    def _scaled(
        self, point: Point, half_widths: np.ndarray, factors: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        """The optimum of the model of `point` moved to half-widths at which each constraint is 1/factor of its way."""
        distance, powers = self.training.distance, self.training.powers[:, None]
        before, reach = np.maximum(point.margins + distance, 1e-3 * distance), distance / factors
        grown = (half_widths / point.half_widths) ** powers * (before / reach)[:, None] ** (powers - 1)
        there = Point(half_widths, reach - distance, point.slopes * grown, point.weights)
        return cheapest(self.costs, there, distance, self.training.powers, low, high)[0]

    def price(self, rays: Rays, point: Point, k: int) -> float:
        """Price of one requirement, by differences of the least cost: a limit is moved and the search continues."""
        name, scale = list(self.training.requirements)[k], float(self.training.scales[k])
        for move in _MOVES:
            ends = []
            for outward in (-move * scale, move * scale):
                there = copy.copy(self)
                there.rays, there.history, there.advance = rays.moved(name, outward), [], lambda count: None
                start = there.inside(there.rays.scaled(point.half_widths))
                ends.append(there.cost(there.loosened(there.run(there.look(start))[0].half_widths)))
            saved = ends[0] - ends[1]
            if saved > _TELLING * ends[1]:
                return saved / (2 * move * scale)
        return 0.0

    def _merit(self, point: Point, penalty: np.ndarray) -> float:
        """Cost plus an exact penalty on violated constraints."""
        return self.cost(point.half_widths) + float(penalty @ np.maximum(point.margins, 0.0))
