"""Bench observations of the loaded reducer: orders of the transmission error, and the hysteresis curve."""

import jax
import jax.numpy as jnp

from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.conditions import Conditions, ways
from rvjax.loaded.equilibrium import equilibrium
from rvjax.loaded.head import effects_of_a_head
from rvjax.loaded.revolution import revolution
from rvjax.outputs import Observation, Spectrum
from rvjax.records import Array, Scalar

NEEDS = ("stiffness", "contact")


def _spectrum(
    design: RVReducer, errors: RVErrors, given: Conditions, torques: Array, orders: tuple[int, ...], alike: bool
) -> Spectrum:
    """One turn of the cranks where all are alike, else a turn of the output."""
    step = design.cycloid.pin_count if alike else 1
    samples = given.samples if alike else max(given.samples, 4 * max(orders))
    stiff = errors.stiffened(design)

    def turn(torque: Scalar) -> Array:

        of_turn = revolution(stiff, errors, output_torque=torque, turns=1 / step, samples=samples, **ways(given))
        return of_turn.error

    error = jax.vmap(turn)(torques)
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
)
LOOP = Observation("loop", _angle, NEEDS)
