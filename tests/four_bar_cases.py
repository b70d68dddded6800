"""Shared pieces of the four-bar tests: compiled solvers, the reference file in SI, random linkages."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import LinkDeviations, Status, four_bar
from rvjax.four_bar.linkage import ALLOWED

MM = 1e-3
E, SPACING = 1.3 * MM, 72 * MM
METHODS = [(cranks, closure, branch) for (cranks, branch), closures in ALLOWED.items() for closure in closures]
EXACT = [methods for methods in METHODS if methods[1] in ("newton", "closed_form")]


def one(e, spacing, deviations, angle, ratio, *, methods):
    """One linkage; the gear ratio is dropped where the methods have no use for it."""
    cranks, closure, branch = methods
    ratio = ratio if cranks == "geared" else None
    return four_bar.solve_closure(
        e,
        spacing,
        deviations,
        crank_angle=angle,
        cranks=cranks,
        gear_stiffness_ratio=ratio,
        closure=closure,
        branch=branch,
    )


WIDTH = 512  # every batch is padded to it, so that each function is compiled once a dtype


def padded(function):
    """Compile a batched function for one width; a shorter batch is filled up with its last case."""
    compiled = jax.jit(jax.vmap(function))

    def call(*arguments):
        size = len(jax.tree.leaves(arguments)[0])
        index = np.minimum(np.arange(WIDTH), size - 1)
        result = compiled(*jax.tree.map(lambda leaf: np.asarray(leaf)[index], arguments))
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:size], result)

    return call


@functools.cache
def solver(methods):
    """Batch of linkages: every argument of `one` with a leading axis."""
    return padded(functools.partial(one, methods=methods))


@functools.cache
def slopes(methods):
    """Batch of derivatives of the coupler angle to (e, spacing, deviations), of linkages that converged."""

    def angle(numbers, angle, ratio):
        found = one(*numbers, angle, ratio, methods=methods)
        return jnp.where(found.info.status == Status.CONVERGED, found.coupler_angle, 0)

    return padded(jax.grad(angle))


def batch(d1=0.0, d2=0.0, d3=0.0, d4=0.0, psi=0.0, b4=0.0, gx=0.0, gy=0.0):
    """LinkDeviations of a batch, in the order of their symbols; scalars are broadcast."""
    columns = np.broadcast_arrays(d1, d2, d3, d4, psi, b4, gx, gy)
    return jax.tree.unflatten(jax.tree.structure(LinkDeviations()), [np.array(column) for column in columns])


def columns(deviations):
    """The inverse of `batch`."""
    return jax.tree.leaves(deviations)


def linkages(cases, dtype=np.float64):
    """Inputs of the reference file in SI, stacked: the arguments of `one`."""

    def column(name, unit=1.0, default=0.0):
        return np.array([case["inputs"].get(name, default) * unit for case in cases], dtype)

    names = ["crank_1_mm", "coupler_mm", "crank_3_mm", "frame_mm"]
    lengths = [column(name, MM) for name in names]
    joint = [column("joint_x_mm", MM), column("joint_y_mm", MM)]
    deviations = batch(*lengths, column("crank_phase_rad"), column("frame_angle_rad"), *joint)
    angle, ratio = column("crank_angle_deg", np.pi / 180), column("gear_stiffness_ratio", default=1.0)
    return column("eccentricity_mm", MM), column("spacing_mm", MM), deviations, angle, ratio


def random_linkages(count, seed, size=20e-6, away=0.0):
    """Linkages of the size of an RV reducer; crank angles at least `away` rad from the dead points."""
    rng = np.random.default_rng(seed)
    d1, d2, d3, d4, gx, gy = rng.normal(0, size, (6, count))
    deviations = batch(d1, d2, d3, d4, rng.normal(0, 1e-3, count), rng.normal(0, 1e-2, count), gx, gy)
    angle = rng.uniform(away, np.pi - away, count) + np.pi * rng.integers(0, 2, count)
    ratio = np.exp(rng.uniform(np.log(0.3), np.log(100), count))
    return rng.uniform(1e-3, 3e-3, count), rng.uniform(50e-3, 120e-3, count), deviations, angle, ratio


def names(status):
    """Status names of a batch."""
    return [Status(int(value)).name for value in np.atleast_1d(status)]


def at(methods, angle, e=E, spacing=SPACING, ratio=1.0, **deviations):
    """Linkages that share everything but what is given as an array."""
    deviations = batch(**deviations)
    full = np.broadcast_arrays(e, spacing, angle, ratio, *columns(deviations))
    e, spacing, angle, ratio = (np.array(x, float) for x in full[:4])
    arguments = [np.atleast_1d(x) for x in (e, spacing)], batch(*map(np.atleast_1d, full[4:]))
    return solver(methods)(*arguments[0], arguments[1], np.atleast_1d(angle), np.atleast_1d(ratio))
