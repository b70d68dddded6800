"""Shared pieces of the tests of whole reducers: compiled functions, designs, random errors of units."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import CrankStage, CycloidStage, InvoluteStage, RVErrors, RVReducer, four_bar
from rvjax.units import mm, um

STATIC = ("angles", "cranks", "closure", "branch")
USUAL = dict(cranks="phase_locked", branch="open")  # said in every call: left out, it would be another program
_revolution = jax.jit(four_bar.revolution, static_argnames=STATIC)
_transmission_error = jax.jit(four_bar.transmission_error, static_argnames=STATIC[1:])
READ = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance", "eccentricity")


def numbers(tree, dtype=float):
    """Every number as an array of one precision, so that tests share programs."""
    return jax.tree.map(lambda x: np.asarray(x, dtype), tree)


def revolution(design, errors, output_torque=None, dtype=float, **methods):
    """A turn of one unit; with no torque the program without load."""
    given = {} if output_torque is None else {"output_torque": output_torque}
    design, errors, given = numbers((design, errors, given), dtype)
    return jax.tree.map(np.asarray, _revolution(design, errors, **given, **USUAL | methods))


def transmission_error(design, errors, *, crank_angle, output_torque=0.0, dtype=float, ratio=None, **methods):
    """The error of one unit at one angle, by the program with load."""
    design, errors, angle, torque, ratio = numbers((design, errors, crank_angle, output_torque, ratio), dtype)
    given = dict(crank_angle=angle, output_torque=torque, gear_stiffness_ratio=ratio)
    return jax.tree.map(
        np.asarray, _transmission_error(design, errors, **given, **USUAL | dict(closure="newton") | methods)
    )


def reducer(cranks=2, discs=2, e=1.3 * mm, radius=36 * mm, stiffness=6e8, teeth=(10, 26, 39, 40), pins=64 * mm):
    """A reducer of the size of the RV-40E."""
    return RVReducer(
        InvoluteStage.from_teeth(teeth[0], teeth[1], module=2 * mm),
        CycloidStage(teeth[2], teeth[3], discs, e, pins, 3 * mm),
        CrankStage(cranks, radius, stiffness),
    )


def referenced(case, dtype=np.float64):
    """Design and errors of a case of the reference file."""
    d = case["design"]
    design = reducer(
        d["cranks"],
        d["discs"],
        d["eccentricity_mm"] * mm,
        d["crank_circle_radius_mm"] * mm,
        d["bearing_stiffness_N_per_mm"] / mm,
        (d["sun_teeth"], d["planet_teeth"], d["disc_teeth"], d["pin_count"]),
        d["pin_circle_radius_mm"] * mm,
    )
    errors = {n: np.asarray(v) * (1 if n == "crank_phase" else mm) for n, v in case["errors_mm_rad"].items()}
    return design, numbers(RVErrors.for_design(design, **errors), dtype)


def disc_couple(design, torque):
    """Couple of one disc on its crank pins: its share of the torque without what pins and sun do by the arm e.

    The carrier's turn works against pins, at the pitch radius e zp, and against the sun, through z1/z2 of it.
    """
    disc, sun = design.cycloid, design.involute.sun_teeth / design.involute.planet_teeth
    return torque / disc.disc_count * (1 - (1 + sun) / (disc.pin_count + sun))


def drawn(design, seed, size=10 * um, units=None):
    """Random errors of one unit, or of many along the last axis."""
    rng, counts = np.random.default_rng(seed), design.counts
    c, d, last = counts["cranks"], counts["discs"], () if units is None else (units,)
    values = dict(
        crank_eccentricity=rng.normal(0, size, (d, c, *last)),
        crank_phase=rng.normal(0, 1e-4, (c, *last)),
        disc_bore=rng.normal(0, size, (d, c, 2, *last)),
        carrier_bore=rng.normal(0, size, (c, 2, *last)),
        bearing_clearance=np.abs(rng.normal(0, size, last)),
        eccentricity=rng.normal(0, size, last),
    )
    blank = RVErrors.for_design(design)
    leaves, tree = jax.tree.flatten_with_path(blank)
    full = [np.zeros((*np.shape(leaf), *last)) + values.get(path[0].name, 0) for path, leaf in leaves]
    return tree.unflatten(map(jnp.asarray, full))


def changed(errors, **changes):
    """A batch with some fields changed; constructors take one case only."""
    leaves, tree = jax.tree.flatten_with_path(errors)
    return tree.unflatten([jnp.asarray(changes.get(path[0].name, leaf)) for path, leaf in leaves])
