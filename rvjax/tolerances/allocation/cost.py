"""What a tolerance costs, as a function of its half-width; one cost covers all elements of a field."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import Record, concrete, field, record


@record
class _Process(Record):
    """Costs within the range of a process."""

    _: dataclasses.KW_ONLY
    finest: Any = field("-", "smallest half-width the process can hold, unit of the error", sign="positive")
    coarsest: Any = field("-", "largest half-width it offers", sign="positive")
    fixed: Any = field("-", "cost that no tolerance saves", default=0.0)
    scale: Any = field("-", "cost above fixed, at the reference or at half-width 0", default=1.0, sign="positive")

    def _check(self) -> None:
        finest, coarsest = self.finest, self.coarsest
        if concrete(finest, coarsest) and not (finest <= coarsest and math.isfinite(coarsest)):
            owner = type(self).__name__
            raise ValueError(f"{owner}.finest = {finest:.6g}: must not exceed coarsest = {coarsest:.6g}")


@record
class ReciprocalPower(_Process):
    """Cost fixed + scale (reference/t)^power of a half-width t, within the process range."""

    _: dataclasses.KW_ONLY
    reference: Any = field("-", "half-width that scale belongs to; give it for angles", default=10e-6, sign="positive")
    power: Any = field("-", "exponent", default=1.0, sign="positive")

    def __call__(self, half_width: jax.Array) -> jax.Array:
        """Cost of a half-width."""
        return self.fixed + self.scale * (self.reference / half_width) ** self.power


@record
class Exponential(_Process):
    """Cost fixed + scale exp(-t/decay) of a half-width t, within the process range."""

    _: dataclasses.KW_ONLY
    decay: Any = field("-", "half-width over which the cost falls by e, unit of the error", sign="positive")

    def __call__(self, half_width: jax.Array) -> jax.Array:
        """Cost of a half-width."""
        return self.fixed + self.scale * jnp.exp(-half_width / self.decay)


@record
class Table(Record):
    """Measured costs, interpolated linearly in log cost over log half-width; the table is the process range."""

    half_widths: Any = field("-", "ascending, unit of the error", shape=("pairs",), sign="positive")
    costs: Any = field("-", "falling", shape=("pairs",), sign="positive")

    @property
    def finest(self) -> Any:
        """First half-width of the table."""
        return self.half_widths[0]

    @property
    def coarsest(self) -> Any:
        """Last half-width of the table."""
        return self.half_widths[-1]

    def __call__(self, half_width: jax.Array) -> jax.Array:
        """Cost of a half-width."""
        t = jnp.asarray(half_width)
        xs, ys = (jnp.log(jnp.asarray(values, t.dtype)) for values in (self.half_widths, self.costs))
        return jnp.exp(jnp.interp(jnp.log(t), xs, ys))

    def _check(self) -> None:
        if not concrete(self.half_widths, self.costs):
            return
        if np.ndim(self.half_widths) != 1 or np.size(self.half_widths) < 2:
            raise ValueError(f"Table.half_widths = {self.half_widths!r}: needs at least two")
        if not np.all(np.diff(self.half_widths) > 0):
            raise ValueError(f"Table.half_widths = {np.asarray(self.half_widths)}: must ascend")
        if not np.all(np.diff(self.costs) < 0):
            raise ValueError(f"Table.costs = {np.asarray(self.costs)}: must fall as the half-width grows")


Cost = ReciprocalPower | Exponential | Table
