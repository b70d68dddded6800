"""Designs and errors of the reference cases of the single-stage drive."""

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
from loaded_cases import newton_alone

from rvjax import Contact, CycloidalErrors, CycloidalReducer, CycloidalStiffness, CycloidStage, OutputPins, loaded
from rvjax.loaded import unchecked

CASES = json.loads((Path(__file__).parent / "reference" / "single_stage.json").read_text())["cases"]
NAMED = {case["name"]: case for case in CASES}
PARTS = {"cycloid": CycloidStage, "output": OutputPins, "stiffness": CycloidalStiffness, "contact": Contact}


def design_of(given):
    """The drive of nested dictionaries."""
    parts = {name: cls(**given[name]) for name, cls in PARTS.items()}
    return CycloidalReducer(**parts, member=given["member"])


def drive_of(given):
    """The drive of nested dictionaries; numbers that a constructor refuses come from a traced computation."""
    try:
        return design_of(given)
    except ValueError:
        possible = {"eccentricity": 1e-6, "pin_radius": 1e-6}
        drive = design_of(
            given | {"cycloid": given["cycloid"] | possible, "output": given["output"] | {"hole_clearance": 0}}
        )
        parts = {part: unchecked(getattr(drive, part), **given[part]) for part in ("cycloid", "output")}
        return unchecked(drive, **parts)


def errors_of(given):
    return CycloidalErrors(**{name: np.asarray(v) if np.ndim(v) else v for name, v in given.items()})


def placed(design, errors=None):
    """Design and errors as arrays, errors at every place: cases of one size share a program."""
    errors, whole = CycloidalErrors() if errors is None else errors, {}
    for f in dataclasses.fields(errors):
        shape = [size if isinstance(size, int) else design.counts[size] for size in f.metadata["shape"]]
        whole[f.name] = np.broadcast_to(np.asarray(getattr(errors, f.name), float), shape)
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), design), unchecked(errors, **whole)


def dictionaries(design):
    """The same for the oracle."""
    return {"member": design.member} | {name: vars(getattr(design, name)) for name in PARTS}


def drawn(rng, sizes, size=5e-6):
    """Every error that a constructor accepts, with its place: (discs, pins, teeth, output pins)."""
    d, p, z, n = sizes
    shapes = {
        "eccentricity": (), "pin_circle_radius": (), "pin_radius": (), "equidistant_modification": (),
        "shift_modification": (), "pin_offset": (p, 2), "pin_radii": (p,), "ring_centre": (2,), "disc_centre": (d, 2),
        "disc_pitch": (d, z), "disc_profile": (d, 5, 2), "throw": (d,), "hole_position": (d, n, 2),
        "hole_radius": (d, n), "output_pin_offset": (n, 2), "output_pin_radius": (n,), "shaft_centre": (2,),
        "carrier_centre": (2,),
    }  # fmt: skip
    errors = {name: size * rng.standard_normal(shape) for name, shape in shapes.items()}
    return errors | {"eccentric_phase": 2e-3 * rng.standard_normal(d), "pin_hole_clearance": size}


LANES = 8
SAMPLES = 6  # of a fit


@jax.jit
@jax.vmap
@newton_alone()
def lanes(design, errors, angle, torque):
    """Slopes of the error of Hertzian cases to all their numbers, and the equilibria."""

    def error(given):
        design, errors, angle, torque = given
        found = loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque)
        return found.error, found

    return jax.grad(error, has_aux=True)((design, errors, angle, torque))


def by_lanes(program, cases):
    """What a program of eight cases (slopes, results) gives for as many or fewer: (results, slopes) of each."""
    alike = [*cases, *cases[-1:] * (LANES - len(cases))]
    slopes, found = jax.device_get(program(*jax.tree.map(lambda *leaves: np.stack(leaves), *alike)))
    return [jax.tree.map(lambda leaf, k=k: leaf[k], (found, slopes)) for k in range(len(cases))]


def solve_with_slopes(*cases):
    """Up to eight cases (design, errors, angle, torque) of one size, and their slopes, by one program."""
    return by_lanes(lanes, [jax.tree.map(lambda leaf: np.asarray(leaf, float), case) for case in cases])


def solve(*cases):
    """Equilibria of up to eight cases."""
    return [found for found, _ in solve_with_slopes(*cases)]


@jax.jit
@jax.vmap
def fit_lanes(design, errors, way):
    """Slope of the fit at input angle 0 along a way of the errors, and the fit."""

    def first(errors):
        found = loaded.clearance(design, errors, samples=SAMPLES)
        return found.at[0], found

    _, slope, found = jax.jvp(first, (errors,), (way,), has_aux=True)
    return slope, found


def fits_with_slopes(*cases):
    """Fits of up to eight cases (design, errors, way of the errors) of one size, and slopes, by one program.

    Their `shortening`, which no fit reads, is NaN.
    """
    given = []
    for design, errors, way in cases:
        design = unchecked(design, cycloid=unchecked(design.cycloid, shortening=np.nan))
        given.append((*placed(design, errors), placed(design, way)[1]))
    return by_lanes(fit_lanes, given)


def fits(*cases):
    """Fits without load of up to eight cases (design, errors)."""
    return [found for found, _ in fits_with_slopes(*((*case, None) for case in cases))]
