"""Effects of one encoder head on the orders of a measured curve: the nuisance "reading" of identification."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import quick
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.conditions import Conditions, ways
from rvjax.loaded.encoder import Reading, reading
from rvjax.loaded.equilibrium import equilibrium

HEAD_PARTS = {"ring": 2, "tilt": 1, "dent": 3}
"""Effects in the order of the elements of "reading", and their periods in a revolution of the head."""
READ_AT = 1000.0
"""Torque at which the amplitudes are given where the conditions have none, N m."""


def effects_of_a_head(
    design: RVReducer, conditions: Conditions, torques: np.ndarray, orders: Sequence[int]
) -> np.ndarray:
    """Contribution of a head to the orders at each torque, per element of "reading", (torques, k, 6, 2).

    Of the reducer without errors of parts, whose forces those of a unit resemble to 1 %. An element is the largest
    amplitude of its effect, of any order, at the rated torque.

    Args:
        design: the reducer.
        conditions: of the study.
        torques: of the discs on the carrier, N m (torques,).
        orders: of the output turn (k,).
    """
    rated = abs(conditions.rated_torque or conditions.output_torque or READ_AT)
    turn, k = 2 * np.pi * design.ratio, design.cycloid.pin_count * design.cranks.count
    angle = turn * np.arange(samples := k * -(-4 * max(*orders, k) // k)) / samples
    methods = ways(conditions).values()
    loads = map(float, (rated, *torques))  # of one type: one program
    curves = np.stack([jax.device_get(_effects(design, jnp.asarray(angle), load, *methods)) for load in loads])
    waves = 2 / samples * np.fft.rfft(curves)[..., 1:]  # (torques, 6, orders)
    largest = np.abs(waves[0]).reshape(3, -1).max(axis=1)
    waves = waves[1:] / np.repeat(np.where(largest > 0, largest, 1.0), 2)[:, None]
    found = np.moveaxis(waves[..., np.array(orders) - 1], -1, 1)
    return np.stack([found.real, found.imag], axis=-1)


@quick(3, 4, 5)
def _effects(design: RVReducer, angle: jax.Array, torque: float, contact: str, carrier: str, sun: str) -> jax.Array:
    """Readings less the error for unit gains: cosine and sine of the head for ring, tilt and dent, (6, angles)."""
    discs = design.cycloid.disc_count
    position = np.linspace(-1.0, 1.0, discs) if discs > 1 else np.zeros(1)
    gains = zip(np.eye(3).tolist(), HEAD_PARTS.values())
    heads = [
        Reading(1.0, (np.pi * part / 2 / m,), ring, tilt, 1.0, position, dent)
        for (ring, tilt, dent), m in gains
        for part in (0, 1)
    ]

    def at(x: jax.Array) -> jax.Array:
        found = equilibrium(
            design, RVErrors(), input_angle=x, output_torque=torque, contact=contact, carrier=carrier, sun=sun
        )
        seen = [reading(found, design, head, input_angle=x, output_torque=torque) for head in heads]
        return jnp.stack([value - found.error for value in seen])

    return jax.vmap(at, out_axes=1)(angle)
