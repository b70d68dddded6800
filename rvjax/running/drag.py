"""Coulomb and viscous drag from measured speed ramps."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.arguments import checked
from rvjax._jax.compile_cache import quick
from rvjax.records import Array, Record, concrete, field, promote, record

LEAST = 4  # points: three numbers and one degree of freedom


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
        speed: of each point, (n,) rad/s, both signs.
        torque: that keeps the speed, (n,) N m, on the same shaft.

    Raises:
        ValueError: arrays of different length, fewer than four points, one direction or one size of the speed.
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
    return _fit_drag(speed, torque)


@quick()
def _fit_drag(speed: Array | np.ndarray, torque: Array | np.ndarray) -> DragFit:
    speed, torque = promote(speed, torque)
    most = jnp.max(jnp.abs(speed))
    scale = jnp.where(most > 0, most, 1)
    columns = jnp.stack([jnp.sign(speed), speed / scale, jnp.ones_like(speed)], axis=1)
    basis, upper = jnp.linalg.qr(columns)
    found = jax.scipy.linalg.solve_triangular(upper, basis.T @ torque)
    rest = torque - columns @ found
    sd = jnp.sqrt(jnp.sum(rest * rest) / (len(speed) - 3))
    inverse = jax.scipy.linalg.solve_triangular(upper, jnp.eye(3, dtype=speed.dtype))
    sds = sd * jnp.sqrt(jnp.sum(inverse * inverse, axis=1))  # (X'X)^-1 = R^-1 R^-T
    return DragFit(found[0], found[1] / scale, found[2], sds[0], sds[1] / scale, sd)
