"""Torque-angle curve of a whole reducer, with backlash and lost motion as makers measure them."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from rvjax._jax.kernels import scan
from rvjax._jax.programs import quick
from rvjax.catalogue import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.case import at_output, output_rotation, solve
from rvjax.loaded.kinds import admit, check_input, prepare
from rvjax.loaded.newton import Minimum
from rvjax.loaded.system import Layout
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.roots import solved
from rvjax.status import SolveInfo, succeeded, worst_of

SHARES = (1.0, 0.5, 0.03, 1e-3)
"""Shares of the rated torque, at either sign. The least is the probe torque: the limit of no torque."""


@record
class Torsion(Record):
    """Torque-angle curve at one input angle."""

    torque: Array = field("N m", "torque of the discs on the carrier, ascending", shape=(8,))
    angle: Array = field("rad", "rotation of the carrier against the ideal motion", shape=(8,))
    backlash: Array = field("rad", "error(-probe) - error(+probe), probe = 1e-3 of rated")
    lost_motion: Array = field("rad", "error(-3 %) - error(+3 %)")
    stiffness: Array = field("N m/rad", "secant between half and full rated torque")
    info: SolveInfo = field("-", "the worst of the eight; steps: all", kind="record")


@checked
def torsion(
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
    *,
    input_angle: Scalar,
    rated_torque: Scalar,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Torsion:
    """Equilibria at +-(0.1, 3, 50, 100 %) of the rated torque, and the values of a test bench.

    Args:
        design: as in `equilibrium`.
        errors: as in `equilibrium`.
        input_angle: at which the sun is held, () rad.
        rated_torque: () N m, > 0.
        contact: as in `equilibrium`.
        carrier: as in `equilibrium`.
        sun: as in `equilibrium`.

    Returns:
        Torsion; all values NaN where one of the eight equilibria has none.

    Raises:
        ValueError: as `equilibrium`.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    return _torsion(layout, design, errors, input_angle, rated_torque)


@quick(0)
def _torsion(layout: Layout, design: Record, errors: Record, input_angle: Scalar, rated_torque: Scalar) -> Torsion:
    error, info = twisted(layout, design, errors, input_angle, rated_torque, SHARES)
    rated = jnp.asarray(rated_torque, error.dtype)
    torque = rated * jnp.asarray([[-share, share] for share in SHARES], error.dtype)
    gone = error[:, 0] - error[:, 1]
    return Torsion(
        torque=_ascending(torque),
        angle=_ascending(error),
        backlash=gone[3],
        lost_motion=gone[2],
        stiffness=secant(error[0, 1], error[1, 1], rated),
        info=info,
    )


def secant(at_rated: jax.Array, at_half: jax.Array, rated_torque: Scalar) -> jax.Array:
    """Stiffness between half and full rated torque, N m/rad.

    Args:
        at_rated: rotation under the rated torque, rad.
        at_half: rotation under half of it, rad.
        rated_torque: N m.
    """
    return jnp.asarray(0.5 * rated_torque / (at_half - at_rated))


@quick(0)
def twisted(
    layout: Layout,
    design: PyTree,
    errors: PyTree,
    input_angle: Scalar,
    rated_torque: Scalar,
    shares: Sequence[float],
) -> tuple[jax.Array, SolveInfo]:
    """Rotation of the carrier at some shares of the rated torque, of either sign, each from the one before.

    Args:
        layout: counts and methods.
        design: as in `equilibrium`.
        errors: as in `equilibrium`.
        input_angle: () rad.
        rated_torque: () N m.
        shares: of the rated torque, (n,) descending.

    Returns:
        Rotations (n, 2) rad, under the negative and the positive torque, NaN where one of them has no equilibrium; and
        the worst of their infos.
    """
    read = admit(layout, design, errors, rated_torque, input_angle)
    case = prepare(layout, read, read.angle)
    sides = read.torque * jnp.asarray([-1.0, 1.0], read.torque.dtype)
    sizes = jnp.asarray(shares, read.torque.dtype)

    def lower(start: jax.Array, share: jax.Array) -> tuple[jax.Array, tuple[Minimum, SolveInfo]]:
        """Both signs at one size of the torque, from the solutions at the one before."""
        minima, info = jax.vmap(lambda torque, start: solve(layout, read, case.on_bench(torque), start))(
            sides * share, start
        )
        return jnp.where(succeeded(info.status)[:, None], minima.q, jnp.nan), (minima, info)

    cold = jnp.full((2, layout.unknowns), jnp.nan, sides.dtype)
    minima, infos = solved(scan(lower, cold, sizes)[1])

    def angle(torque: jax.Array, minima: Minimum, status: jax.Array) -> jax.Array:
        loaded = case.on_bench(torque)
        return output_rotation(layout, loaded, at_output(layout, loaded, minima, status))

    error = jax.vmap(jax.vmap(angle))(sizes[:, None] * sides[None], minima, infos.status)  # (n, 2)
    whole = worst_of(infos)
    return jnp.where(succeeded(whole.status), error, jnp.nan), whole.replace(steps=jnp.sum(infos.steps))


def _ascending(pairs: jax.Array) -> jax.Array:
    """(4, 2) [size falling, sign] in ascending order of the torque, (8,)."""
    return jnp.concatenate([pairs[:, 0], pairs[::-1, 1]])
