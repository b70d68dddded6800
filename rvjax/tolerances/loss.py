"""Losses: what a deviation costs inside the limits too (Taguchi)."""

import math

from rvjax.records import Array, Record, Scalar, concrete, field, record


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

    def _check(self) -> None:
        for name in ("price", "at", "target"):
            value = getattr(self, name)
            if concrete(value) and not math.isfinite(value):
                raise ValueError(f"QuadraticLoss.{name} = {value!r}: must be finite")
