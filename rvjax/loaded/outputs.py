"""Outputs of the whole reducer under load for studies.

Outputs read a few results, each computed once for all required ones: a turn under one of three torques, and the twist
that a test bench measures at some input angles.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import RVReducer, check_teeth
from rvjax.errors import RVErrors
from rvjax.loaded.bench import secant, twisted
from rvjax.loaded.cases import cases
from rvjax.loaded.equilibrium import check_input, equilibrium
from rvjax.loaded.observation import (
    CURVE,
    HALF,
    LOOP,
    PROBE,
    RATED,
    SLIGHT,
    DriveConditions,
    LoadedConditions,
    check_carrying,
    decisive,
    input_angles,
    second_turn,
    solved_angles,
    turn,
    turns_of,
    unloaded_turn,
    ways,
)
from rvjax.loaded.revolution import Clearance, Revolution, clearance
from rvjax.outputs import KNOWN_ERROR, Curve, Description, Extremes, Output, Reading, Solved, Usual, number_of
from rvjax.status import SolveInfo, worst, worst_of
from rvjax.units import MPa

Refuse = Callable[[RVReducer, LoadedConditions], None]


def _bench(shares: tuple[float, ...]) -> Callable[[RVReducer, RVErrors, LoadedConditions], tuple[jax.Array, SolveInfo]]:
    """Rotations (angles, shares, 2) at the input angles of the bench, and the worst info."""

    def twist(design: RVReducer, errors: RVErrors, conditions: LoadedConditions) -> tuple[jax.Array, SolveInfo]:
        """At the shares of the rated torque that this bench takes."""
        design = errors.stiffened(design)
        layout = check_input(design, errors, *ways(conditions).values())
        span = 2 * np.pi * design.ratio * turns_of(design, conditions)
        angles = conditions.input_angle + span * np.arange(conditions.probe_angles) / conditions.probe_angles

        def at(angle: jax.Array) -> tuple[jax.Array, SolveInfo]:
            return twisted(layout, design, errors, angle, conditions.rated_torque, shares)

        rotation, infos = jax.vmap(at)(jnp.asarray(angles, jnp.result_type(float, *jax.tree.leaves((design, errors)))))
        return rotation, worst_of(infos)

    return twist


BACKLASH, LOST_MOTION, STIFFNESS = _bench((PROBE,)), _bench((SLIGHT,)), _bench((RATED, HALF))


def _play(twist: tuple[jax.Array, SolveInfo], design: RVReducer, conditions: LoadedConditions) -> Solved:
    rotation, info = twist
    return jnp.max(rotation[:, 0, 0] - rotation[:, 0, 1]), info.status


def _stiffness(twist: tuple[jax.Array, SolveInfo], design: RVReducer, conditions: LoadedConditions) -> Solved:
    rotation, info = twist
    return jnp.min(secant(rotation[:, 0, 1], rotation[:, 1, 1], conditions.rated_torque)), info.status


def _shift(first: Revolution, second: Revolution, design: RVReducer, conditions: LoadedConditions) -> Solved:
    return second.mean - first.mean, worst(jnp.stack([first.info.status, second.info.status]))


def _amplitude(results: Revolution, design: RVReducer, conditions: LoadedConditions) -> Solved:
    """|X_k| of error = Re sum X_k e^(2 pi i k j / n), from its one line of the transform."""
    k = round(conditions.order * turns_of(design, conditions))
    angle = 2 * np.pi * ((k * np.arange(conditions.samples)) % conditions.samples) / conditions.samples
    parts = [
        2 / conditions.samples * jnp.sum(results.error * jnp.asarray(wave(angle), results.error.dtype))
        for wave in (np.cos, np.sin)
    ]
    square = parts[0] ** 2 + parts[1] ** 2
    return jnp.where(square == 0, 0, jnp.sqrt(jnp.where(square == 0, 1, square))), results.info.status


def _pressure(design: RVReducer, errors: RVErrors, conditions: LoadedConditions) -> Solved:
    solution = equilibrium(
        errors.stiffened(design),
        errors,
        input_angle=conditions.input_angle,
        output_torque=conditions.output_torque,
        **ways(conditions),
    )
    return jnp.max(solution.pressure), solution.info.status


def _fit(design: RVReducer, errors: RVErrors, conditions: LoadedConditions) -> Clearance:
    """Least clearance of flanks, and of the holes of a drive, over the span without load.

    Where units choose angles, at so many of a crank turn: 12 are 0.1 um above 481 of a turn of the output (drive of 17
    lobes, standard deviation 5 um), 97 of the latter as well.
    """
    few = solved_angles(conditions)
    if few is not None:
        return clearance(design, errors, samples=few)
    return clearance(design, errors, turns=turns_of(design, conditions), samples=conditions.samples)


def _clearance(design: RVReducer, errors: RVErrors, conditions: LoadedConditions) -> Solved:
    least = _fit(design, errors, conditions)
    return least.least, least.info.status


def _angles(conditions: LoadedConditions) -> np.ndarray:
    return 2 * np.pi * np.arange(conditions.samples) / conditions.samples


def _curve(design: RVReducer, errors: RVErrors, conditions: LoadedConditions) -> tuple[np.ndarray, jax.Array]:
    return _angles(conditions), turn(design, errors, conditions).error


def _carrying(outputs: dict[str, Output]) -> dict[str, Output]:
    """Add to each output a check for missing load-carrying parts of the design, before its other checks."""

    def refusing(check: Refuse | None) -> Refuse:
        def refuse(design: RVReducer, conditions: LoadedConditions) -> None:
            check_carrying(design, "a reducer under load")
            if check is not None:
                check(design, conditions)

        return refuse

    return {name: replace(output, refuse=refusing(output.refuse)) for name, output in outputs.items()}


def _apart(design: RVReducer, conditions: LoadedConditions) -> None:
    if conditions.second_torque == conditions.output_torque:
        raise ValueError(
            f"conditions.second_torque = {conditions.second_torque:g} N m: must differ from conditions.output_torque"
        )


def _rated(design: RVReducer, conditions: LoadedConditions) -> None:
    if conditions.rated_torque <= 0:
        raise ValueError(f"conditions.rated_torque = {conditions.rated_torque:g} N m: must be positive")


def _loaded(design: RVReducer, conditions: LoadedConditions) -> None:
    if conditions.output_torque == 0:
        raise ValueError("conditions.output_torque = 0 N m: without torque there is no load to share")


def _resolved(design: RVReducer, conditions: LoadedConditions) -> None:
    """An order that the span holds in full periods and the samples resolve."""
    where, zp = f"conditions.order = {conditions.order}", design.cycloid.pin_count
    if conditions.span == "crank_turn" and conditions.order % zp:
        raise ValueError(f'{where}: a crank turn shows multiples of {zp} only; set conditions.span = "output_turn"')
    if 2 * conditions.order * turns_of(design, conditions) >= conditions.samples:
        least = round(2 * conditions.order * turns_of(design, conditions)) + 1
        raise ValueError(
            f"{where}: beyond half of conditions.samples = {conditions.samples} over the span, {least} at least"
        )


def _of_turn(unit: str, meaning: str, name: str, refuse: Refuse | None = None, least: float = 0.0) -> Output:
    return Output(unit, meaning, Reading((turn,), number_of(name)), refuse=refuse, least=least)


def _along(conditions: LoadedConditions) -> tuple[str, int]:
    return "turn", solved_angles(conditions) or conditions.samples


def _on_bench(kind: str, conditions: LoadedConditions) -> tuple[str, int]:
    return kind, 2 * conditions.probe_angles


EXTREMES = Extremes(
    turn,
    dict(
        loaded_transmission_error=0, turn_pin_pressure=1, hole_pressure=2, pin_force=None, arm_bearing_force=None,
        support_bearing_force=None, crank_sharing=None, disc_sharing=None, loaded_pins=None, hole_force=None,
    ),
    input_angles, decisive, solved_angles,
)  # fmt: skip

NEEDS = ("rated_torque",)
PRESSURE = 2800 * MPa
"""Usual limit of a contact pressure of pins."""
DESCRIPTION = Description(
    name="loaded",
    design=RVReducer,
    conditions=LoadedConditions,
    outputs=_carrying({
        "loaded_transmission_error": _of_turn(
            "rad", "peak to peak over the span, every pin under load", "peak_to_peak", least=KNOWN_ERROR
        ),
        "second_transmission_error": Output(
            "rad",
            "peak to peak over the span under the second torque",
            Reading((second_turn,), number_of("peak_to_peak")),
            ("second_torque",),
            refuse=_apart,
        ),
        "unloaded_transmission_error": Output(
            "rad",
            "peak to peak over the span at the probe torque, 0.1 % of rated",
            Reading((unloaded_turn,), number_of("peak_to_peak")),
            NEEDS,
            refuse=_rated,
        ),
        "mean_shift": Output(
            "rad",
            "mean rotation over the span under the second torque, less that under the output torque",
            Reading((turn, second_turn), _shift),
            ("second_torque",),
            refuse=_apart,
        ),
        "order_amplitude": Output(
            "rad", "of one order of the output turn, under the output torque", Reading((turn,), _amplitude),
            ("order",), "arcsec", refuse=_resolved,
        ),
        "pin_force": _of_turn("N", "largest force of a pin over the span", "largest_pin"),
        "pin_pressure": Output("Pa", "largest contact pressure of a pin at the input angle", _pressure),
        "turn_pin_pressure": _of_turn("Pa", "largest contact pressure of a pin over the span", "largest_pressure"),
        "arm_bearing_force": _of_turn(
            "N", "largest force of a crank bearing in a disc over the span", "largest_arm_bearing"
        ),
        "support_bearing_force": _of_turn(
            "N", "largest force of a crank bearing in the carrier over the span", "largest_support_bearing"
        ),
        "crank_sharing": _of_turn(
            "-", "largest share of a crank in the torque, times their number, over the span", "crank_sharing", _loaded
        ),
        "disc_sharing": _of_turn(
            "-", "largest share of a disc in the torque, times their number, over the span", "disc_sharing", _loaded
        ),
        "loaded_pins": _of_turn(
            "-", "fewest pins that carry, of all discs together, over the span", "fewest_pins", _loaded
        ),
        "backlash": Output(
            "rad", "turn of the output between both probe torques, largest of the probe angles",
            Reading((BACKLASH,), _play), NEEDS, refuse=_rated,
        ),
        "bench_lost_motion": Output(
            "rad", "at +-3 % of rated torque, largest of the probe angles",
            Reading((LOST_MOTION,), _play), NEEDS, refuse=_rated, least=KNOWN_ERROR,
        ),
        "torsional_stiffness": Output(
            "N m/rad", "between half and full rated torque, least of the probe angles",
            Reading((STIFFNESS,), _stiffness), NEEDS, "N m/arcmin", refuse=_rated,
        ),
    }) | {
        "flank_clearance": Output(
            "m", "least clearance of flanks and pins over the span, discs turned to where it is largest", _clearance,
            below_zero="interference, at least two pins are pressed at any rotation of the discs",
            refuse=lambda design, _: check_teeth(design.cycloid),
        )
    },
    curve=Curve(
        "Transmission error of the loaded reducer over the span", "rad", _curve, turns_of,
        (turn, lambda found: found.error), _angles, ("loaded_transmission_error", "order_amplitude"),
    ),
    cases=cases,
    observations=(CURVE, LOOP),
    unknown="friction, inertia, tilting; pin_position, disc_runout and disc_cumulative_pitch (largest errors without "
    "direction: give pin_offset, disc_centre and disc_pitch)",
    compiler_options=QUICK, quick=("flank_clearance",),
    usual={
        "turn_pin_pressure": Usual(
            lambda design: (-np.inf, PRESSURE), "static safety 2: 4000 MPa dents hardened rollers (ISO 76)"
        )
    },
    work={
        turn: _along, second_turn: _along,
        BACKLASH: partial(_on_bench, "probe"), LOST_MOTION: partial(_on_bench, "bench"),
    },
    extremes=EXTREMES,
)  # fmt: skip

_ALIKE = (
    "loaded_transmission_error second_transmission_error unloaded_transmission_error mean_shift order_amplitude "
    "pin_force pin_pressure turn_pin_pressure disc_sharing loaded_pins backlash bench_lost_motion torsional_stiffness"
)
OTHERS = (
    replace(
        DESCRIPTION,
        design=CycloidalReducer,
        conditions=DriveConditions,
        outputs={name: DESCRIPTION.outputs[name] for name in _ALIKE.split()}
        | _carrying({
            "arm_bearing_force": _of_turn(
                "N", "largest force of an eccentric bearing over the span", "largest_arm_bearing"
            ),
            "support_bearing_force": _of_turn(
                "N", "largest force of the shaft on its supports over the span", "largest_support_bearing"
            ),
            "hole_force": _of_turn("N", "largest force of an output pin over the span", "largest_output_pin"),
            "hole_pressure": _of_turn(
                "Pa", "largest contact pressure of an output pin over the span", "largest_output_pressure"
            ),
        })
        | {
            "fit_clearance": Output(
                "m", "least clearance of pins and holes over the span, discs and carrier turned to where it is largest",
                Reading((_fit,), number_of("least")), below_zero="interference, the drive jams or is preloaded",
                rejects="jam",
            )
        },
        cases=None,
        work={**DESCRIPTION.work, _fit: lambda given: ("fit", solved_angles(given) or given.samples)},
        quick=("fit_clearance",),
        observations=(replace(CURVE, head=None), LOOP),  # the deformation that a head reads is that of an RV reducer
        unknown="friction, tilting, inertia, twist of the shaft, creep and heat of polymers; bearings have one "
        "stiffness, where that of balls grows with the load; forces for clearances above eccentricity/25",
        usual={},
    ),
)  # fmt: skip
"""Of single-stage drives."""
