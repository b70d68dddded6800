"""Causes of a bearing failure: share of the failures, shares of the phases of a duty, orders of the force."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import power
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.life.duty import Duty
from rvjax.life.histories import WEIBULL
from rvjax.life.rating import Rating
from rvjax.loaded import admit, bearing_forces, check_input
from rvjax.records import Scalar
from rvjax.status import SolveInfo, succeeded, worst_of

_STEP = 1e-3  # of a speed


class Failures(NamedTuple):
    """Probability that a bearing fails first, given that one fails; the sum over both fields is 1."""

    arm: jax.Array  # (d, c)
    support: jax.Array | None  # (c, 2)


def first_failures(rated: Rating) -> Failures:
    """Share of each bearing in the failures of a series system of one Weibull slope: (life / its life)^(9/8), Eq. 24.

    Args:
        rated: of one unit.
    """

    def share(own: jax.Array) -> jax.Array:
        finite = jnp.isfinite(own) & jnp.isfinite(rated.life)
        return jnp.where(finite, power(jnp.where(finite, rated.life / jnp.where(finite, own, 1), 1), WEIBULL), 0)

    return Failures(share(rated.arm), None if rated.support is None else share(rated.support))


def phase_shares(life_of: Callable[[Duty], np.ndarray], duty: Duty) -> np.ndarray:
    """Share of each phase in the damage, (phases, ...): -d ln life / d ln speed, which sums to 1.

    A cycle with all speeds times s has life over s, so the derivatives by the speeds of the phases sum to -1 for every
    method. Central differences of the plain value.

    Args:
        life_of: life of units under a duty, (...) s.
        duty: of p phases, columns (p,).
    """
    speed = np.asarray(duty.output_speed, float)
    found = []
    for phase, own in enumerate(speed):
        sides = []
        for factor in (1 + _STEP, 1 - _STEP):
            changed = speed.copy()
            changed[phase] = factor * own
            sides.append(np.log(life_of(duty.replace(output_speed=changed))))
        found.append((sides[1] - sides[0]) / np.log((1 + _STEP) / (1 - _STEP)) if own else 0 * sides[0])
    return np.asarray(found)


class Orders(NamedTuple):
    """Harmonics of the forces of the arm bearings over one revolution of the output."""

    order: np.ndarray  # (n,), > 0: turns as the output does, `crank_order`: with the crank
    amplitude: jax.Array  # (d, c, n) complex N: F_x + i F_y = sum of amplitude e^(i order angle), frame of the carrier
    info: SolveInfo


def force_orders(
    design: RVReducer,
    errors: RVErrors,
    *,
    output_torque: Scalar,
    samples: int,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Orders:
    """Orders of the output revolution in the force of a crank on a disc, in the frame of the carrier.

    Order 0 is fixed in the outer ring and passes over the inner ring. Order -zp turns with the crank: it is fixed in
    the inner ring. It is zp where the ring of a single-stage drive is the output. Errors make the others.

    Args:
        design: the reducer.
        errors: of its parts.
        output_torque: () N m.
        samples: angles of the revolution, more than twice the largest order.
        contact: as in `loaded.equilibrium`.
        carrier: as in `loaded.equilibrium`.
        sun: as in `loaded.equilibrium`.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    read = admit(layout, design, errors, jnp.atleast_1d(jnp.asarray(output_torque)), 0.0)
    angles = jnp.asarray(2 * np.pi * design.ratio * np.arange(samples) / samples, read.torque.dtype)
    forces = bearing_forces(layout, read, read.torque, angles)
    size = jax.lax.complex(forces.arm[:, 0, ..., 0], forces.arm[:, 0, ..., 1])
    _, info = read.gate.close((), info=worst_of(forces.info))
    wave = jnp.fft.fft(size, axis=0) / samples
    order = np.rint(np.fft.fftfreq(samples, 1 / samples)).astype(int)
    return Orders(order, jnp.where(succeeded(info.status), jnp.moveaxis(wave, 0, -1), jnp.nan), info)
