"""Life of one bearing under a history of loads."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import status
from rvjax.bearings import RollerBearing
from rvjax.choices import choose
from rvjax.compile_cache import quick
from rvjax.designs import expect
from rvjax.life.histories import METHODS, Damage, basic, magnitude, raceway
from rvjax.life.ratings import Ratings, check_ratings, harmless, ratings, unfit
from rvjax.life.slices import laminae, slices
from rvjax.plausible import checked
from rvjax.records import Array, Record, Scalar, concrete, field, promote, quantity, record
from rvjax.status import SolveInfo, Status, succeeded


@record
class BearingLife(Record):
    """Life of one bearing."""

    life: Any = field("-", "revolutions that 90 % of such bearings reach; inf without load")
    load: Any = field("N", "equivalent load, life = 1e6 (C / load)^(10/3)")
    info: SolveInfo = field("-", "UNLOADED: no revolution carries load", kind="record")


@checked
def bearing_life(
    bearing: RollerBearing,
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
        method: "basic" (size of the load), "raceway" (points of both rings) or "slices" (laminae of the rollers).
        clearance: radial (half of the diametral one), m, < 0 counts as 0; "slices" only.
        tilt: of the rings against each other in the plane of the load, rad; "slices" only.
        crowned: rollers with a logarithmic profile; False: straight; "slices" only.

    Returns:
        BearingLife. Status CONVERGED, UNLOADED (life inf), or with NaN values NONFINITE, INVALID_GEOMETRY (a bearing
        that cannot exist, a weight < 0).

    Raises:
        ValueError: unknown method, tilt without "slices", a dynamic rating too small for the static one, shapes that
            do not fit.
    """
    expect(bearing, "life.bearing_life", RollerBearing)
    check_method(method, tilt)
    check_ratings(bearing, "RollerBearing")
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
    """Arrays as they are; lists and whole numbers as floats."""
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


class Looseness(NamedTuple):
    """Inputs of `slices` only."""

    clearance: jax.Array  # m
    tilt: jax.Array  # rad
    crowned: bool


@quick(0, 1)
def _bearing_life(method: str, crowned: bool, bearing: RollerBearing, *given: Scalar) -> BearingLife:
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
    loose = Looseness(clearance, tilt, crowned)
    damage, info = damaged(method, bearing, ratings(bearing), force, angle, weight, loose)
    return _closed(gate, damage, info)


def _closed(gate: status.Gate, damage: Damage, info: SolveInfo) -> BearingLife:
    failed = ~succeeded(info.status)
    ended = jnp.where(damage.rate > 0, info.status, jnp.int32(int(Status.UNLOADED)))
    values = (1e6 * inverse(damage.rate), damage.load)
    (life, load), info = gate.close(values, info=info.replace(status=jnp.where(failed, info.status, ended)))
    life, load = (jnp.where(failed, jnp.nan, x) for x in (life, load))
    return BearingLife(life, load, info)


def inverse(rate: jax.Array) -> jax.Array:
    """1 / rate; inf with derivative 0 at 0.

    Args:
        rate: >= 0.
    """
    return jnp.where(rate > 0, 1 / jnp.where(rate > 0, rate, 1), jnp.inf)


def damaged(
    method: str,
    bearing: RollerBearing,
    rated: Ratings,
    force: jax.Array,
    angle: jax.Array,
    weight: jax.Array,
    loose: Looseness,
) -> tuple[Damage, SolveInfo]:
    """Damage of one bearing that exists, by a method.

    Args:
        method: by name.
        bearing: numbers as arrays.
        rated: its ratings.
        force: (n, 2) N.
        angle: (n,) rad.
        weight: (n,), of sum 1, or 0.
        loose: what only "slices" reads.
    """
    if method == "slices":
        rollers = laminae(bearing, loose.clearance, loose.tilt, loose.crowned)
        return slices(bearing, force, angle, weight, rated, rollers)
    found = basic(magnitude(force), weight, rated) if method == "basic" else raceway(force, angle, weight, rated)
    return found, status.at_once(found.rate)
