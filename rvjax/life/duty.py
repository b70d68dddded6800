"""Motion of the crank bearings: phases of a duty and their revolutions, sense of the cranks, angles of a turn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax.cycloidal import CycloidalReducer, Reducer
from rvjax.designs import RVReducer
from rvjax.loaded import Layout
from rvjax.records import Design, PyTree, Record, concrete, field, quantity, record


class BearingKind(NamedTuple):
    """Of the cranks and their bearings. A crank makes pin_count turns against its disc in one of the output."""

    supports: bool  # whether the bearings besides those of the discs are rated
    sense: Callable[[PyTree], int]  # of the crank against disc and carrier for a positive turn of the output
    torque: Callable[
        [PyTree, jax.Array, jax.Array], jax.Array
    ]  # of the output by a disc, about, by (e, force of an arm)


def _of_cranks(design: RVReducer, eccentricity: jax.Array, force: jax.Array) -> jax.Array:
    return force * design.cranks.circle_radius * design.counts["cranks"]


def _of_shaft(design: CycloidalReducer, eccentricity: jax.Array, force: jax.Array) -> jax.Array:
    return force * eccentricity * abs(design.ratio)


def _sense_of_shaft(design: CycloidalReducer) -> int:
    return 1 if design.ratio > 0 else -1


KINDS: dict[type, BearingKind] = {
    RVReducer: BearingKind(True, lambda design: -1, _of_cranks),
    CycloidalReducer: BearingKind(False, _sense_of_shaft, _of_shaft),
}


def kind_of(design: Design) -> BearingKind:
    """Entry of `KINDS` for a design.

    Args:
        design: one of `KINDS`.
    """
    return next(kind for cls, kind in KINDS.items() if isinstance(design, cls))


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


def revolutions(pins: int, speed: jax.Array, time: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Revolutions of every crank bearing against its outer ring in one cycle. Eq. 21.

    The share of each phase, (phases,), of sum 1, 0 where nothing turns; and all of them over the time, U / tc, () 1/s.

    Args:
        pins: of the ring, zp: so many crank turns against disc and carrier in one of the output.
        speed: (phases,) rad/s.
        time: (phases,) s, of positive sum.
    """
    turned = pins / (2 * jnp.pi) * jnp.abs(speed) * time
    total = jnp.sum(turned)
    return turned / jnp.where(total > 0, total, 1), total / jnp.sum(time)


_GOLDEN = (np.sqrt(5) - 1) / 2
_NEAR = 24  # samples of a crank turn from which on neighbours have similar displacements


@dataclass(frozen=True)
class TurnPlan:
    """Static settings of a program of angles over turns of the output.

    Attributes:
        layout: of the reducer.
        samples: number of angles.
        crank_turns: in which they lie.
    """

    layout: Layout
    samples: int
    crank_turns: int

    @classmethod
    def of(cls, layout: Layout, samples: int, turns: float, *more: object) -> Self:
        """The plan of some turns of the output.

        Args:
            layout: of the reducer.
            samples: angles.
            turns: of the output.
            *more: further settings of a class.

        Raises:
            ValueError: samples < 1, or a part of a crank turn.
        """
        if isinstance(samples, bool) or not isinstance(samples, (int, np.integer)) or samples < 1:
            raise ValueError(f"samples = {samples!r}: must be an integer of at least 1")
        pins = layout.pins
        crank_turns = round(float(turns) * pins) if np.isfinite(turns) else 0
        if crank_turns < 1 or abs(float(turns) * pins - crank_turns) > 1e-6:
            raise ValueError(
                f"turns = {turns:g}: must be a whole number of crank turns, k / {pins} of the output with k >= 1"
            )
        return cls(layout, int(samples), crank_turns, *more)

    @property
    def near(self) -> bool:
        """True if the equilibrium at the sample before is a better start than the linear step."""
        return self.samples >= _NEAR

    def input_angles(self, design: Reducer, dtype: DTypeLike) -> jax.Array:
        """Input angles over the turn of the output, (n,) rad: every crank angle once, each in a separate crank turn.

        Equally spaced angles alias with the errors, whose loads have the orders of pins and teeth. Eq. 11.

        Args:
            design: its gear ratio is read.
            dtype: of the result.
        """
        order = np.arange(self.samples)
        lap = np.floor(self.crank_turns * ((order * _GOLDEN) % 1))
        return jnp.asarray(design.ratio * 2 * np.pi * (lap + order / self.samples) / self.layout.pins, dtype)
