"""Coulomb and viscous drag from measured speed ramps."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.checks import checked
from rvjax._jax.programs import quick
from rvjax.records import Array, Record, concrete, field, promote, record
from rvjax.units import with_unit

LEAST = 4  # points: three numbers and one degree of freedom
_WRONG, _FAR = 3.0, 5.0  # standard deviations: a number of the wrong sign is no scatter; a point of the wrong sign
_CHANCE = 1e-4  # that scatter alone looks as curved
_LEAST_BEND = 1e-3  # of the mean torque: less bends no result


@record
class DragFit(Record):
    """torque = coulomb sign(speed) + viscous speed + offset, by least squares over all points."""

    coulomb: Array = field("N m", "torque against the motion at any speed")
    viscous: Array = field("N m s/rad", "rise of the torque with the speed")
    offset: Array = field("N m", "zero error of the bench")
    coulomb_sd: Array = field("N m", "standard deviation of coulomb")
    viscous_sd: Array = field("N m s/rad", "standard deviation of viscous")
    residual_sd: Array = field("N m", "of the points about the fit, with n - 3 degrees of freedom")


@checked
def fit_drag(speed: Array | np.ndarray, torque: Array | np.ndarray) -> DragFit:
    """Fit drag to ramps of the speed in both directions. Friction of the motor is part of what the bench measured.

    Args:
        speed: of each point, (n,) rad/s, both signs. A traced point at rest does not count.
        torque: that keeps the speed, (n,) N m, on the same shaft; of the sign of the speed.

    Raises:
        ValueError: arrays of different length, fewer than four points, one direction or one size of the speed, a point
            at rest, a torque against the speed, a drag below zero.

    Warns:
        UserWarning: the points bend about the fit, as those of Stribeck friction do.
    """
    speed, torque = (x if isinstance(x, jax.Array) else np.asarray(x, float) for x in (speed, torque))
    sizes = {"speed": np.shape(speed), "torque": np.shape(torque)}
    for name, size in sizes.items():
        if len(size) != 1:
            raise ValueError(f"{name}: shape {size}, must be (n,)")
    if sizes["speed"] != sizes["torque"]:
        raise ValueError(f"torque: {sizes['torque'][0]} points, must be {sizes['speed'][0]} as of speed")
    if sizes["speed"][0] < LEAST:
        raise ValueError(f"speed: {sizes['speed'][0]} points, must be at least {LEAST}")
    if concrete(speed):
        turning = np.asarray(speed)[np.asarray(speed) != 0]
        if not (np.isnan(turning).any() or (turning.min(initial=0) < 0 < turning.max(initial=0))):
            raise ValueError("speed: one direction only; the offset of the bench needs both")
        if np.ptp(np.abs(turning)) == 0:
            raise ValueError(f"speed: {abs(turning[0]):g} rad/s in every point; viscous drag needs two sizes")
        if len(turning) < sizes["speed"][0]:
            k = int(np.argmin(np.abs(np.asarray(speed))))
            raise ValueError(f"speed[{k}] = 0 rad/s: a point at rest has no direction of friction; leave it out")
    found = _fit_drag(speed, torque)
    if concrete(found.residual_sd) and np.isfinite(found.residual_sd):
        _check(np.asarray(speed), np.asarray(torque), found)
    return found


def _check(speed: np.ndarray, torque: np.ndarray, found: DragFit) -> None:
    """Raise for torques and drags that are no friction; warn where the points bend about the fit."""
    way, share = np.sign(speed), np.abs(speed) / np.abs(speed).max()
    plain = np.stack([way, way * share, np.ones_like(way)], axis=1)
    against = way * torque < 0
    if np.sum(against) <= max(1, len(speed) // 10):  # no scatter about zero: a wrong point, if far from the others
        off = torque - plain @ np.linalg.lstsq(plain[~against], torque[~against])[0]
        against &= np.abs(off) > _FAR * np.sqrt(np.mean(off[~against] ** 2))
    else:
        against &= False
    for side in (1, -1):
        own = way == side
        if side * (mean := torque[own].mean()) <= 0 or (against & own).any():
            k = int(np.argmin(np.where(own, way * torque, np.inf)))
            raise ValueError(
                f"torque[{k}] = {torque[k]:g} N m at {speed[k]:g} rad/s (mean of this direction {mean:g} N m): a "
                "torque that keeps a speed has its sign; check the signs and subtract the zero of the bench"
            )
    for name, unit in (("coulomb", "N m"), ("viscous", "N m s/rad")):
        value, spread = (float(getattr(found, key)) for key in (name, f"{name}_sd"))
        if value < -_WRONG * spread - 1e-9 * np.abs(torque).max() / (np.abs(speed).max() if unit != "N m" else 1):
            shown = f"{value:g} +- {with_unit(spread, unit, 'g')}"
            raise ValueError(f"{name} = {shown}: must not be negative; the points are no such drag")
    if (more := len(speed) - 5) < 1:
        return
    curved = np.concatenate([plain, way[:, None] * share[:, None] ** [2, 3]], axis=1)
    left, less = (torque - x @ np.linalg.lstsq(x, torque)[0] for x in (plain, curved))
    bend, scatter = np.sum((left - less) ** 2), np.sum(less**2)
    chance = special.fdtrc(2, more, bend / 2 / max(scatter / more, 1e-30 * np.sum(torque**2)))
    size = float(np.sqrt(bend / len(speed)))
    if chance < _CHANCE and size > _LEAST_BEND * np.abs(torque).mean():
        warnings.warn(
            f"the torque bends about the fit by {size:.3g} N m rms: coulomb and viscous do not describe it, as below "
            "the speed of a full lubricant film (Stribeck); fit the range of speeds that is used",
            stacklevel=4,
        )


@quick()
def _fit_drag(speed: Array | np.ndarray, torque: Array | np.ndarray) -> DragFit:
    speed, torque = promote(speed, torque)
    most = jnp.max(jnp.abs(speed))
    scale = jnp.where(most > 0, most, 1)
    moving = (speed != 0).astype(speed.dtype)
    columns = jnp.stack([jnp.sign(speed), speed / scale, moving], axis=1)
    basis, upper = jnp.linalg.qr(columns)
    found = jax.scipy.linalg.solve_triangular(upper, basis.T @ torque)
    rest = moving * torque - columns @ found
    sd = jnp.sqrt(jnp.sum(rest * rest) / (jnp.sum(moving) - 3))
    inverse = jax.scipy.linalg.solve_triangular(upper, jnp.eye(3, dtype=speed.dtype))
    sds = sd * jnp.sqrt(jnp.sum(inverse * inverse, axis=1))  # (X'X)^-1 = R^-1 R^-T
    return DragFit(found[0], found[1] / scale, found[2], sds[0], sds[1] / scale, sd)
