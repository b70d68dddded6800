"""Hysteresis curve of a reducer with its input locked: elastic line, dead zone and dry friction.

Rate independent. A play operator of half-width `friction` turns the torque T at the output into the
torque w that reaches the springs; the angle is g(w) = w / stiffness + (play / 2) tanh(w / smoothing).
"""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax.catalogue import checked
from rvjax.records import Array, PyTree, Record, Scalar, concrete, field, promote, quantity, record


@record
class LoopFigures(Record):
    """Values of the hysteresis curve of a torque cycled between two equal limits, as on a test bench."""

    lost_motion: Array = field("rad", "mid-line of the loop at +threshold less that at -threshold")
    zero_torque_width: Array = field("rad", "width of the loop at zero torque")
    energy: Array = field("N m", "dissipated in one cycle, the area of the loop (N m rad)")


@checked
def hysteresis_loop(
    torque: Array | np.ndarray, *, play: Scalar, stiffness: Scalar, friction: Scalar, smoothing: Scalar
) -> jax.Array:
    """Angle of the output as the torque on it runs through a sequence; no torque before the first sample.

    Args:
        torque: at the output, (N,) N m, in order of time.
        play: free angle in total, rad, >= 0; `LostMotion.play` for one.
        stiffness: of the elastic line, N m/rad.
        friction: torque that dry friction can hold, N m at the output, >= 0.
        smoothing: torque over which the backlash closes, N m; 0 makes it a jump, with half the backlash on
            either side of zero.

    Returns:
        Angle (N,) rad.

    Raises:
        ValueError: torque is not one sequence, or a number of wrong sign.
    """
    _check(play=play, stiffness=stiffness, friction=friction, smoothing=smoothing)
    if jnp.ndim(torque) != 1:
        raise ValueError(f"torque: shape {jnp.shape(torque)}, expected (N,); sweep with jax.vmap")
    return _hysteresis_loop(torque, play, stiffness, friction, smoothing)


@jax.jit
def _hysteresis_loop(*numbers: object) -> jax.Array:
    torque, play, stiffness, friction, smoothing = promote(*numbers)

    def play_operator(before: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
        # Selected, for where both meet `maximum` shares its derivative: without friction the torque passes whole.
        after = jnp.where(before >= now + friction, now + friction, before)
        after = jnp.where(before <= now - friction, now - friction, after)
        return after, after

    _, passed = scan(play_operator, jnp.zeros_like(friction), torque)
    return _angle(passed, play, stiffness, smoothing)


@checked
def loop_figures(
    *,
    torque_threshold: Scalar,
    torque_max: Scalar,
    play: Scalar,
    stiffness: Scalar,
    friction: Scalar,
    smoothing: Scalar,
) -> LoopFigures:
    """Lost motion, zero-torque width and energy of the closed loop, in closed form.

    With friction above the threshold and no smoothing the lost motion is 2 threshold / stiffness:
    friction hides the backlash.

    Args:
        torque_threshold: where lost motion is read, N m; by custom 3 % of the rated torque.
        torque_max: the torque is cycled between +-torque_max, N m.
        play: as in `hysteresis_loop`.
        stiffness: as in `hysteresis_loop`.
        friction: as in `hysteresis_loop`.
        smoothing: as in `hysteresis_loop`.

    Returns:
        LoopFigures; NaN where torque_max < torque_threshold + 2 friction, for there the two branches of
        the loop have not parted fully.

    Raises:
        ValueError: a number of wrong sign, or torque_max too small.
    """
    _check(play=play, stiffness=stiffness, friction=friction, smoothing=smoothing, torque_threshold=torque_threshold)
    values = (torque_max, torque_threshold, friction)
    if concrete(*values) and np.any(np.asarray(torque_max < torque_threshold + 2 * friction)):
        raise ValueError(
            f"torque_max = {quantity(torque_max, 'N m')}: must be at least torque_threshold + 2 friction = "
            f"{quantity(torque_threshold + 2 * friction, 'N m')}"
        )
    return _loop_figures(torque_threshold, torque_max, play, stiffness, friction, smoothing)


@jax.jit
def _loop_figures(*numbers: object) -> LoopFigures:
    x, limit, play, stiffness, friction, smoothing = promote(*numbers)

    def angle(torque: jax.Array) -> jax.Array:
        return _angle(torque, play, stiffness, smoothing)

    closed = limit >= x + 2 * friction
    return LoopFigures(
        lost_motion=jnp.where(closed, angle(x - friction) + angle(x + friction), jnp.nan),
        zero_torque_width=jnp.where(closed, 2 * angle(friction), jnp.nan),
        energy=jnp.where(closed, 4 * friction * angle(limit - friction), jnp.nan),
    )


def _angle(passed: jax.Array, play: jax.Array, stiffness: jax.Array, smoothing: jax.Array) -> jax.Array:
    """Elastic line plus dead zone, odd in the torque that reaches the springs."""
    taken_up = jnp.abs(passed) >= 40 * smoothing  # tanh(20) = 1 to rounding; also where smoothing is 0
    ratio = jnp.where(taken_up, 0, passed) / jnp.where(taken_up, 1, smoothing)
    return passed / stiffness + play / 2 * jnp.where(taken_up, jnp.sign(passed), jnp.tanh(ratio))


def _check(*, stiffness: Scalar, **others: PyTree) -> None:
    if concrete(stiffness) and np.any(np.asarray(stiffness) <= 0):
        raise ValueError(f"stiffness = {quantity(stiffness, 'N m/rad')}: must be positive")
    for name, value in others.items():
        if concrete(value) and np.any(np.asarray(value) < 0):
            raise ValueError(
                f"{name} = {quantity(value, 'rad' if name == 'play' else 'N m')}: must be zero or positive"
            )
