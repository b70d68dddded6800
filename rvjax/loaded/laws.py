"""Contact laws of a pin and a disc: force at a depth d > 0, slope and energy (docs/models/loaded.md, Eqs. 17-20).

    hertz     d = c F (A - ln F), c = 2 (1 - nu^2) / (pi E L): line contact of a cylinder and a disc
    linear    F = k d
    palmgren  d = C F^0.9

`compliance` is c, k or C by contact law; `level` is A of every pin, hertz only. All functions are elementwise, force
and energy are 0 where d <= 0. Beyond its largest depth the force of the hertz contact law rises in proportion, so that
the energy is convex for any displacement: an iteration may pass there, an equilibrium there is CONTACT_OVERLOAD.
"""

import math

import jax
import jax.numpy as jnp

from rvjax._jax.elementary import log, power
from rvjax.designs import Contact

CONTACTS = ("hertz", "linear", "palmgren")

# y(t) with y - ln y = t: y = 1 + sqrt(2) v + v^2 r(v), v = sqrt(t - 1), r from 2/3 to 1; r fitted to 1.4e-5 of y.
_UPPER = (2 / 3, 0.5897162643963102, 0.14032115613249033)
_LOWER = (1.0, 0.7672946271135289, 0.14082055400282797)
_LEAST = 0.04  # least y - 1: at 0.9992 of the depth with y = 1, which has no finite slope


def force(law: str, depth: jax.Array, compliance: jax.Array, level: jax.Array | None) -> jax.Array:
    """Force of a pin on the disc, N."""
    pressed = depth > 0
    if law == "linear":
        return jnp.where(pressed, compliance * depth, 0)
    inside = jnp.where(pressed, depth, 1)
    if law == "palmgren":
        return jnp.where(pressed, power(inside / compliance, 10 / 9), 0)
    assert level is not None
    return jnp.where(pressed, _hertz(inside, compliance, level), 0)


def slope(law: str, depth: jax.Array, load: jax.Array, compliance: jax.Array) -> jax.Array:
    """Rise of the force with the depth, N/m; `load` is the force at this depth."""
    pressed = depth > 0
    if law == "linear":
        return jnp.where(pressed, compliance, 0)
    inside = jnp.where(pressed, depth, 1)
    if law == "palmgren":
        return jnp.where(pressed, 10 / 9 * load / inside, 0)
    return load / jnp.where(pressed, _reserve(inside, load, compliance), 1)


def energy(law: str, depth: jax.Array, load: jax.Array, compliance: jax.Array, most: jax.Array | None) -> jax.Array:
    """Energy stored at a depth, J; `load` is the force at this depth, `most` the largest depth, hertz only."""
    if law == "linear":
        return load * depth / 2
    if law == "palmgren":
        return 9 / 19 * load * depth
    assert most is not None
    inside = load * (2 * depth - compliance * load) / 4  # c F^2 (2 y - 1) / 4
    beyond = load * depth / 2 - jnp.square(most / (1 + _LEAST)) / (4 * compliance)
    return jnp.where(depth < most, inside, beyond)


def typical_slope(law: str, load: jax.Array, compliance: jax.Array, level: jax.Array | None) -> jax.Array:
    """Slope at a force, N/m."""
    if law == "linear":
        return compliance
    if law == "palmgren":
        return power(load, 0.1) / (0.9 * compliance)
    assert level is not None
    return 1 / (compliance * jnp.maximum(level - 1 - jnp.log(jnp.where(load > 0, load, 1)), 1))


def depth(law: str, load: jax.Array, compliance: jax.Array, level: jax.Array | None) -> jax.Array:
    """Depth at a force, m; 0 without force."""
    if law == "linear":
        return load / compliance
    pressed = load > 0
    inside = jnp.where(pressed, load, 1)
    if law == "palmgren":
        return jnp.where(pressed, compliance * power(inside, 0.9), 0)
    assert level is not None
    return compliance * load * jnp.maximum(level - log(inside), 1)


def largest_depth(compliance: jax.Array, level: jax.Array) -> jax.Array:
    """Depth up to which the hertz contact law holds, m."""
    return compliance * (1 + _LEAST) * jnp.exp(level - (1 + _LEAST))


@jax.custom_jvp
def _hertz(depth: jax.Array, compliance: jax.Array, level: jax.Array) -> jax.Array:
    """F of d = c F (A - ln F) = c F y: y - ln y = A - ln(d / c), with one logarithm.

    A rough start y0, then y = y0 (1 + s) with s (y0 - 1) + s^2/2 - s^3/3 + s^4/4 = A - y0 - ln(d / (c y0)).
    """
    ratio = depth * (1 / compliance)
    v = jnp.sqrt(jnp.maximum(level - _rough_log(ratio) - 1, 0))
    r = (_UPPER[0] + v * (_UPPER[1] + v * _UPPER[2])) / (_LOWER[0] + v * (_LOWER[1] + v * _LOWER[2]))
    above = jnp.maximum(v * (math.sqrt(2) + v * r), _LEAST)
    start = 1 + above
    both = 1 / (above * start)  # one division for two
    rough, part = ratio * above * both, start * both
    first = (level - start - log(rough)) * part
    first = jnp.where(above > _LEAST, first, jnp.maximum(first, 0))  # beyond the largest depth y stays
    s = first
    for _ in range(3):
        s = first - part * s * s * (0.5 - s * (1 / 3 - s / 4))
    return rough / (1 + s)


@_hertz.defjvp
def _hertz_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    (depth, compliance, level), (ddepth, dcompliance, dlevel) = primals, tangents
    load = _hertz(depth, compliance, level)
    reserve = _reserve(depth, load, compliance)
    change = ddepth - depth / compliance * dcompliance - compliance * load * dlevel
    return load, load / reserve * change


def _reserve(depth: jax.Array, load: jax.Array, compliance: jax.Array) -> jax.Array:
    """Force over slope: c F (y - 1), and the depth beyond the largest one."""
    reserve = depth - compliance * load
    return jnp.where(reserve < 1.0001 * _LEAST / (1 + _LEAST) * depth, depth, reserve)


def _rough_log(x: jax.Array) -> jax.Array:
    """Logarithm to 1e-3 from the bits of a float64."""
    if x.dtype != jnp.float64:
        return jnp.log(x)
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    power_of_two = bits.astype(jnp.float64) * 2.0**-52 - 1023
    whole = jnp.floor(power_of_two)
    m = power_of_two - whole
    return math.log(2) * (whole + m + m * (1 - m) * (0.4237 - m * 0.1552))


def plane(contact: Contact) -> jax.Array:
    """(s1 + s2)/pi, 1/Pa: over the face width, c of the hertz contact law.

    Args:
        contact: of discs and pins.
    """
    if contact.pin_young_modulus is None:
        return jnp.asarray(2 * (1 - contact.poisson_ratio**2) / (jnp.pi * contact.young_modulus))
    return jnp.asarray(sum(contact.compliances) / jnp.pi)


def level(contact: Contact, rounding: jax.Array) -> jax.Array:
    """A of the hertz contact law with a rigid support: ln(4 pi L r^2/((s1 + s2) R*)) - (s2 + s1 nu/(1 - nu))/(s1 + s2).

    Args:
        contact: of discs and pins.
        rounding: r^2/R* of a pin of radius r, m.
    """
    nu = contact.poisson_ratio
    if contact.pin_young_modulus is None:  # Eq. 17
        stiff = contact.young_modulus * contact.face_width / (1 - nu**2)
        return jnp.asarray(jnp.log(2 * jnp.pi * stiff * rounding) - 1 / (2 * (1 - nu)))
    disc, pin = contact.compliances
    whole = disc + pin
    return jnp.asarray(
        jnp.log(4 * jnp.pi * contact.face_width / whole * rounding) - (pin + disc * nu / (1 - nu)) / whole
    )
