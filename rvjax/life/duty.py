"""Duty of a reducer: phases of torque, speed and time, and the revolutions of its crank bearings."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import Record, concrete, field, quantity, record


@record
class Duty(Record):
    """A cycle of phases, repeated until a bearing fails. A phase at rest or of zero time counts for static safety."""

    output_torque: Any = field("N m", "of the discs on the output, as in `loaded`", shape=("phases",))
    output_speed: Any = field(
        "rad/s", "of the output against the part at rest, either sign; 0 is rest", shape=("phases",)
    )
    time: Any = field("s", "of each phase", shape=("phases",), sign="nonnegative")

    def _check(self) -> None:
        for name, unit in (("output_torque", "N m"), ("output_speed", "rad/s"), ("time", "s")):
            value = getattr(self, name)
            if concrete(value) and np.shape(value) == (0,):
                raise ValueError(f"Duty.{name} = [] {unit}: must have at least one phase")
        if concrete(self.time) and np.all(np.sum(np.asarray(self.time)) == 0):
            raise ValueError(f"Duty.time = {quantity(self.time, 's')}: must have a positive sum")


def check_phases(duty: Duty) -> int:
    """Number of phases; a scalar is one phase, or the same in all.

    Args:
        duty: as given; its columns may be traced.

    Raises:
        ValueError: columns of different length.
    """
    shapes = {name: np.shape(getattr(duty, name)) for name in ("output_torque", "output_speed", "time")}
    lengths = {shape for shape in shapes.values() if shape}
    if any(len(shape) != 1 for shape in lengths) or len(lengths) > 1 or (0,) in lengths:
        told = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"Duty: shapes {told}: must be (phases,), as many in each; sweep with jax.vmap")
    return lengths.pop()[0] if lengths else 1


class Revolutions(NamedTuple):
    """Revolutions of every crank bearing against its outer ring, in one cycle."""

    share: jax.Array  # of each phase, (phases,), sum 1; 0 where nothing turns
    per_time: jax.Array  # U / tc, () 1/s


def revolutions(pins: int, speed: jax.Array, time: jax.Array) -> Revolutions:
    """Revolutions of a cycle. Eq. 21.

    Args:
        pins: of the ring, zp: so many crank turns against disc and carrier in one of the output.
        speed: (phases,) rad/s.
        time: (phases,) s, of positive sum.
    """
    turned = pins / (2 * jnp.pi) * jnp.abs(speed) * time
    total = jnp.sum(turned)
    return Revolutions(turned / jnp.where(total > 0, total, 1), total / jnp.sum(time))
