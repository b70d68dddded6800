"""Losses: what a deviation costs inside the limits too (Taguchi)."""

import dataclasses
import math
from collections.abc import Mapping

from rvjax.population import Estimate, deviate_of
from rvjax.records import Array, Record, Scalar, concrete, field, record
from rvjax.tolerances.batch.statistics import Statistics


@record
class QuadraticLoss(Record):
    """Loss price ((y - target)/at)^2 of a unit with the response y.

    Its mean over units is price (Var[y] + (E[y] - target)^2)/at^2, so it is smooth in the half-widths.
    """

    price: Scalar = field("-", "loss of a unit with the deviation `at`, in units of the costs", sign="nonnegative")
    at: Scalar = field("-", "deviation from the target that costs the price, unit of the response", sign="positive")
    target: Scalar = field("-", "response without loss, unit of the response", default=0.0)

    def __call__(self, values: Scalar) -> Array:
        """Loss of each value.

        Args:
            values: of the response, any shape.
        """
        return self.price * ((values - self.target) / self.at) ** 2  # type: ignore[return-value]

    def slope(self, values: Scalar) -> Array:
        """Derivative of the loss to each value.

        Args:
            values: of the response, any shape.
        """
        return 2 * self.price * (values - self.target) / self.at**2  # type: ignore[return-value]

    def expected(self, mean: Estimate, sd: Estimate, deviate: float) -> Estimate:
        """Mean loss of units by the statistics of their response: price (sd^2 + (mean - target)^2)/at^2.

        The errors of both add up: no correlation makes the true one larger.

        Args:
            mean: of the response.
            sd: of the response.
            deviate: standard normal one of the confidence.
        """
        off, scale = mean.value - float(self.target), float(self.price) / float(self.at) ** 2
        error = 2 * scale * (sd.value * sd.error + abs(off) * mean.error) + scale * (sd.error**2 + mean.error**2)
        found = Estimate.about(scale * (sd.value**2 + off**2), error, deviate)
        return dataclasses.replace(found, lower=max(found.lower, 0.0))

    def _check(self) -> None:
        for name in ("price", "at", "target"):
            value = getattr(self, name)
            if concrete(value) and not math.isfinite(value):
                raise ValueError(f"QuadraticLoss.{name} = {value!r}: must be finite")


def expected_losses(losses: Mapping[str, QuadraticLoss], statistics: Statistics) -> dict[str, Estimate]:
    """Mean loss of each response by the statistics of units that do not fail; inf where a response was infinite.

    Args:
        losses: by name of the response.
        statistics: of the units.
    """
    deviate, mean, sd = deviate_of(statistics.confidence), statistics.mean, statistics.sd
    endless = Estimate(math.inf, math.nan, math.inf, math.inf)
    return {
        name: endless if statistics.infinite[name] else item.expected(mean[name], sd[name], deviate)
        for name, item in losses.items()
    }
