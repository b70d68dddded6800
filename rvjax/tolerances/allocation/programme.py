"""Search in a trust region: the cheapest vector of decisions that meets all constraints of a sample.

Around a vector powers of the used ways are linear in powers of the half-widths, and quadratic in mid-points and
numbers: derivatives that were seen at another vector give the curvature. Costs are exact. Outputs without errors take
one unit: they are looked at again at the end of each step of the model until it is right there. An interior point
method solves the model within a box; an excess over a limit has a price. A step is taken where it gains enough of what
was promised.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import scipy

from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.decisions import AT, ROUNDING, STEP
from rvjax.tolerances.allocation.look import Look
from rvjax.tolerances.allocation.model import Model, Planes, minimum

LOOKS = 12
"""Vectors of a search that need not be exact, at most."""

COARSE = 5e-3
"""Promised gain, as a part of the cost, below which a search ends whose sample grows afterwards."""

STATIONARY = 0.1
"""Residual of an optimum: it costs less than half of its square."""

MET = 0.01
"""Excess over a limit, in parts of its way, within the error of a sample."""

RADIUS, AGAIN = 1.0, 0.3
"""First box of a search, in logarithms of half-widths, and of one that begins at the end of another."""

_TAKEN, _GOOD = 0.05, 0.7  # parts of a promised gain: a step is taken, the box grows
_SHORTER = 3.0  # times smaller is the box than a step that was not taken
_FLAT = 0.05  # used way, below which its square has no slope of its own
_LOST = 3.0  # excess of a limit whose units fail, in parts of its way
_PRICE, _DEARER_BY, _DEARER = 2.0, 10.0, 1e4  # of an excess of a whole way, in costs; its growth, and the most
_ROUNDS = 8  # of the model, each with these outputs seen at the end of the one before
_NOTHING = 1e-3  # of the sum of slopes, a cost that is next to nothing


@dataclasses.dataclass(frozen=True)
class End:
    """End of a search.

    Attributes:
        look: at it.
        prices: (c,) cost for each way that a limit moves outwards.
        at_low: (n,) rate at which the cost grows with each lower bound, not negative.
        at_high: (n,) rate at which it falls with each upper bound, not negative.
        residual: largest saving of an entry that no price accounts for, as a part of all savings.
        of_widths: the same of half-widths alone.
        certain: the same of all entries, less two standard errors of their slopes.
        settled: False where the number of looks ended the search.
    """

    look: Look
    prices: np.ndarray
    at_low: np.ndarray
    at_high: np.ndarray
    residual: float
    of_widths: float
    certain: float
    settled: bool


class Programme:
    """Searches on the constraints of a problem; what they learn of curvatures is kept between them."""

    def __init__(self, constraints: Constraints, look: Callable[[np.ndarray], Look]) -> None:
        self.constraints, self.decisions, self._look = constraints, constraints.decisions, look
        self.low, self.high = self.decisions.low.copy(), self.decisions.high.copy()
        self._first = len(self.decisions.fields)
        self.bends = np.zeros((len(constraints.rows) + 1, self.decisions.size, self.decisions.size))
        """Learned curvatures (c + 1, n, n) of powers of the used ways, and of the loss, in reaches."""
        self.weights: np.ndarray | None = None
        """Prices (c,) of excesses where these are all that counts, else None."""

    def run(self, start: np.ndarray, radius: float = RADIUS, *, most: int, gain: float | None = None) -> End:
        """The cheapest vector from a start on.

        Args:
            start: (n,) vector.
            radius: of the first box.
            most: looks, at most.
            gain: promised gain that ends the search, as a part of the cost; None: what the units allow.
        """
        effort = self.constraints.problem.effort
        gain, least = effort.gain if gain is None else gain, effort.box
        here, looks = self._look(np.clip(start, self.low, self.high)), 1
        size = self._size(here)
        elastic = np.full(len(here.used), _PRICE * size) if self.weights is None else self.weights
        settled = False
        while looks < most:
            size = self._size(here)
            x, merit, _ = self._plan(here, radius, elastic)
            promised = self._merit(here, elastic) - merit
            if not math.isfinite(promised) and radius >= least:  # an output without errors fails there
                radius /= _SHORTER
                continue
            if promised <= gain * size or radius < least:
                broken = _excess(here) > MET
                if radius >= least and self.weights is None and broken.any() and elastic.max() < _DEARER * size:
                    elastic = np.where(broken, _DEARER_BY * elastic, elastic)
                    continue
                settled = True
                break
            there, looks = self._look(x), looks + 1
            gained = self._merit(here, elastic) - self._merit(there, elastic)
            step = float(np.abs((x - here.x) / self.decisions.reach).max())
            refused = gained < _TAKEN * promised or not math.isfinite(gained)
            self._learn(here, there, refused=refused)
            if refused:
                radius = min(radius, step) / _SHORTER
                continue
            if gained > _GOOD * promised:
                radius = min(2 * RADIUS, max(radius, 2 * step))
            elif gained < (1 - _GOOD) * promised:
                radius = min(radius, step)
            here = there
        return self.end(here, settled)

    def end(self, here: Look, settled: bool = True) -> End:
        """A look as the end of a search, with the prices of its limits and bounds.

        Args:
            here: the look.
            settled: see `End`.
        """
        low, high = here.x <= self.low + AT, here.x >= self.high - AT
        binding = np.isfinite(here.used) & (here.used > 1 - MET)
        pull = here.pull if self.weights is None else np.zeros(len(here.x))
        n = len(here.x)
        rows = np.concatenate([here.jacobian[binding], -np.eye(n)[low], np.eye(n)[high]])
        scale = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
        found, _ = (
            scipy.optimize.nnls((rows / scale[:, None]).T, -pull) if len(rows) and n else (np.zeros(len(rows)), 0.0)
        )
        prices, at_low, at_high = np.zeros(len(here.used)), np.zeros(n), np.zeros(n)
        found = found / scale
        left = pull + found @ rows
        prices[binding], found = found[: binding.sum()], found[binding.sum() :]
        at_low[low], at_high[high] = found[: low.sum()], found[low.sum() :]
        savings = float(np.abs(here.slopes).sum() + np.abs(here.priced_slopes + here.loss_slopes).sum())
        savings = max(savings, MET * abs(here.total), 1e-300)
        sure = np.maximum(np.abs(left) - 2 * np.sqrt(prices**2 @ here.errors**2), 0.0)
        whole, widths, certain = (np.abs(own).max(initial=0.0) / savings for own in (left, left[: self._first], sure))
        return End(here, prices, at_low, at_high, float(whole), float(widths), float(certain), settled)

    def prices(self, here: Look, radius: float) -> np.ndarray:
        """Prices (c,) of used ways in the model around a look.

        Args:
            here: the look.
            radius: of the box.
        """
        elastic = np.full(len(here.used), _DEARER * self._size(here))
        _, _, prices = self._plan(here, radius, elastic)
        return np.where(prices < 0.1 * elastic, prices, 0.0) * here.powers

    # The model.

    def _plan(self, here: Look, radius: float, elastic: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """Cheapest end of a step within a box under the model, the merit promised there, prices of excesses."""
        planes = Planes(self.constraints, here)
        for _ in range(_ROUNDS):
            x, prices = self._solved(here, radius, elastic, planes)
            if planes.seen(x) <= ROUNDING:
                break
        used = np.where(planes.nominal, planes.values[-1][:-1], self._powers(here, x)[0])
        excess = np.maximum(np.where(np.isfinite(here.used), used - 1, _LOST), 0.0)
        total = self._total(here, x)[0] + float(planes.values[-1][-1])
        return x, (total if self.weights is None else 0.0) + float(elastic @ excess), prices

    def _solved(self, here: Look, radius: float, elastic: np.ndarray, planes: Planes) -> tuple[np.ndarray, np.ndarray]:
        """Minimum of the model, and the prices (c,) of its rows."""
        n, c, size = len(here.x), len(here.used), self._size(here)
        units = np.flatnonzero(~planes.nominal & np.isfinite(here.used))
        reach = radius * self.decisions.reach
        low, high = np.maximum(self.low, here.x - reach), np.minimum(self.high, here.x + reach)
        counted, first = float(self.weights is None), self._first
        curved_rows = self.bends[:-1][units] / np.outer(self.decisions.reach, self.decisions.reach)
        whole = np.concatenate([here.x, _excess(here), [here.priced / size]])
        whole[:n] = np.clip(here.x, low, high)
        ends = np.concatenate([low, np.zeros(c), [-np.inf]]), np.concatenate([high, np.full(c + 1, np.inf)])
        free = np.flatnonzero(ends[1] - ends[0] > AT)

        def model(v: np.ndarray, given: np.ndarray) -> Model:
            whole[free] = v
            lam = given[: len(units)] if len(given) else np.zeros(len(units))
            used, towards, bends = self._powers(here, whole[:n])
            _, slopes, curved = self._total(here, whole[:n])
            flat, rates = planes.rows(whole, size)
            own = np.zeros((len(units), n + c + 1))
            own[:, :n] = -towards[units]
            own[range(len(units)), n + units] = 1.0
            hessian = np.zeros((n + c + 1, n + c + 1))
            hessian[:n, :n] = counted * curved / size
            own_bends = np.diag(hessian)[:first] + lam @ bends[units]
            hessian[range(first), range(first)] = np.maximum(own_bends, 0.0)
            hessian[:n, :n] += np.einsum("k,kij->ij", lam, curved_rows)
            objective = np.concatenate([counted * slopes, elastic, [counted * size]]) / size
            values = np.concatenate([1 + whole[n + units] - used[units], flat])
            return Model(objective[free], hessian[np.ix_(free, free)], values, np.concatenate([own, rates])[:, free])

        whole[free], multipliers = minimum(model, whole[free], ends[0][free], ends[1][free])
        x = np.clip(whole[:n], low, high) if np.isfinite(whole).all() else here.x
        x = np.where(x < self.low + AT, self.low, np.where(x > self.high - AT, self.high, x))
        prices, multipliers = np.zeros(c), multipliers * size
        prices[units] = multipliers[: len(units)]
        for k, price in zip(planes.owner, multipliers[len(units) :]):
            if k < c:
                prices[k] += price
        return x, prices

    def _powers(self, here: Look, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Powers (c,) of the used ways under the model, their derivatives (c, n), and second ones to half-widths."""
        first, p = self._first, here.powers[:, None]
        start, rate = expansion(here)
        moved = x - here.x
        grown = np.exp(p * moved[:first])
        value = start + (rate[:, :first] / p * (grown - 1)).sum(axis=1) + rate[:, first:] @ moved[first:]
        slopes, bent = rate[:, :first] * grown, self._bent(moved)[:-1]
        value += bent @ moved / 2
        return value, np.concatenate([slopes, rate[:, first:]], axis=1) + bent, p * slopes

    def _total(self, here: Look, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Cost with losses under the model, without priced outputs, its derivatives (n,) and curvature (n, n)."""
        first, moved = self._first, x - here.x
        cost, slopes, bends = self.decisions.cost(x)
        grown = here.loss_slopes[:first] * np.exp(2 * moved[:first])
        bent = self._bent(moved)[-1]
        loss = here.loss + float((grown - here.loss_slopes[:first]).sum()) / 2
        loss += float(here.loss_slopes[first:] @ moved[first:] + bent @ moved / 2)
        curved = np.diag(np.where(np.arange(len(bends)) < first, bends, np.maximum(bends, 0.0)))
        curved[range(first), range(first)] += 2 * grown
        curved += self.bends[-1] / np.outer(self.decisions.reach, self.decisions.reach)
        return cost + loss, slopes + np.concatenate([grown, here.loss_slopes[first:]]) + bent, curved

    def _bent(self, moved: np.ndarray) -> np.ndarray:
        """Derivatives (c + 1, n) of the learned part of the model at a step."""
        return np.asarray(self.bends @ (moved / self.decisions.reach) / self.decisions.reach)

    def _learn(self, here: Look, there: Look, *, refused: bool) -> None:
        """Bend the model so that it has the derivatives seen at another look.

        The change is the least one that is symmetric (Powell 1970), along mid-points and numbers if there are any, by
        their part of the step: the model is less wrong along half-widths. Derivatives of few units count less two
        standard errors. Along mid-points and numbers the model also has at least the values of a step not taken: next
        to a corner derivatives of few units are not accurate.
        """
        whole = (there.x - here.x) / self.decisions.reach
        bending = np.arange(len(whole)) >= (self._first if self._first < len(whole) else 0)
        step = np.where(bending, whole, 0.0)
        square = float(step @ step)
        if math.sqrt(square) < STEP:
            return
        told = np.vstack([self._powers(here, there.x)[1], self._total(here, there.x)[1] - there.slopes])
        seen = np.vstack([expansion(there)[1], there.loss_slopes])
        noise = 2 * np.hypot(here.errors, there.errors) * np.maximum(_rate(here), _rate(there))
        known = np.append(np.isfinite(here.used) & np.isfinite(there.used), math.isfinite(there.loss))
        error = np.where(known[:, None], seen - told, 0.0)
        error[:-1] = np.sign(error[:-1]) * np.maximum(np.abs(error[:-1]) - noise, 0.0)
        error *= self.decisions.reach * bending * square / float(whole @ whole)
        cross = error[:, :, None] * step / square
        bent = self.bends + cross + cross.transpose(0, 2, 1)
        bent -= (error @ step)[:, None, None] * np.outer(step, step) / square**2
        if refused and self._first < len(whole):
            self.bends = bent
            short = np.where(known[:-1], np.maximum(_power(there) - self._powers(here, there.x)[0], 0.0), 0.0)
            bent[:-1] += 2 * short[:, None, None] * np.outer(step, step) / (square * float(whole @ whole))
        values, vectors = np.linalg.eigh(bent)  # a model without negative curvatures has one minimum
        self.bends = np.einsum("kij,kj,klj->kil", vectors, np.maximum(values, 0.0), vectors)

    # The order of vectors.

    def _size(self, look: Look) -> float:
        """Cost by which gains count; where it is next to nothing, a part of what a range of a number may change."""
        if self.weights is not None:
            return float(self.weights.sum())
        slopes = float(np.abs(look.slopes).sum() + np.abs(look.priced_slopes).sum())
        return max(abs(look.cost), abs(look.total), _NOTHING * slopes, 1e-300)

    def _merit(self, look: Look, elastic: np.ndarray) -> float:
        return (look.total if self.weights is None else 0.0) + float(elastic @ _excess(look))


def expansion(look: Look) -> tuple[np.ndarray, np.ndarray]:
    """Powers (c,) of the used ways of a look, and their derivatives (c, n); of squares that are flat not less than so.

    Args:
        look: where units do not fail.
    """
    return _power(look), _rate(look) * look.jacobian


def _rate(look: Look) -> np.ndarray:
    """Derivatives (c, 1) of powers of the used ways to these."""
    used = np.maximum(np.where(np.isfinite(look.used), look.used, 1.0), _FLAT)
    return np.where(look.powers == 1, 1.0, look.powers * used)[:, None]


def _power(look: Look) -> np.ndarray:
    """Powers (c,) of the used ways, 1 where units fail."""
    used = np.where(np.isfinite(look.used), look.used, 1.0)
    return np.where(look.powers == 1, used, np.sign(used) * np.abs(used) ** look.powers)


def _excess(look: Look) -> np.ndarray:
    """Excesses (c,) of powers of the used ways over 1."""
    over = np.maximum(_power(look) - 1, 0.0)
    return np.where(np.isfinite(look.used), over, np.where(np.isneginf(look.used), 0.0, _LOST))
