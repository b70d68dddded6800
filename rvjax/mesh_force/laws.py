"""Contact laws of one roller: cam force and approach of its three contacts.

Dimensionless: load u in units of pi l r / (4 C), approach in roller radii. The cage and the gear carry
|rs| and rn times the cam load, and by virtual work their approaches enter with the same weights
(Wei et al. 2021, Eqs. 13-15). Linear stiffness: approach = weight u / 2.

"hertz" is the depth of the flats (Eqs. 11, 12), "linear" its small-load limit, "palmgren" the empirical
formula of roller bearings, 3.84e-5 F^0.9 / l^0.8 (mm, N, steel).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.elementary import power
from rvjax.mesh_force import line_contact

CONTACTS = ("hertz", "linear", "palmgren")

_INVERSE_STEPS = 40  # at most; 3 or 4 at ordinary loads, 10 at the limit


class Compliance(NamedTuple):
    """Inputs of the contact laws for one roller or all; values common to all may be scalars."""

    cage: jax.Array  # |Fs / Fj|
    gear: jax.Array  # Fn / Fj
    cam_radius: jax.Array  # relative radius of the cam contact over r, Rj / (Rj + r)
    gear_radius: jax.Array  # relative radius of the gear contact over r, 1 + r kc
    palmgren: jax.Array  # factor of the contact law "palmgren"

    @property
    def weight(self) -> jax.Array:
        """1 + rs^2 + rn^2."""
        return 1 + self.cage**2 + self.gear**2


def approach(law: str, load: jax.Array, roller: Compliance) -> jax.Array:
    """Approach of the cam against the gear along the cam normal (Eq. 13).

    Args:
        law: one of `CONTACTS`.
        load: u >= 0.
        roller: its compliance.
    """
    if law == "linear":
        return roller.weight * load / 2
    if law == "palmgren":
        return roller.palmgren * _palmgren_weight(roller) * power(load, 0.9)
    return (
        line_contact.approach(load, roller.cam_radius)
        + roller.cage * line_contact.sagitta(roller.cage * load)
        + roller.gear * line_contact.approach(roller.gear * load, roller.gear_radius)
    )


def approach_near(load: jax.Array, roller: Compliance, hollow: jax.Array) -> jax.Array:
    """`approach` of "hertz" in multiplications alone, right while load times `square` is up to `NEAR`.

    A square root costs a processor as much as thirty multiplications.

    Args:
        load: u >= 0.
        roller: its compliance.
        hollow: `line_contact.hollow` of `gear_radius`.
    """
    cam = line_contact.approach_near(load, roller.cam_radius)
    cage = line_contact.approach_near(roller.cage * load, jnp.ones_like(load))
    gear = line_contact.approach_near(roller.gear * load, roller.gear_radius, hollow)
    return cam + roller.cage * cage + roller.gear * gear


def square(roller: Compliance, hollow: jax.Array) -> jax.Array:
    """Largest square of a half-width over a radius for a load of 1; it grows with the load.

    Args:
        roller: its compliance.
        hollow: `line_contact.hollow` of `gear_radius`.
    """
    cam = jnp.maximum(roller.cam_radius, line_contact.hollow(roller.cam_radius))
    return jnp.maximum(jnp.maximum(cam, roller.cage), roller.gear * jnp.maximum(roller.gear_radius, hollow))


def slope(law: str, load: jax.Array, roller: Compliance) -> jax.Array:
    """Derivative of `approach` to the load; for "palmgren" infinite at zero load, here 1.

    Args:
        law: one of `CONTACTS`.
        load: u >= 0.
        roller: its compliance.
    """
    if law == "linear":
        return roller.weight / 2
    if law == "palmgren":
        loaded = load > 0
        some = jnp.where(loaded, load, 1)
        return jnp.where(loaded, 0.9 * roller.palmgren * _palmgren_weight(roller) * power(some, -0.1), 1)
    return (
        line_contact.approach_slope(load, roller.cam_radius)
        + roller.cage**2 * line_contact.sagitta_slope(roller.cage * load)
        + roller.gear**2 * line_contact.approach_slope(roller.gear * load, roller.gear_radius)
    )


def load_limit(law: str, roller: Compliance) -> jax.Array:
    """Load at which a half-width reaches a radius; infinite but for "hertz".

    Args:
        law: one of `CONTACTS`.
        roller: its compliance.
    """
    if law != "hertz":
        return jnp.full_like(roller.gear, jnp.inf)
    gear = line_contact.load_limit(roller.gear_radius) / roller.gear
    cage = 1 / jnp.maximum(roller.cage, 0.1)  # no limit of a cam contact is above 2.7
    return jnp.minimum(jnp.minimum(line_contact.load_limit(roller.cam_radius), gear), cage)


def inverse(law: str, depth: jax.Array, roller: Compliance) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Load, stiffness du/d(depth) and whether the load limit is passed, for a given approach.

    Beyond the limit of "hertz" the load continues with the linear stiffness, so that sums over rollers stay
    monotone; where the equilibrium needs that, it has no solution.

    Args:
        law: one of `CONTACTS`.
        depth: approach; nothing is loaded where it is <= 0.
        roller: its compliance.
    """
    loaded = depth > 0
    depth = jnp.where(loaded, depth, 0)
    stiffness = 2 / roller.weight
    if law == "linear":
        return stiffness * depth, jnp.where(loaded, stiffness, 0), jnp.zeros_like(loaded)
    if law == "palmgren":
        some = jnp.where(loaded, depth, 1)
        load = power(some / (roller.palmgren * _palmgren_weight(roller)), 10 / 9)
        return jnp.where(loaded, load, 0), jnp.where(loaded, load / (0.9 * some), 0), jnp.zeros_like(loaded)
    limit = load_limit(law, roller) * (1 - float(jnp.finfo(depth.dtype).eps) ** 0.5)
    last = approach(law, limit, roller)
    beyond = depth > last
    load = _hertz_load(jnp.minimum(depth, last), roller, limit)
    rate = jnp.where(beyond, stiffness, 1 / slope(law, load, roller))
    return load + jnp.where(beyond, stiffness * (depth - last), 0), jnp.where(loaded, rate, 0), beyond


def secant_stiffness(law: str, load: jax.Array, roller: Compliance) -> jax.Array:
    """Load over approach at a load; but for "palmgren" that of small loads.

    Args:
        law: one of `CONTACTS`.
        load: u > 0.
        roller: its compliance.
    """
    if law == "palmgren":
        return power(load, 0.1) / (roller.palmgren * _palmgren_weight(roller))
    return 2 / roller.weight


def bends(stiffness: jax.Array, roller: Compliance, hollow: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Coefficients b2, b3 of the load u = y (1 + b2 y + b3 y^2 + ..) of "hertz", y = stiffness * approach.

    Args:
        stiffness: of small loads.
        roller: its compliance.
        hollow: `line_contact.hollow` of `gear_radius`.
    """
    gear = line_contact.approach_series(roller.gear_radius, hollow)
    cam, flat = line_contact.approach_series(roller.cam_radius), line_contact.approach_series(1.0)
    a2, a3 = (
        stiffness * (cam[k] + roller.cage ** (k + 3) * flat[k] + roller.gear ** (k + 3) * gear[k]) for k in (0, 1)
    )
    return -a2, 2 * a2**2 - a3  # reversion of y = u + a2 u^2 + a3 u^3


def series(y: jax.Array, b2: jax.Array, b3: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Load of "hertz" for an approach, and its stiffness over that of small loads, by power series.

    At half-widths of 0.03 r the series is good to 1e-9; from 0.4 r on it only stays in bounds.

    Args:
        y: approach >= 0 times the stiffness of small loads.
        b2: of `bends`.
        b3: of `bends`.
    """
    first, second = y * b2, y * y * b3  # 2 b2 and 3 b3 would be stored: XLA takes them out of a loop
    return y * jnp.clip(1 + first + second, 0.2, 1), jnp.clip(1 + 2 * first + 3 * second, 0.05, 1)


def series_error(bend: jax.Array) -> jax.Array:
    """Bound of the relative error of the stiffness of `series`.

    The first neglected term is 4 b4 y^3 with b4 = 5 a2 a3 - 5 a2^3 - a4 (reversion), and bend = 2 a2 y: their ratio
    to bend^3 is at most 3.7 for all rollers with a gear contact of relative radius 0.1 to 5. The factor 27 also
    covers the further terms.

    Args:
        bend: |stiffness at this load over that of small loads - 1|.
    """
    return 27 * bend**3


def _hertz_load(depth: jax.Array, roller: Compliance, limit: jax.Array) -> jax.Array:
    """Newton from above: the approach is convex, so every step stays above the root and none overshoots."""
    tolerance = 4 * float(jnp.finfo(depth.dtype).eps)

    def running(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        load, last, steps = state
        return jnp.any(last > tolerance * load) & (steps < _INVERSE_STEPS)

    def step(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        load, _, steps = state
        change = (approach("hertz", load, roller) - depth) / slope("hertz", load, roller)
        return jnp.clip(load - change, 0, limit), jnp.abs(change), steps + 1

    start = jnp.minimum(2 * depth / roller.weight, limit)
    return jax.lax.while_loop(running, step, (start, start, jnp.zeros((), jnp.int32)))[0]


def _palmgren_weight(roller: Compliance) -> jax.Array:
    return 1 + power(roller.cage, 1.9) + power(roller.gear, 1.9)
