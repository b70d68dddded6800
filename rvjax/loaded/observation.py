"""Bench observations of the loaded reducer: orders of the transmission error, and the hysteresis curve.

All angles of a turn are solved next to each other: with slopes of fifty elements that is cheaper than from one angle to
the next.
"""

import jax
import jax.numpy as jnp

from rvjax.compile_cache import QUICK
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.conditions import Conditions, ways
from rvjax.loaded.equilibrium import equilibrium
from rvjax.loaded.head import effects_of_a_head
from rvjax.outputs import Observation, Spectrum
from rvjax.records import Array, Scalar

NEEDS = ("stiffness", "contact")


def _spectrum(
    design: RVReducer, errors: RVErrors, given: Conditions, torques: Array, orders: tuple[int, ...], alike: bool
) -> Spectrum:
    """One turn of the cranks where all are alike, else a turn of the output."""
    step = design.cycloid.pin_count if alike else 1
    samples = given.samples if alike else max(given.samples, 4 * max(orders))
    stiff, torques = errors.stiffened(design), jnp.asarray(torques)
    angles = 2 * jnp.pi * design.ratio / step / samples * jnp.arange(samples, dtype=torques.dtype)

    def error_at(torque: Scalar, angle: Scalar) -> Array:
        return equilibrium(stiff, errors, input_angle=angle, output_torque=torque, **ways(given)).error

    error = jax.vmap(lambda torque: jax.vmap(lambda angle: error_at(torque, angle))(angles))(torques)
    waves = 2 / samples * jnp.fft.rfft(error)
    found = [waves[:, k // step] if k % step == 0 else 0 * waves[:, 0] for k in orders]
    return jnp.mean(error, axis=1), jnp.stack(found, axis=1)


def _angle(design: RVReducer, errors: RVErrors, given: Conditions, torques: Array) -> Array:
    """Output angle at each torque, input held."""
    stiff = errors.stiffened(design)

    def angle(torque: Scalar) -> Array:
        found = equilibrium(stiff, errors, input_angle=given.input_angle, output_torque=torque, **ways(given))
        return found.error

    return jax.vmap(angle)(torques)


CURVE = Observation(
    "curve",
    _spectrum,
    NEEDS,
    samples="samples",
    period=lambda design: int(design.cycloid.pin_count),
    sided=True,
    head=effects_of_a_head,
    compiler_options=QUICK,
)
LOOP = Observation("loop", _angle, NEEDS, compiler_options=QUICK)
