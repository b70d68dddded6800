"""Bench observations of a reducer under load: orders of the transmission error, and the hysteresis curve.

All angles of a turn are solved next to each other: with slopes of fifty elements that is cheaper than from one angle to
the next. Every observation is linear in the errors at single angles, so that each equilibrium is solved for its slopes
once, however many numbers are observed.
"""

import functools
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK
from rvjax.loaded.conditions import Conditions, ways
from rvjax.loaded.equilibrium import error_alone
from rvjax.loaded.head import effects_of_a_head
from rvjax.loaded.kinds import check_input, kind_of
from rvjax.loaded.system import Layout
from rvjax.outputs import Observation, Spectrum
from rvjax.records import Array, PyTree, Scalar

NEEDS = ("stiffness", "contact")
PARTS = 5
"""Most parts of the angles of a turn of the output."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _errors(layout: Layout, design: PyTree, errors: PyTree, torques: Array, angles: Array) -> jax.Array:
    """Transmission error (t, n) at torques (t,) and input angles (n,)."""
    return _each(functools.partial(_error, layout, design, errors), torques, angles)


def _error(layout: Layout, design: PyTree, errors: PyTree, torque: Scalar, angle: Scalar) -> jax.Array:
    return error_alone(layout, design, errors, angle, torque)


def _each(function: PyTree, torques: Array, angles: Array) -> PyTree:
    """The function at every torque and angle, under one `jax.vmap`: each one traces the equilibrium again."""
    shape = len(torques), len(angles)
    pairs = (jnp.broadcast_to(x, shape).ravel() for x in (torques[:, None], angles))
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), jax.vmap(function)(*pairs))


def _errors_jvp(layout: Layout, primals: PyTree, tangents: PyTree) -> tuple[jax.Array, jax.Array]:
    """One adjoint of each equilibrium, then sums: with ten observed numbers a tenth of their adjoints."""
    design, errors, torques, angles = primals
    leaves, tree = jax.tree.flatten((design, errors))
    zero = jax.custom_derivatives.SymbolicZero
    still: Callable[[object], bool] = lambda tangent: isinstance(tangent, zero)  # noqa: E731
    changes = jax.tree.leaves(tangents[:2], is_leaf=still)
    moving = [i for i, change in enumerate(changes) if not still(change)]

    def one(own: list[jax.Array], torque: Scalar, angle: Scalar) -> Array:
        whole = list(leaves)
        for i, leaf in zip(moving, own):
            whole[i] = leaf
        design, errors = jax.tree.unflatten(tree, whole)
        return _error(layout, design, errors, torque, angle)

    of = functools.partial(jax.value_and_grad(one, (0, 1, 2)), [leaves[i] for i in moving])
    error, (slopes, of_torque, of_angle) = _each(of, torques, angles)
    change = jnp.zeros_like(error)
    for slope, i in zip(slopes, moving):
        change += jnp.tensordot(slope, changes[i], jnp.ndim(changes[i]), precision="highest")
    if not still(tangents[2]):
        change += of_torque * tangents[2][:, None]
    if not still(tangents[3]):
        change += of_angle * tangents[3][None]
    return error, change


_errors.defjvp(_errors_jvp, symbolic_zeros=True)


def _count(design: PyTree, given: Conditions, orders: tuple[int, ...], alike: bool) -> int:
    """Angles of a period: so many that no order of perfect parts that they do not resolve looks like an observed one.

    The mean is observed, too.
    """
    step = design.cycloid.pin_count if alike else 1
    seen = {0, *(k / step for k in orders)}
    passing = [k / step for k in kind_of(design).passing(design)]

    def taken(count: int) -> bool:
        return any(abs(k - count * round(k / count)) in seen for k in passing if 2 * k >= count)

    least = given.samples if alike else max(given.samples, 4 * max(orders))
    return next(count for count in itertools.count(least) if not taken(count))


def _parts(design: PyTree, given: Conditions, orders: tuple[int, ...], alike: bool) -> int:
    """Parts of a turn of the output: so many that what one takes for another order is far from those of the pins."""
    if alike:
        return 1
    pins, count = design.cycloid.pin_count, _count(design, given, orders, alike)

    def distance(parts: int) -> int:
        """Least distance of a mistaken order from a multiple of the pins."""
        mistaken = [k * count // parts % pins for k in range(1, parts)]
        return min(min(k, pins - k) for k in mistaken)

    fit = [n for n in range(2, PARTS + 1) if count % n == 0 and distance(n) >= pins // PARTS]
    return max(fit, default=1)


def _spectrum(
    design: PyTree,
    errors: PyTree,
    given: Conditions,
    torques: Array,
    orders: tuple[int, ...],
    alike: bool,
    part: tuple[Array | int, int] = (0, 1),
) -> Spectrum:
    """One turn of the cranks where all are alike, else a turn of the output."""
    step = design.cycloid.pin_count if alike else 1
    count, (number, parts) = _count(design, given, orders, alike), part
    stiff, torques = errors.stiffened(design), jnp.asarray(torques)
    own = jnp.asarray(np.arange(0, count, parts), torques.dtype) + jnp.asarray(number, torques.dtype)
    angles = 2 * jnp.pi * design.ratio / step / count * own
    error = _errors(check_input(stiff, errors, **ways(given)), stiff, errors, torques, angles)
    turned = np.outer(np.arange(count), [k // step for k in orders]) * 2 * np.pi / count
    every = np.where([k % step == 0 for k in orders], 2 * parts / count * np.exp(-1j * turned), 0)
    waves = jnp.asarray(every.reshape(-1, parts, len(orders)))[:, number]
    found = [jnp.matmul(error, w.astype(error.dtype), precision="highest") for w in (waves.real, waves.imag)]
    return jnp.mean(error, axis=1), jax.lax.complex(*found)


def _angle(design: PyTree, errors: PyTree, given: Conditions, torques: Array) -> Array:
    """Output angle at each torque, input held."""
    angle = jnp.asarray(given.input_angle, jnp.result_type(float))[None]
    stiff = errors.stiffened(design)
    return _errors(check_input(stiff, errors, **ways(given)), stiff, errors, jnp.asarray(torques), angle)[:, 0]


CURVE = Observation(
    "curve",
    _spectrum,
    NEEDS,
    samples="samples",
    period=lambda design: int(design.cycloid.pin_count),
    sided=True,
    head=effects_of_a_head,
    parts=_parts,
    compiler_options=QUICK,
)
LOOP = Observation("loop", _angle, NEEDS, compiler_options=QUICK)
