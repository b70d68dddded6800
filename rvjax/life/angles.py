"""Angles of a turn at which forces are read."""

from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax.loaded import Layout
from rvjax.records import PyTree

_GOLDEN = (np.sqrt(5) - 1) / 2


class Sampled(Protocol):
    """Angles of a turn."""

    @property
    def layout(self) -> Layout:
        """Its pins are read."""

    @property
    def samples(self) -> int:
        """Number of angles."""

    @property
    def crank_turns(self) -> int:
        """In which they lie."""


class Turning(Sampled, Protocol):
    """Angles of a turn whose sense counts."""

    @property
    def sense(self) -> int:
        """Of the cranks against disc and carrier, 1 or -1 for a positive turn of the output."""


def check_angles(samples: int, turns: float, pins: int) -> int:
    """Crank turns in some turns of the output.

    Args:
        samples: angles.
        turns: of the output.
        pins: of the ring.

    Raises:
        ValueError: samples < 1, or a part of a crank turn.
    """
    if isinstance(samples, bool) or not isinstance(samples, (int, np.integer)) or samples < 1:
        raise ValueError(f"samples = {samples!r}: must be an integer of at least 1")
    crank_turns = round(float(turns) * pins) if np.isfinite(turns) else 0
    if crank_turns < 1 or abs(float(turns) * pins - crank_turns) > 1e-6:
        raise ValueError(
            f"turns = {turns:g}: must be a whole number of crank turns, k / {pins} of the output with k >= 1"
        )
    return crank_turns


def input_angles(plan: Sampled, design: PyTree, dtype: DTypeLike) -> jax.Array:
    """Input angles over the turn of the output, (n,) rad: every crank angle once, each in a crank turn of its own.

    Equally spaced angles alias with the errors, whose loads have the orders of pins and teeth. Eq. 11.

    Args:
        plan: samples and crank turns.
        design: its gear ratio is read.
        dtype: of the result.
    """
    order = np.arange(plan.samples)
    lap = np.floor(plan.crank_turns * ((order * _GOLDEN) % 1))
    return jnp.asarray(design.ratio * 2 * np.pi * (lap + order / plan.samples) / plan.layout.pins, dtype)


def inner_angles(plan: Turning, dtype: DTypeLike) -> jax.Array:
    """Angle of each crank against disc and carrier at the samples, without whole turns, (n,) rad.

    Args:
        plan: samples and sense of the cranks.
        dtype: of the result.
    """
    return jnp.asarray(plan.sense * 2 * np.pi * np.arange(plan.samples) / plan.samples, dtype)
