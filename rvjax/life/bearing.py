"""Life of one bearing under a history of loads.

Damage lamina by lamina, after ISO/TS 16281: profile of the rollers, clearance, tilt. In N and mm.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import status
from rvjax._jax.elementary import log, nonnegative, power
from rvjax._jax.kernels import scan
from rvjax._jax.programs import quick
from rvjax._jax.sizes import LOADS, padded
from rvjax.base.words import choose
from rvjax.bearings import BallBearing, RollerBearing, RollingBearing
from rvjax.catalogue import checked
from rvjax.designs import expect
from rvjax.life.damage import (
    METHODS,
    Damage,
    Ratings,
    basic,
    check_bearing,
    harmless,
    magnitude,
    points,
    raceway,
    ratings,
    turned_back,
    unfit,
)
from rvjax.records import Array, Record, Scalar, concrete, field, promote, quantity, record
from rvjax.roots import bracketed
from rvjax.status import SolveInfo, Status, worst_of
from rvjax.units import mm

LAMINAE = 41
_SPRING = 35948.0  # N / mm^(10/9) over mm^(8/9): Eq. 12
_LINE = 10 / 9
_RING = 72  # points of a ring; Eq. 14 to 1e-6


class Rollers(NamedTuple):
    """Laminae of one bearing."""

    spring: jax.Array  # N / mm^(10/9), of one lamina
    place: jax.Array  # x, (laminae,) mm
    gap: jax.Array  # of each lamina at the load's side: clearance and profile, (laminae,) mm
    tilt: jax.Array  # rad


def laminae(bearing: RollerBearing, clearance: jax.Array, tilt: jax.Array, crowned: bool) -> Rollers:
    """Springs and gaps of the laminae. Eq. 12.

    Args:
        bearing: numbers as arrays.
        clearance: radial, half of the diametral one, m; < 0 counts as 0.
        tilt: in the plane of the load, rad.
        crowned: rollers with the logarithmic profile, or straight ones.
    """
    diameter, length = bearing.roller_diameter / mm, bearing.roller_length / mm
    share = jnp.asarray((np.arange(LAMINAE) + 0.5) / LAMINAE - 0.5, diameter.dtype)
    place = share * length
    short = 0.00035 * diameter * _sagging(jnp.abs(2 * share))
    crown = 2.5 * diameter
    end = jnp.maximum(2 * jnp.abs(place) - length + crown, 0) / crown
    profile = jnp.where(length <= crown, short, 0.0005 * diameter * _sagging(jnp.where(length <= crown, 0, end)))
    gap = nonnegative(clearance / mm) + (2 * profile if crowned else jnp.zeros_like(profile))
    return Rollers(_SPRING * power(length, 8 / 9) / LAMINAE, place, gap, tilt)


def _sagging(y: jax.Array) -> jax.Array:
    """ln 1 / (1 - y^2)."""
    return -log(1 - y * y)


def lamina_loads(rollers: Rollers, approach: jax.Array, cosine: jax.Array) -> jax.Array:
    """Loads q_k per unit of the spring, (..., laminae) mm^(10/9). Eq. 12.

    Args:
        rollers: of the bearing.
        approach: of the rings, dr, mm; of the shape of `cosine`.
        cosine: of the angle from the load, (...).
    """
    lean = jnp.tan(rollers.tilt * cosine)[..., None]
    gap, place = (x.reshape((1,) * cosine.ndim + (LAMINAE,)) for x in (rollers.gap, rollers.place))
    return power(jnp.maximum((approach * cosine)[..., None] - gap - place * lean, 0), _LINE)


def _unbalanced(approach: jax.Array, given: tuple[Rollers, jax.Array, jax.Array, jax.Array]) -> jax.Array:
    """Sum of the rollers' loads along the load, less the load. Eq. 13."""
    rollers, cosine, count, load = given
    carried = jnp.sum(lamina_loads(rollers, jnp.broadcast_to(approach, cosine.shape), cosine), axis=-1)
    return jnp.sum(count * cosine * carried) - load


def approach_under(rollers: Rollers, number: int, size: jax.Array) -> tuple[jax.Array, SolveInfo]:
    """Approach dr of the rings under a load, mm, with the derivatives of the balance. Eq. 13.

    Args:
        rollers: laminae of the bearing.
        number: of rollers, Z; roller 0 lies in the direction of the load.
        size: of the load, () N.
    """
    half = np.arange(number // 2 + 1)  # rollers left and right of the load carry alike
    like = np.where((half == 0) | (2 * half == number), 1.0, 2.0)
    cosine, count = (jnp.asarray(x, size.dtype) for x in (np.cos(2 * np.pi * half / number), like))
    load = size / rollers.spring
    lean = jnp.abs(rollers.place * jnp.tan(rollers.tilt))
    alone = jnp.max(rollers.gap + lean) + power(load, 1 / _LINE)  # every lamina of roller 0 carries more than the load
    edge = jax.lax.stop_gradient(1.01 * alone)
    root = bracketed(_unbalanced, (rollers, cosine, count, load), -edge, edge, start=0.5 * edge)
    return root.value, root.info


def slices(
    bearing: RollerBearing,
    force: jax.Array,
    angle: jax.Array,
    weight: jax.Array,
    ratings: Ratings,
    rollers: Rollers,
) -> tuple[Damage, SolveInfo]:
    """Damage of every lamina of both rings, point by point. Eqs. 13-15.

    Args:
        bearing: its number of rollers is read.
        force: (n, 2) N, in the frame of the outer ring.
        angle: of the inner ring against the outer one, (n,) rad.
        weight: shares of the revolutions, (n,).
        ratings: of the bearing.
        rollers: its laminae.
    """
    size = magnitude(force)
    carried = size > 0
    safe = jnp.where(carried, size, jax.lax.stop_gradient(ratings.dynamic))  # nothing turns on it
    approach, infos = jax.vmap(lambda load: approach_under(rollers, bearing.rollers, load))(safe)
    approach = jnp.where(jnp.isfinite(approach), approach, 0)
    weight = jnp.where(carried, weight, 0)
    lamina = rollers.spring * LAMINAE ** (7 / 9)  # against a rating Q ns^(-7/9)

    def ring(force: jax.Array, rating: jax.Array) -> jax.Array:
        """Sum of the laminae of a ring."""
        cosine = (force / safe[:, None]) @ points(_RING, force.dtype)  # (n, points)

        def block(total: jax.Array, given: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            part, own, share = given
            loads = lamina_loads(rollers, jnp.broadcast_to(own[:, None], part.shape), part) * (lamina / rating)
            return total + jnp.tensordot(share, loads**4, 1), None

        begin = jnp.zeros((_RING, LAMINAE), force.dtype)
        blocks = [padded(x, LOADS, fill=0).reshape(-1, LOADS, *x.shape[1:]) for x in (cosine, approach, weight)]
        damage, _ = scan(jax.checkpoint(block), begin, tuple(blocks))  # Eq. 14
        return jnp.sum(jnp.mean(power(damage, bearing.weibull_slope), axis=0))

    total = ring(turned_back(force, angle), ratings.inner) + ring(force, ratings.outer)
    rate = power(total, 1 / bearing.weibull_slope)  # Eq. 15
    info = worst_of(infos)
    return Damage(ratings.dynamic * power(rate, 1 / bearing.life_exponent), rate), info


@record
class BearingLife(Record):
    """Life of one bearing."""

    life: Any = field("-", "revolutions that 90 % of such bearings reach; inf without load")
    load: Any = field("N", "equivalent load, life = 1e6 (C / load)^(10/3), of balls ^3")
    info: SolveInfo = field("-", "UNLOADED: no revolution carries load", kind="record")


@checked
def bearing_life(
    bearing: RollingBearing,
    force: Array | np.ndarray,
    *,
    angle: Array | np.ndarray | None = None,
    weight: Array | np.ndarray | None = None,
    method: str = "basic",
    clearance: Scalar = 0.0,
    tilt: Scalar = 0.0,
    crowned: bool = True,
) -> BearingLife:
    """Life under a history of loads (ISO 281; ISO/TS 16281). Lives of different methods differ in level by design.

    Not modelled: axial forces, lubrication, dirt, oscillation below one revolution.

    Args:
        bearing: the bearing; its contact angle enters the ratings only.
        force: (n, 2) N, in the frame of the outer ring.
        angle: of the inner ring against the outer one, (n,) rad; None: 0. "basic" does not read it.
        weight: share of the revolutions at each force, (n,) >= 0, normalised to sum 1; None: equal.
        method: "basic" (size of the load), "raceway" (points of both rings) or "slices" (laminae of the rollers);
            balls have "basic" only.
        clearance: radial (half of the diametral one), m, < 0 counts as 0; "slices" only. The slope at 0 is that of a
            clearance.
        tilt: of the rings against each other in the plane of the load, rad; "slices" only.
        crowned: rollers with a logarithmic profile; False: straight; "slices" only.

    Returns:
        BearingLife. Status CONVERGED, UNLOADED (life inf), or with NaN values NONFINITE, INVALID_GEOMETRY (a bearing
        that cannot exist, a weight < 0).

    Raises:
        ValueError: unknown method, another one than "basic" with balls, tilt without "slices", a dynamic rating too
            small for the static one, shapes that do not fit.
    """
    expect(bearing, "life.bearing_life", RollerBearing, BallBearing)
    check_method(method, tilt)
    check_bearing(bearing, type(bearing).__name__, method)
    shape = np.shape(force)
    if len(shape) != 2 or shape[1] != 2 or not shape[0]:
        raise ValueError(f"force: shape {shape}, must be (n, 2) in N")
    for name, value, unit in (("angle", angle, "rad"), ("weight", weight, "shares")):
        if value is not None and np.shape(value) != shape[:1]:
            raise ValueError(f"{name}: shape {np.shape(value)}, must be {shape[:1]} in {unit}, as force has")
    slicing = (clearance, tilt) if method == "slices" else (0.0, 0.0)
    given = (_floats(force), 0.0 if angle is None else _floats(angle), 1.0 if weight is None else _floats(weight))
    return _bearing_life(method, bool(crowned), bearing, *given, *slicing)


def _floats(values: Array | np.ndarray) -> Array | np.ndarray:
    """Arrays unchanged; lists and whole numbers as floats."""
    dtype = getattr(values, "dtype", None)
    return values if dtype is not None and jnp.issubdtype(dtype, jnp.floating) else np.asarray(values, float)


def check_method(method: str, tilt: Scalar) -> None:
    """Raise ValueError for an unknown method, and for a tilt that it does not read.

    Args:
        method: by name.
        tilt: rad.

    Raises:
        ValueError: names the argument and its value.
    """
    choose("method", method, METHODS)
    if method != "slices" and concrete(tilt) and np.any(np.asarray(tilt) != 0):
        raise ValueError(f'tilt = {quantity(tilt, "rad")}: must be 0; method = "{method}" has no tilt, "slices" has')


@quick(0, 1)
def _bearing_life(method: str, crowned: bool, bearing: RollingBearing, *given: Scalar) -> BearingLife:
    bearing, *numbers = promote(bearing, *given)
    force, angle, weight, clearance, tilt = numbers
    angle, weight = (jnp.broadcast_to(x, force.shape[:1]) for x in (angle, weight))
    total = jnp.sum(weight)
    numbers = [force, angle, weight, clearance, tilt]
    fine = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers])) & jnp.isfinite(total)
    refused = (*unfit(bearing), (~fine, Status.NONFINITE), (jnp.any(weight < 0), Status.INVALID_GEOMETRY))
    spare = (harmless(bearing), *jax.tree.map(jnp.zeros_like, numbers))
    (bearing, force, angle, weight, clearance, tilt), gate = status.admit((bearing, *numbers), spare, *refused)
    weight = weight / jnp.where(total > 0, total, 1)
    damage, info = damaged(method, bearing, ratings(bearing), force, angle, weight, clearance, tilt, crowned)
    values = (1e6 * inverse(damage.rate), damage.load)
    (life, load), ended = gate.close_all(values, info, idle=~(damage.rate > 0))
    return BearingLife(life, load, ended.replace(steps=info.steps))


def inverse(rate: jax.Array) -> jax.Array:
    """1 / rate; inf with derivative 0 at 0.

    Args:
        rate: >= 0.
    """
    return jnp.where(rate > 0, 1 / jnp.where(rate > 0, rate, 1), jnp.inf)


def damaged(
    method: str,
    bearing: RollingBearing,
    rated: Ratings,
    force: jax.Array,
    angle: jax.Array,
    weight: jax.Array,
    clearance: jax.Array,
    tilt: jax.Array,
    crowned: bool = True,
) -> tuple[Damage, SolveInfo]:
    """Damage of one bearing that exists, by a method.

    Args:
        method: by name.
        bearing: numbers as arrays.
        rated: its ratings.
        force: (n, 2) N.
        angle: (n,) rad.
        weight: (n,), of sum 1, or 0.
        clearance: radial, m; "slices" only.
        tilt: rad; "slices" only.
        crowned: rollers with the logarithmic profile; "slices" only.
    """
    if method == "basic":
        damage = basic(magnitude(force), weight, rated, bearing.life_exponent)
        return damage, status.at_once(damage.rate)
    assert isinstance(bearing, RollerBearing)
    if method == "slices":
        return slices(bearing, force, angle, weight, rated, laminae(bearing, clearance, tilt, crowned))
    damage = raceway(force, angle, weight, rated)
    return damage, status.at_once(damage.rate)
