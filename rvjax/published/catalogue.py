"""Published values of makers' catalogues on rated torque and life of RV reducers, and the life of the crank bearings.

No crank bearing is published, so nothing here confirms a size. Ratios of torques and the form of a duty formula do not
depend on the bearing; the rest are inequalities with the bearings that `catalogue.toml` assumes.
"""

import math
from collections.abc import Callable
from functools import cache, partial

import numpy as np

from rvjax import catalogue, life
from rvjax.designs import Contact, RollerBearing, RVReducer, Stiffness
from rvjax.errors import RVErrors
from rvjax.units import GPa, mm, rpm

HOUR = 3600.0
RATED_LIFE, RATED_SPEED = 6000 * HOUR, 15 * rpm
TORQUE = {"rv20e": 167.0, "rv40e": 412.0, "rv42n": 412.0, "rv80e": 784.0, "rv320e": 3136.0}  # N m at 15 r/min
SPEEDS = (5.0, 10.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)  # r/min, of the table of the RV-40E besides 15
ERRORS = RVErrors()
SAMPLES = 12  # error-free machines need no more
WALL = 3.5 * mm  # of a disc round a bearing: assumed
CAGE = 1.1  # distance of neighbouring rollers over their diameter: assumed
STIFFNESS = Stiffness(  # assumed: those of the study rv-40e-whole
    sun_support=4e7, sun_torsion=1e4, planet_crank_bending=2e8, planet_crank_torsion=5e4, support_bearing=9e8,
    turning_arm_bearing=6e8, sun_planet_mesh=2e8, disc_pin_mesh=6e8,
)  # fmt: skip
CONTACT = Contact(young_modulus=206 * GPa, poisson_ratio=0.3, face_width=12 * mm)
MAKERS_DUTY = ((1000.0, 10.0, 0.2), (200.0, 20.0, 0.5), (700.0, 10.0, 0.2), (0.0, 0.0, 0.1))  # N m, r/min, s


def _nominal(design: RVReducer) -> RVReducer:
    """Without modification, with the stiffnesses and the width of discs that are assumed for the RV-40E."""
    flanks = design.cycloid.replace(equidistant_modification=0.0, shift_modification=0.0)
    return design.replace(cycloid=flanks, stiffness=STIFFNESS, contact=CONTACT)


RV_20E, RV_40E = (_nominal(design) for design in (catalogue.RV_20E, catalogue.RV_40E))
SIZES = {
    "rv20e": RV_20E,
    "rv40e": RV_40E,
    "rv80e": _nominal(catalogue.RV_80E),
    "rv320e": _nominal(catalogue.RV_320E).replace(stiffness=catalogue.RV_320E.stiffness),
}
RATIO = {"rv20e": RV_20E, "rv40e": RV_40E.replace(bearings=RV_20E.bearings)}  # ratios are free of the bearings
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
    same = _duty(((TORQUE["rv40e"], 15.0, 1.0),) * 4)
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
    assert design.bearings is not None
    return _rating_needed(design, torque) <= _rating_that_fits(design, design.bearings.arm.roller_length)


def _safe_at(size: str, factor: float, least: float) -> bool:
    """True if the crank bearings of a size have a static safety at a multiple of the rated torque."""
    duty = life.Duty([factor * TORQUE[size]], [RATED_SPEED], [1.0])
    rated = life.rating(SIZES[size], ERRORS, duty, samples=SAMPLES)
    return float(rated.static_safety) >= least and int(rated.info.status) == 0


COMPUTED: dict[str, Callable[[], float | bool | list[float]]] = {
    "catalogue.rv20e.torque_at_5": lambda: _torque_at("rv20e", 5.0),
    "catalogue.rv20e.torque_at_60": lambda: _torque_at("rv20e", 60.0),
    "catalogue.rv40e.torques": lambda: [_torque_at("rv40e", speed) for speed in SPEEDS],
    "catalogue.rv40e.duty_formula": _hours_of_duty,
    "catalogue.rv40e.bearing_fits_disc": lambda: _fits_the_disc(RV_40E, TORQUE["rv40e"]),
    "catalogue.rv320e.bearing_fits_disc": lambda: _fits_the_disc(catalogue.RV_320E, TORQUE["rv320e"]),
    "catalogue.sizes.start_stop_torque": lambda: [2.5 * TORQUE[size] for size in ("rv20e", "rv40e", "rv80e", "rv42n")],
    "catalogue.sizes.momentary_torque": lambda: [5.0 * TORQUE[size] for size in ("rv20e", "rv40e", "rv42n")],
    **{f"catalogue.{size}.start_stop_torque": partial(_safe_at, size, 2.5, 2.0) for size in SIZES},
    **{f"catalogue.{size}.momentary_torque": partial(_safe_at, size, 5.0, 1.0) for size in SIZES},
}
