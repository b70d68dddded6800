"""Outputs of the lost-motion model for studies."""

from collections.abc import Sequence
from dataclasses import dataclass

from rvjax.catalogue import RV_20E
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.lost_motion.reducer import PROFILES, geometric
from rvjax.outputs import KNOWN_ERROR, Cases, Description, Output, Solved, Way, condition
from rvjax.units import um


@dataclass(frozen=True)
class LostMotionConditions:
    """Method of the free angle."""

    lost_motion_profile: str = condition("first_order", "of the backlash between flanks and pins", choices=PROFILES)


def _lost_motion(design: RVReducer, errors: RVErrors, conditions: LostMotionConditions) -> Solved:
    result = geometric(design, errors, profile=conditions.lost_motion_profile)
    return result.total, result.info.status


FLANK = dict(  # Table 9 of Liu et al. 2022
    bearing_clearance=(0.0, 1 * um),
    eccentricity=(-5 * um, 5 * um),
    pin_circle_radius=(-10 * um, 10 * um),
    pin_radius=(-4 * um, 4 * um),
    pin_hole_clearance=(0.0, 5 * um),
    pin_position=(-5 * um, 5 * um),
    disc_runout=(0.0, 15 * um),
    disc_cumulative_pitch=(0.0, 19 * um),
    equidistant_modification=(-1 * um, 1 * um),
    shift_modification=(-3 * um, 3 * um),
    base_tangent_upper=(-31 * um, 3 * um),
    base_tangent_lower=(-31 * um, 3 * um),
)


def _cases(quick: bool) -> Sequence[Cases]:
    return [
        Cases(
            name="lost_motion",
            case="unit of the RV-20E with K1 = e z_p / r_p",
            outputs={"lost_motion": "rad"},
            design=RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=None)),
            errors=FLANK,
            conditions={},
            torque=None,
            ways=tuple(Way(name.replace("_", " "), dict(lost_motion_profile=name)) for name in PROFILES),
            batch=4096,
            calls=2 if quick else 9,
        )
    ]


DESCRIPTION = Description(
    name="lost_motion",
    design=RVReducer,
    conditions=LostMotionConditions,
    outputs={
        "lost_motion": Output(
            "rad",
            "free angle of the output, < 0: interference",
            _lost_motion,
            below_zero="interference, no backlash; teeth and bearings are preloaded by this angle",
            exact="bench_lost_motion",
            least=KNOWN_ERROR,
        )
    },
    cases=_cases,
    unknown="contact sequence (signed contributions are summed); load and deformation",
)
