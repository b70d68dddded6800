"""Search on a low-fidelity response, mapped to the high-fidelity response: most steps then cost little.

Margins of the low-fidelity sample are moved and tilted so that value and slope agree with the response at one point.
The cheapest half-widths of this model are evaluated with the response itself, and the model is mapped again there.
Because of the agreement to first order the trust region converges to an optimum of the response (Alexandrov, Lewis,
Gumbert, Green and Newman 2001) for any low-fidelity response; its quality changes only the number of mappings.
"""

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from rvjax.tolerances.allocation.cost import Cost
from rvjax.tolerances.allocation.sample_average import Point, Training
from rvjax.tolerances.allocation.search import GAIN, NOISE, RADIUS, SETTLED, STATIONARY, Search

_CORRELATED = 0.5  # least correlation of the units' values: below, `cheap` explains a quarter of the spread
_REFUSED = 3  # steps in a row that the response did not confirm
_INNER = 40  # sets of half-widths evaluated on one model, at most
_POOR, _GOOD = 0.25, 0.75  # parts of a predicted gain, below which the region shrinks and above which it grows


class Mapped:
    """Low-fidelity sample as a model of the response around one of its points."""

    def __init__(self, cheap: Training, exact: Training, at: Point) -> None:
        self.cheap, self.at = cheap, at
        self.fields, self.requirements, self.samples = exact.fields, exact.requirements, exact.samples
        self.distance, self.powers, self.most_failed = exact.distance, exact.powers, exact.most_failed
        self._there = cheap.point(at.half_widths)
        self.holds = bool(np.isfinite(self._there.margins).all())

    def point(self, half_widths: np.ndarray) -> Point:
        """Margins and slopes of the model."""
        there = self.cheap.point(half_widths)
        tilt = self.at.slopes - self._there.slopes
        away = tilt @ np.log(half_widths / self.at.half_widths)
        margins = self.at.margins + (there.margins - self._there.margins) + away
        return Point(half_widths, margins, there.slopes + tilt, self.at.weights)


class MappedSearch(Search):
    """Search with a low-fidelity response; continues without it where it gives no progress."""

    def __init__(
        self,
        training: Training,
        priced: dict[str, Cost],
        max_steps: int,
        advance: Callable[[int], Any],
        cheap: Training,
    ) -> None:
        super().__init__(training, priced, max_steps, advance)
        self.cheap, self._priced = cheap, priced
        self.refused: str | None = None
        """Reason for which the low-fidelity response was discarded, or None."""

    def find(self, point: Point, start: np.ndarray) -> tuple[Point, bool]:
        """Cheapest half-widths from a point on, and True if they are an optimum of the sample."""
        if self.refused is None:
            self.refused = self._unlike(point)
        if self.refused is None:
            point, settled = self._followed(point)
            if settled:
                return point, True
            self.refused = self.refused or "it led to no optimum of the response"
        return super().find(point, start)

    def _unlike(self, point: Point) -> str | None:
        """Reason against the low-fidelity response before any step: poor correlation of the units."""
        exact, cheap = (of.values(point.half_widths) for of in (self.training, self.cheap))
        for name, one, other in zip(self.training.requirements, exact, cheap):
            both = np.isfinite(one) & np.isfinite(other)
            spread = both.sum() > 2 and one[both].std() > 0 and other[both].std() > 0
            seen = float(np.corrcoef(one[both], other[both])[0, 1]) if spread else 0.0
            if seen < _CORRELATED:
                named = f"of {name!r} " if name else ""
                return f"its values {named}correlate by {seen:.2f} with those of the response, less than {_CORRELATED}"
        return None

    def _followed(self, best: Point) -> tuple[Point, bool]:
        """End of the steps along mapped models from a point, and True if it is an optimum of the response."""
        distance, radius, refusals = self.training.distance, RADIUS, 0
        while len(self.history) < self.max_steps and refusals < _REFUSED:
            model = Mapped(self.cheap, self.training, best)
            if not (model.holds and np.isfinite(best.margins).all()):
                self.refused = "its units fail"
                return best, False
            wanted = self._cheapest_of(model, best, radius)
            step = float(np.abs(np.log(wanted.half_widths / best.half_widths)).max())
            excess = self.excess(best.margins)
            met = excess <= SETTLED
            if radius < SETTLED or (met and step < SETTLED):
                return best, excess <= NOISE and self.residual(best) <= STATIONARY
            _, prices = self.model_optimum(best, radius)
            penalty = np.maximum(self.cost(best.half_widths) / distance, 2 * prices)
            here, promised = self._merit(best, penalty), self._merit(wanted, penalty)
            new = self.look(wanted.half_widths)
            gain, promise = here - self._merit(new, penalty), here - promised
            if not gain > 0:
                radius, refusals = step / 3, refusals + 1
                continue
            if gain < _POOR * promise:
                radius = max(step / 3, SETTLED)
            elif gain > _GOOD * promise:
                radius = max(radius, 2 * step)
            best, refusals = new, 0
            if met and gain < GAIN * self.cost(best.half_widths) and self.excess(best.margins) <= SETTLED:
                return best, self.residual(best) <= STATIONARY
        if refusals >= _REFUSED:
            self.refused = f"{_REFUSED} steps in a row that it proposed did the response no good"
        return best, False

    def _cheapest_of(self, model: Mapped, best: Point, radius: float) -> Point:
        """The cheapest point of a model within a factor exp(radius)."""
        inner = copy.copy(self)
        inner.training, inner.history, inner.rays = model, [], None  # type: ignore[assignment]
        inner.advance, inner.max_steps = lambda count: None, _INNER
        inner.low, inner.high = (
            np.clip(best.half_widths * math.exp(r), self.low, self.high) for r in (-radius, radius)
        )
        return inner.run(best)[0]
