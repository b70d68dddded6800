"""Published values of makers' catalogues on rated torque and life of RV reducers, and the life of the crank bearings.

No crank bearing is published, so nothing here confirms a size. Ratios of torques and the form of a duty formula do not
depend on the bearing; the rest are inequalities with the bearings that `catalogue.toml` assumes.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from rvjax import catalogue, life
from rvjax.designs import Contact, RollerBearing, RVReducer, Stiffness
from rvjax.errors import RVErrors
from rvjax.units import GPa, mm, rpm

HOUR = 3600.0
RATED_LIFE, RATED_SPEED = 6000 * HOUR, 15 * rpm
TORQUE = {"rv20e": 167.0, "rv40e": 412.0}  # N m at 15 r/min
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
ARMS = RV_40E.replace(bearings=RV_40E.bearings.replace(support=None) if RV_40E.bearings else None)


@cache
def _torque_ratio(speed: float) -> float:
    """Rated torque at a speed, r/min, times the published torque at 15 over the one computed there."""
    found = [
        life.rated_torque(RV_20E, ERRORS, life=RATED_LIFE, output_speed=n * rpm, samples=SAMPLES).torque
        for n in (speed, 15.0)
    ]
    return TORQUE["rv20e"] * float(found[0] / found[1])


def _duty(phases: tuple[tuple[float, float, float], ...]) -> life.Duty:
    torque, speed, time = np.asarray(phases).T
    return life.Duty(torque, speed * rpm, time)


def _hours_of_duty() -> float:
    """Life in motion, h, of a reducer that lasts 6000 h at its rated torque and 15 r/min; linear pins."""
    same = _duty(((TORQUE["rv40e"], 15.0, 1.0),) * 4)
    found = [
        life.rating(RV_40E, ERRORS, duty, samples=SAMPLES, contact="linear").life for duty in (_duty(MAKERS_DUTY), same)
    ]
    moving = sum(time for _, speed, time in MAKERS_DUTY if speed) / sum(time for *_, time in MAKERS_DUTY)
    return 6000 * moving * float(found[0] / found[1])


@cache
def _arms_rated() -> life.Rating:
    return life.rating(ARMS, ERRORS, life.Duty([TORQUE["rv40e"]], [RATED_SPEED], [1.0]), samples=SAMPLES)


def _fits_the_disc() -> bool:
    """True if the rating for 6000 h of all arm bearings fits a caged row between crank and flank."""
    cycloid, arm = RV_40E.cycloid, RV_40E.bearings.arm  # type: ignore[union-attr]
    need = float(life.dynamic_rating(arm)) * float(RATED_LIFE / _arms_rated().life) ** 0.3
    reach = cycloid.pin_circle_radius - cycloid.pin_radius - 2 * cycloid.eccentricity - RV_40E.cranks.circle_radius
    outside = 2 * (reach - WALL)
    strongest = 0.0
    for diameter in np.arange(3, 12, 0.5) * mm:
        circle = outside - diameter
        rollers = math.floor(math.pi / math.asin(min(CAGE * diameter / circle, 1.0)))
        if rollers >= 3:
            row = RollerBearing(rollers, diameter, arm.roller_length, circle)
            strongest = max(strongest, float(life.dynamic_rating(row)))
    return need <= strongest


def _safe_at(factor: float, least: float) -> bool:
    """True if the crank bearings of the RV-40E have a static safety at a multiple of the rated torque."""
    duty = life.Duty([factor * TORQUE["rv40e"]], [RATED_SPEED], [1.0])
    found = life.rating(RV_40E, ERRORS, duty, samples=SAMPLES)
    return float(found.static_safety) >= least and int(found.info.status) == 0


COMPUTED: dict[str, Callable[[], Any]] = {
    "catalogue.rv20e.torque_at_5": lambda: _torque_ratio(5.0),
    "catalogue.rv20e.torque_at_60": lambda: _torque_ratio(60.0),
    "catalogue.rv40e.duty_formula": _hours_of_duty,
    "catalogue.rv40e.bearing_fits_disc": _fits_the_disc,
    "catalogue.rv40e.start_stop_torque": lambda: _safe_at(2.5, 2.0),
    "catalogue.rv40e.momentary_torque": lambda: _safe_at(5.0, 1.0),
}
