"""Bench observations of the four-bar model: orders of the transmission error along a turn of the output."""

from typing import Protocol

import jax
import jax.numpy as jnp

from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.four_bar.revolution import harmonics
from rvjax.outputs import Observation, Spectrum
from rvjax.records import Array, PyTree, Scalar


class Ways(Protocol):
    """Conditions that select how a turn of the cranks is computed."""

    @property
    def angles(self) -> int: ...
    @property
    def cranks(self) -> str: ...
    @property
    def gear_stiffness_ratio(self) -> float | None: ...
    @property
    def closure(self) -> str | None: ...


def _spectrum(
    design: RVReducer, errors: RVErrors, given: Ways, torques: Array | None, orders: tuple[int, ...], alike: bool
) -> Spectrum:
    """Crank revolutions are equal, so only multiples of the pin count are not zero."""
    pins = design.cycloid.pin_count

    def turn(torque: Scalar) -> Array:
        ways: dict[str, PyTree] = dict(
            cranks=given.cranks, gear_stiffness_ratio=given.gear_stiffness_ratio, closure=given.closure
        )
        return harmonics(design, errors, output_torque=torque, angles=given.angles, **ways)

    waves = turn(0.0)[None] if torques is None else jax.vmap(turn)(torques)
    # The cranks turn against the output: X e^(i h crank) is conj(X) e^(i h pins output). A failed turn stays NaN.
    found = [jnp.conj(waves[:, k // pins]) if k % pins == 0 else 0 * waves[:, 0] for k in orders]
    return jnp.real(waves[:, 0]), jnp.stack(found, axis=1)


CURVE = Observation("curve", _spectrum, samples="angles", period=lambda design: int(design.cycloid.pin_count))
