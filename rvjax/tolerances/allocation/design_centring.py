"""Design centring: mid-points of the limits that may move, in addition to half-widths that may change.

A mid-point belongs to the nominal value (a profile modification, a class of clearance). Moving it costs little or
nothing and can save more than any tightening. At given half-widths the price of each constraint is the saving per unit
of margin, so the best mid-points minimise (prices . margins + cost of moving). By the envelope theorem this is the
slope of the least cost itself. Half-widths and mid-points are optimised in turn until a turn gains nothing.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np
from scipy import optimize

from rvjax.population import Tolerance
from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.sample_average import Training
from rvjax.tolerances.allocation.search import NOISE, Search

_TURNS, _HALVINGS, _SWEEPS = 5, 3, 3
_GAIN = 1e-3  # of the cost: less ends the turns
_RADIUS = 1.5  # within which prices are computed, logarithm of a half-width
_FAR = 1e3  # margin, in ways to the limit, used as infinity
_KNOWN = 2e-3  # part of its range to which a mid-point is found in one turn


@dataclasses.dataclass(frozen=True)
class Middle:
    """Limits of the mid-point of an error's limits.

    Attributes:
        lower: least mid-point, unit of the error.
        upper: largest mid-point.
        scale: cost of moving by one unit of the error (SI) from the given mid-point, either way; 0 by default.
    """

    lower: float
    upper: float
    scale: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower <= self.upper):
            raise ValueError(f"Middle.lower = {self.lower!r}, upper = {self.upper!r}: must be finite and ascend")
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"Middle.scale = {self.scale!r}: must be finite and not negative")


def check_middles(middles: Mapping[str, Middle], active: Mapping[str, Tolerance]) -> None:
    """Raise ValueError for mid-points that cannot move.

    Raises:
        ValueError: names the field.
    """
    for name, item in middles.items():
        if name not in active:
            raise ValueError(f"middles: {name!r} has no tolerance; these have: {', '.join(active)}")
        if not isinstance(item, Middle):
            raise ValueError(f"middles: {name} = {item!r} must be a Middle")
        law = active[name].law
        if law.of_vectors or law.name == "empirical":
            raise ValueError(f"middles: {name}: the distribution {law.name} does not move with its limits")


def centred(
    training: Training,
    priced: dict[str, Cost],
    max_steps: int,
    start: np.ndarray,
    middles: Mapping[str, Middle],
    advance: Callable[[int], object],
) -> tuple[Training, float]:
    """Sample with the mid-points at which the cheapest half-widths cost least, and the cost of moving them."""
    names, items = list(middles), list(middles.values())
    given = np.array([float(training.population.active[name].middle) for name in names])
    low, high = (np.array([getattr(item, end) for item in items]) for end in ("lower", "upper"))
    scale = np.array([item.scale for item in items])

    def at(middle: np.ndarray) -> Training:
        return training.with_tolerances(
            {name: _moved(training.population.active[name], float(m)) for name, m in zip(names, middle)}
        )

    def moving(middle: np.ndarray) -> float:
        return float(scale @ np.abs(middle - given))

    def best(t: np.ndarray, here: np.ndarray, prices: np.ndarray | None) -> tuple[np.ndarray, float]:
        """Mid-points of least priced margins, and their gain; without prices the worst margin is minimised."""
        way = training.distance

        def worth(middle: np.ndarray) -> float:
            margins = np.clip(at(middle).uncorrected(t) / way, -_FAR, _FAR)
            if prices is None:
                return float(margins.max())
            return float(prices @ (margins * way)) + moving(middle)

        there = _swept(worth, here, low, high)
        return there, worth(here) - worth(there)

    here = np.clip(given, low, high)
    search = Search(at(here).measured(), priced, max_steps, advance)
    point, possible = search.opened(start)
    if not possible:  # infeasible: first the mid-points with the largest margins
        finest = search.excess(search.training.margins(search.low))
        here, _ = best(search.low if finest <= search.excess(point.margins) else point.half_widths, here, None)
        search = Search(at(here).measured(), priced, max_steps, advance)
        point, possible = search.opened(start)
        if not possible:
            return search.training, moving(here)
    point, _ = search.find(point, start)
    for _ in range(_TURNS):
        total = search.cost(point.half_widths) + moving(here)
        _, prices = search.model_optimum(point, _RADIUS)
        there, gain = best(point.half_widths, here, prices)
        if gain < _GAIN * total:
            break
        for _ in range(_HALVINGS):
            trial = Search(at(there).measured(), priced, max_steps, advance)
            end, _ = trial.find(trial.begin(point.half_widths), point.half_widths)
            if trial.excess(end.margins) <= NOISE and trial.cost(end.half_widths) + moving(there) < total:
                break
            there = (here + there) / 2
        else:
            break
        here, search, point = there, trial, end
    return search.training, moving(here)


def _swept(worth: Callable[[np.ndarray], float], x: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimise `worth` within the ranges, along one mid-point after the other."""
    x = x.copy()
    for _ in range(_SWEEPS if len(x) > 1 else 1):
        for j in range(len(x)):

            def along(value: float, j: int = j, x: np.ndarray = x) -> float:
                return worth(np.where(np.arange(len(x)) == j, value, x))

            known = dict(xatol=_KNOWN * (high[j] - low[j]))
            found = optimize.minimize_scalar(along, bounds=(low[j], high[j]), method="bounded", options=known)
            x[j] = found.x if found.fun < along(x[j]) else x[j]
    return x


def _moved(tolerance: Tolerance, middle: float) -> Tolerance:
    """The same limits about another mid-point."""
    half = tolerance.half_width
    return tolerance.replace(lower=middle - half, upper=middle + half)
