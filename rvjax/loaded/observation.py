"""Bench observations of the loaded reducer: orders of the transmission error, and the hysteresis curve."""

from typing import Any

import jax
import jax.numpy as jnp

from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.equilibrium import equilibrium
from rvjax.loaded.head import effects_of_a_head
from rvjax.loaded.revolution import revolution
from rvjax.outputs import Observation, Spectrum
from rvjax.records import Array, Scalar

NEEDS = ("stiffness", "contact")


def _ways(given: Any) -> dict[str, str]:
    return dict(contact=given.pin_contact, carrier=given.carrier, sun=given.sun)


def _spectrum(
    design: RVReducer, errors: RVErrors, given: Any, torques: Array, orders: tuple[int, ...], alike: bool
) -> Spectrum:
    """One turn of the cranks where all are alike, else a turn of the output."""
    step = design.cycloid.pin_count if alike else 1
    samples = given.samples if alike else max(given.samples, 4 * max(orders))
    stiff = errors.stiffened(design)

    def turn(torque: Scalar) -> Array:
        ways = dict(_ways(given), turns=1 / step, samples=samples)
        return revolution(stiff, errors, output_torque=torque, **ways).error

    error = jax.vmap(turn)(torques)
    waves = 2 / samples * jnp.fft.rfft(error)
    found = [waves[:, k // step] if k % step == 0 else 0 * waves[:, 0] for k in orders]
    return jnp.mean(error, axis=1), jnp.stack(found, axis=1)


def _angle(design: RVReducer, errors: RVErrors, given: Any, torques: Array) -> Array:
    """Output angle at each torque, input held."""
    stiff = errors.stiffened(design)
    at = dict(_ways(given), input_angle=given.input_angle)
    return jax.vmap(lambda torque: equilibrium(stiff, errors, output_torque=torque, **at).error)(torques)


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
