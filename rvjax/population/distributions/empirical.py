"""Measured parts: an error that follows the values someone has measured."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr

from rvjax.base.columns import read_table
from rvjax.population.distribution import Distribution, Moments, bad
from rvjax.records import IN_ERROR_UNIT, Array, Scalar, concrete, field, is_concrete, record
from rvjax.units import KNOWN, recognised, unknown_unit

if TYPE_CHECKING:
    from rvjax.population.tolerance import Tolerance


def step_of(values: np.ndarray, digit: float) -> float:
    """Step of an instrument: one unit of the last digit, or the least difference of readings that mostly repeat.

    Args:
        values: readings.
        digit: one unit of the last digit that is written, unit of the readings.
    """
    distinct = np.unique(values)
    repeat = 2 <= len(distinct) <= len(values) / 2
    return max(digit, float(np.diff(distinct).min())) if repeat else digit


def in_steps(values: np.ndarray, step: float) -> np.ndarray:
    """Readings of an instrument too coarse for their spread: equal ones evenly over the step that they were rounded to.

    Readings whose sd is a step or more stay: rounding adds less than 4 % to it. n equal ones would have no spread at
    all, and no half-width any effect.

    Args:
        values: readings (n,).
        step: of the instrument.
    """
    counts = np.unique(values, return_counts=True)[1]
    if len(counts) == len(values) or values.std(ddof=1) >= step:
        return values
    places = np.concatenate([(np.arange(n) + 0.5) / n - 0.5 for n in counts])
    return np.sort(values) + step * places


@record
class Empirical(Distribution):
    """Measured values: the k-th of n is the quantile (k - 1/2)/n, linear between them (Hazen 1914).

    The values need not keep within the limits. Another half-width scales them about the mid-point of the limits.
    In a study file, `values` is a list of texts with units, or {file = "...", column = "...", unit = "..."}; no unit is
    needed where the header of the column gives it.
    """

    name = "empirical"
    capable = False
    values: Array | np.ndarray = field(IN_ERROR_UNIT, "the measured values", shape=("parts",))

    def deviate(self, tolerance: "Tolerance", z: jax.Array) -> Scalar:
        """Order statistics at n Phi(z) + 1/2."""
        values = jnp.asarray(self.values, jnp.result_type(z))
        n = len(values)
        position = jnp.clip(n * ndtr(z) - 0.5, 0.0, n - 1.0)
        left = jnp.clip(position.astype(int), 0, max(n - 2, 0))
        low, high = values[left], values[jnp.minimum(left + 1, n - 1)]
        return low + (position - left.astype(position.dtype)) * (high - low)

    def moments(self, tolerance: "Tolerance") -> Moments:
        """Exact moments of the distribution as sampled: the mean is that of the data.

        A piece from a to b holds 1/n of the parts with the central moments sum_i a^i b^(k-i)/(k+1), the ends 1/(2n).
        """
        values = np.asarray(self.values, float)
        mean = float(values.mean())
        x = values - mean
        a, b, n = x[:-1], x[1:], len(x)
        found = [mean]
        for k in (2, 3, 4):
            pieces = sum(a**i * b ** (k - i) for i in range(k + 1)) / (k + 1)
            found.append(float(np.sum(pieces) + (x[0] ** k + x[-1] ** k) / 2) / n)
        return found[0], found[1], found[2], found[3]

    def scaled(self, tolerance: "Tolerance", half_width: Scalar) -> dict[str, Scalar]:
        """Limits and values about the mid-point of the limits."""
        old = tolerance.half_width
        if is_concrete(old) and old == 0:
            raise bad("half_width", 0.0, "measured values with limits of no width cannot be scaled")
        values = tolerance.middle + (self.values - tolerance.middle) * (half_width / old)
        return super().scaled(tolerance, half_width) | dict(values=values)

    def _check(self) -> None:
        if not concrete(self.values):
            return
        values = np.asarray(self.values)
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise bad("values", self.values, "must be one row of finite numbers")
        object.__setattr__(self, "values", np.sort(values))

    @classmethod
    def parsed(cls, key: str, value: object, unit: str) -> object:
        """Values from a list, or from a column of a CSV file, whose header may contain the unit."""
        if not isinstance(value, dict):
            if not isinstance(value, list):
                raise ValueError(f"{key} = {value!r}: must be a list, or a table of file, column and unit")
            return super().parsed(key, value, unit)
        if not {"file", "column"} <= set(value) <= {"file", "column", "unit", "encoding"} or not all(
            isinstance(item, str) for item in value.values()
        ):
            raise ValueError(f"{key}: give file, column and unit as texts, not {', '.join(value)}")
        units = {"-": 1.0} if unit == "-" else KNOWN[unit]
        if "unit" in value and recognised(value["unit"], units) is None:
            raise unknown_unit(f"{key}.unit = {value['unit']!r}", value["unit"], units, ": is not one of")
        column = {name: value[name] for name in ("column", "unit") if name in value}
        try:
            read = read_table(value["file"], {key: column}, units={key: units}, encoding=value.get("encoding"))
        except OSError as error:
            raise ValueError(f"{key}.file = {value['file']!r}: cannot be read ({error})") from None
        values = read.numbers[key][~np.isnan(read.numbers[key])]  # an empty cell is a part that was not measured
        return in_steps(values, step_of(values, read.digits[key])) if len(values) else values
