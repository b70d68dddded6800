"""Published values of makers: torsional stiffness of each size, rated torque, and the life of the crank bearings.

Stiffness: two numbers of the model are calibrated on one size: the springs of the RV-40E (`rv-40e-whole`, assumed) get
a common factor. Every other size is the RV-40E with all lengths times the cube root of the ratio of rated torques, and
with the springs that follow them by the scaling laws of another size. Teeth and cranks of the other sizes are those of
the RV-40E.

Life: no crank bearing is published, so nothing here confirms a size. Ratios of torques and the form of a duty formula
do not depend on the bearing; the rest are inequalities with the bearings that `catalogue.toml` assumes.
"""

import math
from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from rvjax import catalogue, life, loaded, lost_motion, study, tolerances
from rvjax.designs import RollerBearing, RVReducer
from rvjax.errors import RVErrors
from rvjax.records import PyTree
from rvjax.units import arcmin, mm, rpm

TORQUE = {"20e": 167.0, "40e": 412.0, "42n": 412.0, "80e": 784.0, "110e": 1078.0, "160e": 1568.0, "320e": 3136.0}
"""Rated torque at 15 r/min, N m."""
WEIGHT = {"20e": 4.7, "40e": 9.3, "80e": 13.1, "110e": 17.4, "160e": 26.4, "320e": 44.3}
"""Published weight, kg."""
STEEL = 7850.0
"""Density, kg/m3."""
PUBLISHED = 108.0
"""Torsional stiffness of the RV-40E, N m/arcmin: what the springs are calibrated on."""
LENGTHS = ("cycloid.pin_circle_radius", "involute.module")
"""Lengths that all other numbers follow by the scaling laws of another size, as in `rvjax init`."""


@cache
def _study() -> study.Study:
    return study.load("rv-40e-whole", solve=False)


def similar(torque: float) -> RVReducer:
    """RV-40E with all lengths times the cube root of the ratio of torques: equal stresses.

    Args:
        torque: rated torque of the size, N m.
    """
    ratio = (torque / TORQUE["40e"]) ** (1 / 3)
    base = _study().design
    design: RVReducer = study.scaled(base, {path: ratio * study.number_at(base, path) for path in LENGTHS}, whole=True)
    return design


def _secant(design: RVReducer, torque: float) -> float:
    """Between half and full rated torque, N m/arcmin; without errors of parts."""
    curve = loaded.torsion(design, RVErrors(), input_angle=0.0, rated_torque=torque)
    return float(curve.stiffness) * arcmin


@cache
def factor() -> float:
    """Factor on the springs of the RV-40E with which it is as stiff as published."""
    log = brentq(
        lambda x: _secant(similar(TORQUE["40e"]).stiffer(math.exp(x)), TORQUE["40e"]) - PUBLISHED, -3, 3, xtol=1e-6
    )
    return math.exp(log)


def stiffness(size: str) -> float:
    """Torsional stiffness of a size, N m/arcmin, with the springs calibrated on the RV-40E.

    Args:
        size: of `TORQUE`.
    """
    return _secant(similar(TORQUE[size]).stiffer(factor()), TORQUE[size])


def disc_mass(size: str) -> float:
    """Mass of the discs of a similar reducer, steel without holes, kg.

    Args:
        size: of `TORQUE`.
    """
    design = similar(TORQUE[size])
    assert design.contact is not None
    radius = float(design.cycloid.pin_circle_radius - design.cycloid.pin_radius)
    return design.cycloid.disc_count * math.pi * radius**2 * float(design.contact.face_width) * STEEL


def _weights() -> bool:
    """True if every size weighs two to six times its discs."""
    return all(2 < WEIGHT[size] / disc_mass(size) < 6 for size in WEIGHT)


def _lost_motion() -> bool:
    """True if nineteen of twenty units of the study rv-40e lose at most the published arcminute."""
    question = study.load("rv-40e", solve=False)
    errors = tolerances.sample(question.tolerances, 4096, seed=0)
    units, across = jax.tree.map(jnp.asarray, errors), jax.tree.map(lambda x: 0 if np.ndim(x) else None, errors)
    total = jax.vmap(lambda unit: lost_motion.geometric(question.design, unit).total, (across,))(units)
    return float(np.mean(np.abs(np.asarray(total)) <= 1 * arcmin)) > 0.95


COMPUTED: dict[str, Callable[[], PyTree]] = {
    **{f"sizes.rv{size}.stiffness": partial(stiffness, size) for size in TORQUE if size != "320e"},
    "sizes.rv320e.stiffness": lambda: stiffness("320e") < 980.0 < 1.5 * stiffness("320e"),  # two discs or three
    "sizes.rv40e.lost_motion": _lost_motion,
    "sizes.weight": _weights,
}


HOUR = 3600.0
RATED_LIFE, RATED_SPEED = 6000 * HOUR, 15 * rpm
SPEEDS = (5.0, 10.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)  # r/min, of the table of the RV-40E besides 15
ERRORS = RVErrors()
SAMPLES = 12  # error-free machines need no more
WALL = 3.5 * mm  # of a disc round a bearing: assumed
CAGE = 1.1  # distance of neighbouring rollers over their diameter: assumed
STIFFNESS, CONTACT = loaded.MACHINE.stiffness, loaded.MACHINE.contact  # assumed: those of the study rv-40e-whole
MAKERS_DUTY = ((1000.0, 10.0, 0.2), (200.0, 20.0, 0.5), (700.0, 10.0, 0.2), (0.0, 0.0, 0.1))  # N m, r/min, s


def _nominal(design: RVReducer) -> RVReducer:
    """Without modification, with the stiffnesses and the width of discs that are assumed for the RV-40E."""
    flanks = design.cycloid.replace(equidistant_modification=0.0, shift_modification=0.0)
    return design.replace(cycloid=flanks, stiffness=STIFFNESS, contact=CONTACT)


RV_20E, RV_40E = (_nominal(design) for design in (catalogue.RV_20E, catalogue.RV_40E))
SIZES = {
    "20e": RV_20E,
    "40e": RV_40E,
    "80e": _nominal(catalogue.RV_80E),
    "320e": _nominal(catalogue.RV_320E).replace(stiffness=catalogue.RV_320E.stiffness),
}
RATIO = {"20e": RV_20E, "40e": RV_40E.replace(bearings=RV_20E.bearings)}  # ratios are free of the bearings
ARM = RollerBearing(14, 6 * mm, 11 * mm, 32 * mm)  # its load is free of its size


@cache
def _torque(size: str, speed: float) -> float:
    """Torque for the rated life at a speed in r/min, without errors."""
    rated = life.rated_torque(RATIO[size], ERRORS, life=RATED_LIFE, output_speed=speed * rpm, samples=SAMPLES)
    return float(rated.torque)


def _torque_at(size: str, speed: float) -> float:
    """Published torque at 15 r/min times the ratio of the computed torques."""
    return TORQUE[size] * _torque(size, speed) / _torque(size, 15.0)


def _duty(phases: tuple[tuple[float, float, float], ...]) -> life.Duty:
    torque, speed, time = np.asarray(phases).T
    return life.Duty(torque, speed * rpm, time)


def _hours_of_duty() -> float:
    """Life in motion, h, of a reducer that lasts 6000 h at its rated torque and 15 r/min; linear pins."""
    same = _duty(((TORQUE["40e"], 15.0, 1.0),) * 4)
    lives = [
        life.rating(RV_40E, ERRORS, duty, samples=SAMPLES, contact="linear").life for duty in (_duty(MAKERS_DUTY), same)
    ]
    moving = sum(time for _, speed, time in MAKERS_DUTY if speed) / sum(time for *_, time in MAKERS_DUTY)
    return 6000 * moving * float(lives[0] / lives[1])


def _rating_needed(design: RVReducer, torque: float) -> float:
    """Least C of an arm bearing, N, for the rated life of all of them, without errors.

    The force has a part M/(c R), fixed in the carrier, and a part M/(c e zc), which turns with the crank; what pins
    press along the eccentric only adds to it.
    """
    cycloid, gears, cranks = design.cycloid, design.involute, design.cranks
    moment = torque * cycloid.disc_teeth
    moment /= cycloid.disc_count * (cycloid.pin_count + gears.sun_teeth / gears.planet_teeth)
    fixed = moment / (cranks.count * cranks.circle_radius)
    turning = moment / (cranks.count * cycloid.eccentricity * cycloid.disc_teeth)
    angle = 2 * np.pi * np.arange(48) / 48
    force = np.stack([fixed + turning * np.cos(angle), turning * np.sin(angle)], axis=-1)
    load = float(life.bearing_life(ARM, force).load)
    revolutions = RATED_LIFE * RATED_SPEED / (2 * np.pi) * cycloid.pin_count
    bearings = cycloid.disc_count * cranks.count
    return float(load * (revolutions * bearings ** (8 / 9) / 1e6) ** 0.3)


def _rating_that_fits(design: RVReducer, length: float) -> float:
    """Largest C of a caged row between crank and flank of a disc, N; rollers of a length in m."""
    cycloid = design.cycloid
    reach = cycloid.pin_circle_radius - cycloid.pin_radius - 2 * cycloid.eccentricity - design.cranks.circle_radius
    outside = 2 * (reach - WALL)
    strongest = 0.0
    for diameter in np.arange(3, 16, 0.5) * mm:
        circle = outside - diameter
        rollers = math.floor(math.pi / math.asin(min(CAGE * diameter / circle, 1.0)))
        if rollers >= 3:
            row = RollerBearing(rollers, diameter, length, circle)
            strongest = max(strongest, float(life.dynamic_rating(row)))
    return strongest


def _fits_the_disc(design: RVReducer, torque: float) -> bool:
    """True if the rating for 6000 h of all arm bearings fits a caged row between crank and flank."""
    assert design.bearings is not None and isinstance(design.bearings.arm, RollerBearing)
    return _rating_needed(design, torque) <= _rating_that_fits(design, design.bearings.arm.roller_length)


def _safe_at(size: str, factor: float, least: float) -> bool:
    """True if the crank bearings of a size have a static safety at a multiple of the rated torque."""
    duty = life.Duty([factor * TORQUE[size]], [RATED_SPEED], [1.0])
    rated = life.rating(SIZES[size], ERRORS, duty, samples=SAMPLES)
    return float(rated.static_safety) >= least and int(rated.info.status) == 0


COMPUTED |= {
    "catalogue.rv20e.torque_at_5": lambda: _torque_at("20e", 5.0),
    "catalogue.rv20e.torque_at_60": lambda: _torque_at("20e", 60.0),
    "catalogue.rv40e.torques": lambda: [_torque_at("40e", speed) for speed in SPEEDS],
    "catalogue.rv40e.duty_formula": _hours_of_duty,
    "catalogue.rv40e.bearing_fits_disc": lambda: _fits_the_disc(RV_40E, TORQUE["40e"]),
    "catalogue.rv320e.bearing_fits_disc": lambda: _fits_the_disc(catalogue.RV_320E, TORQUE["320e"]),
    "catalogue.sizes.start_stop_torque": lambda: [2.5 * TORQUE[size] for size in ("20e", "40e", "80e", "42n")],
    "catalogue.sizes.momentary_torque": lambda: [5.0 * TORQUE[size] for size in ("20e", "40e", "42n")],
    **{f"catalogue.rv{size}.start_stop_torque": partial(_safe_at, size, 2.5, 2.0) for size in SIZES},
    **{f"catalogue.rv{size}.momentary_torque": partial(_safe_at, size, 5.0, 1.0) for size in SIZES},
}
