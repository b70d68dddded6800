"""Random units on which the levels of the loaded model are measured, and its substitutes.

The linkage and the lost motion are levels of the whole reducer: other models that compute a part of its results.
Their simplifications limit the errors and loads for which they hold; the table lists these limits.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from rvjax.catalogue import RV_40E
from rvjax.designs import Contact, Stiffness
from rvjax.errors import RVErrors, described, read_by
from rvjax.outputs import Cases, Way
from rvjax.units import GPa, arcmin, mm, um

RATED = 412.0  # N m
# No maker prints these; they are those of the study rv-40e-whole, which a test compares.
MACHINE = RV_40E.replace(
    bearings=None,  # no output of the loaded reducer reads their ratings
    cycloid=RV_40E.cycloid.replace(equidistant_modification=-2 * um),
    stiffness=Stiffness(
        sun_support=4e7, sun_torsion=1e4, planet_crank_bending=2e8, planet_crank_torsion=5e4, support_bearing=9e8,
        turning_arm_bearing=6e8, sun_planet_mesh=2e8, disc_pin_mesh=6e8,
    ),
    contact=Contact(young_modulus=206 * GPa, poisson_ratio=0.3, face_width=12 * mm),
)  # fmt: skip


def _direction(diameter: float, **more: float) -> dict[str, float | str]:
    return dict(lower=0.0, upper=diameter / 2, distribution="rayleigh", **more)


Limits = tuple[float, float] | Mapping[str, Any]

LINKAGE: dict[str, Limits] = dict(
    crank_eccentricity=(-6.5 * um, 6.5 * um),
    crank_phase=(-5 * arcmin, 5 * arcmin),
    disc_bore=(-6.5 * um, 6.5 * um),
    carrier_bore=(-6.5 * um, 6.5 * um),
    bearing_clearance=(0.0, 3 * um),
)
"""Errors of the linkage that the four-bar model reads."""

WHOLE: dict[str, Limits] = LINKAGE | dict(
    sun_runout=_direction(10 * um),
    planet_runout=_direction(15 * um),
    base_tangent_upper=(-31 * um, 3 * um),
    base_tangent_lower=(-31 * um, 3 * um),
    support_clearance=(0.0, 2 * um),
    disc_centre=_direction(15 * um),
    disc_pitch=dict(lower=-9.5 * um, upper=9.5 * um, distribution="spectrum", spectrum=(1.0, 0.5, 0.33, 0.25, 0.2)),
    equidistant_modification=(-1 * um, 1 * um),
    shift_modification=(-3 * um, 3 * um),
    pin_offset=_direction(10 * um, batch=0.3),
    pin_radii=dict(lower=-1 * um, upper=1 * um, batch=0.3),
    pin_radius=(-2 * um, 2 * um),
    pin_circle_radius=(-5 * um, 5 * um),
    pin_hole_clearance=(0.0, 5 * um),
    ring_centre=_direction(10 * um),
)
"""Tolerances of the study rv-40e-whole."""

FIXED, FLOATING = dict(carrier="fixed", sun="fixed"), dict(carrier="floating", sun="floating")
LINEAR, RIGID = "the flattening of pins (linear pins)", "floating carrier and sun"
FOUR_BAR = "the first stage, pins and flanks with all their errors, and the yielding of all but the crank bearings"
PLAY = "load and deformation; backlash is a signed sum, in any contact sequence"
ONLY = ("float64",)


def _turn(law: str, samples: int, precisions: tuple[str, ...] = ONLY, held: dict[str, str] | None = None) -> Way:
    without = [LINEAR] if law == "linear" else []
    without += [RIGID] if held == FIXED else []
    name = ", ".join([law, f"{samples} angles", *(["all fixed"] if held == FIXED else [])])
    return Way(name, dict(pin_contact=law, samples=samples, **(held or {})), precisions, without=" and ".join(without))


def _linkage() -> Way:
    given = dict(closure=None, angles=64)
    return Way("four-bar, 64 angles", given, ONLY, {"loaded_transmission_error": "transmission_error"}, FOUR_BAR)


def cases(quick: bool) -> Sequence[Cases]:
    """A crank turn and the test bench of the RV-40E; its linkage alone; and with what floats.

    A cold start at every angle gives the same values for more time, and the first stage is a few rows of the same
    elimination: neither makes a level. A quick run takes a crank turn alone.

    Args:
        quick: fewer levels and cases.
    """
    both = ("float64", "float32")
    if quick:
        ways = (_turn("linear", 24), _linkage(), _turn("hertz", 24), _turn("hertz", 48))
        return [_cases("loaded_turn", ways, 64, 1, timed=0)]
    turns = (
        _turn("linear", 12), _turn("linear", 24), _linkage(), _turn("hertz", 24, both), _turn("hertz", 48),
        _turn("hertz", 96),
    )  # fmt: skip
    alone = (_linkage(), _turn("hertz", 24), _turn("hertz", 96))
    floating = (_turn("hertz", 24, held=FIXED), _turn("hertz", 24, held=FLOATING), _turn("hertz", 48, held=FLOATING))
    bench = (
        Way("linear", dict(pin_contact="linear"), ONLY, without=LINEAR),
        Way("lost motion, first order", dict(lost_motion_profile="first_order"), ONLY,
            {"bench_lost_motion": "lost_motion"}, PLAY),
        Way("hertz", dict(pin_contact="hertz"), ONLY),
    )  # fmt: skip
    return [
        _cases("loaded_turn", turns, 128, 2),
        _cases("loaded_linkage", alone, 128, 2, errors=LINKAGE),
        _cases("loaded_floating", floating, 128, 1, conditions=FLOATING),
        _cases(
            "loaded_bench", bench, 64, 2, outputs={"bench_lost_motion": "rad"}, torque=None,
            bounds=tuple(described(RVErrors, "bounds")),
            case="unit of the RV-40E, four input angles", conditions=FIXED | dict(input_angle=0.0),
            question=dict(rated_torque=RATED, probe_angles=4, span="crank_turn"),
        ),
    ]  # fmt: skip


def _cases(name: str, ways: tuple[Way, ...], batch: int, calls: int, **changes: object) -> Cases:
    turn = Cases(
        name=name,
        case="unit of the RV-40E, a crank revolution of the loaded reducer",
        outputs={"loaded_transmission_error": "rad", "pin_force": "N", "arm_bearing_force": "N"},
        design=MACHINE,
        errors=WHOLE,
        conditions=FIXED,
        torque=(0.1 * RATED, RATED),
        ways=ways,
        batch=batch,
        calls=calls,
        question=dict(span="crank_turn"),
        timed=1024,
    )
    made = dataclasses.replace(turn, **changes)  # type: ignore[arg-type]
    unknown = [field for field in (*read_by(RVErrors, "loaded"), *made.bounds) if field not in (made.errors or ())]
    return dataclasses.replace(made, others=(*unknown, "contact.pin_stiffness", "contact.pin_support"))
