"""Comparison of the low-fidelity models of a reducer with the loaded equilibrium.

    python -m benchmarks.loaded_against_models [--oracle] [--json FILE]

four_bar for every pattern of crank errors, for bores and phases, with and without clearance; lost_motion term by term;
dynamics.static for stiffness and gear forces. Stiffnesses and face widths of the RV-40E and RV-20E are assumed, so the
figures are of the models. `--oracle` takes every equilibrium from the independent NumPy model instead.
"""

import argparse
import functools
import sys
from pathlib import Path

import numpy as np

from benchmarks.timing import publish, settings

settings()

import jax  # noqa: E402  (after the flags)
import jax.numpy as jnp  # noqa: E402

from rvjax import RVErrors, catalogue, dynamics, four_bar, lost_motion  # noqa: E402
from rvjax.designs import Contact, Stiffness  # noqa: E402
from rvjax.loaded.cases import MACHINE  # noqa: E402
from rvjax.units import arcmin, arcsec, mm, um  # noqa: E402
from tests.oracles import loaded as oracle  # noqa: E402
from tests.oracles.loaded_machine import ERRORS  # noqa: E402

ANGLES = 32  # of a crank turn
STEEL = dict(young_modulus=206e9, poisson_ratio=0.3)
RV_40E = catalogue.RV_40E.replace(stiffness=MACHINE.stiffness, contact=MACHINE.contact)
RV_20E = catalogue.RV_20E.replace(
    stiffness=Stiffness(
        sun_support=3e7, sun_torsion=6e3, planet_crank_bending=1.5e8, planet_crank_torsion=3e4, support_bearing=7e8,
        turning_arm_bearing=4.5e8, sun_planet_mesh=1.5e8, disc_pin_mesh=4e8,
    ),
    contact=Contact(**STEEL, face_width=9 * mm),
)  # fmt: skip
RV_320E = catalogue.RV_320E.replace(contact=Contact(**STEEL, face_width=20 * mm))
RATED = {"RV-40E": 412.0, "RV-20E": 167.0, "RV-320E": 3136.0}


@functools.partial(jax.jit, static_argnames=("contact", "sun"))
def solved(design, errors, angles, torque, contact, sun):
    from rvjax import loaded

    return jax.vmap(
        lambda angle: loaded.equilibrium(
            design, errors, input_angle=angle, output_torque=torque, contact=contact, sun=sun
        )
    )(angles)


def with_rvjax(design, errors, angles, torque, contact="hertz", sun="fixed"):
    """Error and gear forces at each angle."""
    full = RVErrors.for_design(design, **errors)
    found = solved(design, full, jnp.asarray(angles, float), float(torque), contact, sun)
    if np.any(np.asarray(found.info.status) != 0):
        raise RuntimeError(f"not converged: {errors}")
    return {"error": np.asarray(found.error), "gear": np.asarray(found.gear)}


def with_oracle(design, errors, angles, torque, contact="hertz", sun="fixed"):
    """The same from the independent model."""
    angles = np.atleast_1d(np.asarray(angles, float))
    shape = {"d": design.cycloid.disc_count, "c": design.cranks.count}
    whole = {n: np.broadcast_to(v, tuple(shape.get(axis, 2) for axis in ERRORS[n])) for n, v in errors.items()}
    one = {name: np.array(np.broadcast_to(value, (len(angles), *np.shape(value)))) for name, value in whole.items()}
    return oracle.equilibria(
        design, one, len(angles), input_angle=angles, output_torque=torque, contact=contact, sun=sun
    )  # fmt: skip


def ratio_of(design):
    return 1 + design.cycloid.pin_count * design.involute.planet_teeth / design.involute.sun_teeth


def factor(design):
    """Of a disc that holds the sun, not itself: zc / (zp + z1 / z2)."""
    involute, cycloid = design.involute, design.cycloid
    return cycloid.disc_teeth / (cycloid.pin_count + involute.sun_teeth / involute.planet_teeth)


def crank_turn(design):
    """Input angles of one crank turn."""
    return 2 * np.pi * ratio_of(design) / design.cycloid.pin_count * np.arange(ANGLES) / ANGLES


def linkage(errors, angles):
    """four_bar, phase-locked, unloaded, at the same places: the eccentrics run backwards zp times a turn."""
    pins, ratio = RV_40E.cycloid.pin_count, ratio_of(RV_40E)
    full = RVErrors.for_design(RV_40E, **errors)
    found = jax.vmap(lambda angle: four_bar.transmission_error(RV_40E, full, crank_angle=-pins * angle / ratio))
    return np.asarray(found(jnp.asarray(angles)).error)


def against_four_bar(solve):
    """Slopes of the loaded error over that of four_bar x the factor; errors that four_bar does not see."""
    angles, torque = crank_turn(RV_40E), RATED["RV-40E"]
    play = {"bearing_clearance": 2 * um, "support_clearance": 1 * um}
    patterns = {
        "one": [[1, 0], [0, 0]], "cranks apart": [[1, -1], [0, 0]],
        "cranks apart, discs apart": [[1, -1], [-1, 1]], "three": [[1, 0.5], [-0.3, 0]],
    }  # fmt: skip
    figures = {}
    for label, loose in (("no clearance", {}), ("clearance", play)):
        base = solve(RV_40E, loose, angles, torque)["error"]
        for name, pattern in patterns.items():
            errors = {"crank_eccentricity": 5 * um * np.array(pattern)}
            alone = factor(RV_40E) * linkage(errors, angles)
            change = solve(RV_40E, {**errors, **loose}, angles, torque)["error"] - base
            figures[f"crank eccentricity {name}, {label}: slope"] = float(change @ alone / (alone @ alone))
    base = solve(RV_40E, {}, angles, torque)["error"]
    bore, carrier = np.zeros((2, 2, 2)), np.zeros((2, 2))
    bore[0, 0, 0], carrier[0, 1] = 10 * um, 10 * um
    for name, errors in (
        ("one bore of one disc 10 um radial", {"disc_bore": bore}),
        ("common phase 1 mrad", {"crank_phase": 1e-3}),
        ("one carrier bore 10 um tangential", {"carrier_bore": carrier}),
    ):
        change, alone = solve(RV_40E, errors, angles, torque)["error"] - base, linkage(errors, angles)
        for model, curve in (("loaded", change), ("four_bar", alone)):
            figures[f"{name}, {model}: mean, arcsec"] = float(curve.mean() / arcsec)
            figures[f"{name}, {model}: peak to peak, arcsec"] = float(np.ptp(curve) / arcsec)
    # unloaded: the limit of small torque, in the play of the pins; the leading disc alone sets the angle
    probe, loose = 1e-3 * torque, {"equidistant_modification": 10 * um}
    base = solve(RV_40E, loose, angles, probe)["error"]
    for name, pattern in (("crank 0 of both discs", [[1, 0], [1, 0]]), ("crank 0 of disc 0", [[1, 0], [0, 0]])):
        errors = {"crank_eccentricity": 10 * um * np.array(pattern)}
        change = solve(RV_40E, {**errors, **loose}, angles, probe)["error"] - base
        alone = factor(RV_40E) * linkage(errors, angles)
        figures[f"unloaded, {name} 10 um, loaded: peak to peak, arcsec"] = float(np.ptp(change) / arcsec)
        figures[f"unloaded, {name} 10 um, four_bar: peak to peak, arcsec"] = float(np.ptp(alone) / arcsec)
    stiff = four_bar.transmission_error(RV_40E, RVErrors(), crank_angle=1.0, output_torque=torque)
    rigid = four_bar.transmission_error(RV_40E, RVErrors(), crank_angle=1.0)
    figures["wind-up at rated torque, four_bar, arcsec"] = float((stiff.error - rigid.error) / arcsec)
    figures["wind-up at rated torque, loaded, arcsec"] = float(
        solve(RV_40E, {}, [102.856], torque)["error"][0] / arcsec
    )  # fmt: skip
    return figures


def against_lost_motion(solve):
    """Backlash that each error adds, over what its term of lost_motion adds; and the sum of Table 9."""
    angles, probe = crank_turn(RV_20E)[::4], 1e-3 * RATED["RV-20E"]
    cycloid, involute = RV_20E.cycloid.replace(shortening=None), RV_20E.involute
    teeth = involute.sun_teeth / (involute.sun_teeth + involute.planet_teeth)
    # Radii that mesh, and K1 that follows from them: what Table 8 prints contradicts its own lengths.
    whole = RV_20E.replace(involute=involute.replace(sun_radius=involute.centre_distance * teeth), cycloid=cycloid)
    plain = whole.replace(cycloid=cycloid.replace(equidistant_modification=0.0, shift_modification=0.0))

    def backlash(design, errors):
        ends = [solve(design, errors, angles, sign * probe, "linear")["error"] for sign in (-1, 1)]
        return ends[0] - ends[1]

    def formula(design, errors):
        return float(lost_motion.geometric(design, RVErrors.for_design(design, **errors)).total)

    figures = {"zc / (zp + z1 / z2)": factor(RV_20E)}
    wide = {"equidistant_modification": 20 * um}  # play enough for every pin that carries at the probe to be the same
    before, alone = backlash(plain, wide), formula(plain, wide)
    for name, size in (
        ("base_tangent_upper", -20 * um), ("equidistant_modification", 5 * um), ("shift_modification", -5 * um),
        ("pin_circle_radius", 5 * um), ("pin_radius", -5 * um), ("pin_hole_clearance", 5 * um),
        ("bearing_clearance", 5 * um),
    ):  # fmt: skip
        errors = {**wide, name: wide.get(name, 0.0) + size}
        part = (backlash(plain, errors) - before) / (formula(plain, errors) - alone)
        figures[f"{name}: loaded / lost_motion, least"] = float(part.min())
        figures[f"{name}: loaded / lost_motion, most"] = float(part.max())
    table = {n: float(getattr(catalogue.RV_20E_ERRORS, n)) for n in PLAY}
    figures["Table 9, loaded, mean, arcmin"] = float(backlash(whole, table).mean() / arcmin)
    figures["Table 9, lost_motion, the same errors, arcmin"] = formula(whole, table) / arcmin
    return figures


# Errors of Table 9 that have a place in the loaded model; the three bounds without one are left out of both.
PLAY = ("bearing_clearance", "eccentricity", "pin_circle_radius", "pin_radius", "pin_hole_clearance",
        "equidistant_modification", "shift_modification", "base_tangent_upper", "base_tangent_lower")  # fmt: skip


def against_static(solve):
    """Stiffness of the RV-320E compared with `dynamics.static`, and the largest difference of gear forces."""
    torque = RATED["RV-320E"]
    found = dynamics.static(RV_320E, output_torque=-torque)
    turned = -float(found.deflection[-1])
    design = RV_320E
    angles = 2 * np.pi * ratio_of(design) / design.cycloid.pin_count * np.arange(8) / 8
    figures = {"RV-320E, dynamics.static, N m / arcmin": torque / abs(turned) * arcmin}
    for contact in ("linear", "hertz"):
        one = solve(design, {}, angles, torque, contact, "floating")
        figures[f"RV-320E, loaded {contact}, mean, N m / arcmin"] = float(np.mean(torque / -one["error"]) * arcmin)
    gears = np.abs(np.asarray(found.planetary_force))
    gap = np.abs(np.abs(solve(design, {}, angles, torque, "linear", "floating")["gear"]) - gears)
    figures["RV-320E, gear forces, largest difference over mean"] = float(gap.max() / gears.mean())
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--oracle", action="store_true", help="equilibria of the independent model")
    options = parser.parse_args()
    solve = with_oracle if options.oracle else with_rvjax
    figures = {"from": "oracle" if options.oracle else "rvjax.loaded"}
    for part in (against_four_bar, against_lost_motion, against_static):
        figures |= part(solve)
        print(f"{part.__name__} done", file=sys.stderr)
    publish("loaded_against_models", figures, options.json)


if __name__ == "__main__":
    main()
