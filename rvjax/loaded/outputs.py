"""What studies may ask of the whole reducer under load."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.designs import RVReducer
from rvjax.loaded.equilibrium import equilibrium
from rvjax.loaded.laws import CONTACTS
from rvjax.loaded.reading import SUPPORTS
from rvjax.loaded.revolution import Revolution, revolution
from rvjax.loaded.torsion import Torsion, torsion
from rvjax.outputs import Curve, Description, Output, Solved, condition


@dataclass(frozen=True)
class Conditions:
    """How a whole reducer runs, and how a test bench measures it."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)
    rated_torque: float | None = condition(None, "of which a test bench takes shares", unit="N m")
    input_angle: float = condition(0.0, "of the sun, at which the bench twists the output", unit="rad")
    samples: int = condition(48, "input angles over one crank turn", minimum=4, maximum=100_000)
    pin_contact: str = condition("hertz", "law of discs and pins", choices=CONTACTS)
    carrier: str = condition("fixed", "centre of the carrier", choices=SUPPORTS)
    sun: str = condition("fixed", "centre of the sun", choices=SUPPORTS)


def _ways(given: Any) -> dict[str, Any]:
    return dict(contact=given.pin_contact, carrier=given.carrier, sun=given.sun)


def _turn(design: RVReducer, errors: Any, given: Any) -> Revolution:
    return revolution(
        errors.stiffened(design), errors, output_torque=given.output_torque, samples=given.samples, **_ways(given)
    )


def _bench(design: RVReducer, errors: Any, given: Any) -> Torsion:
    torque, angle = given.rated_torque, given.input_angle
    return torsion(errors.stiffened(design), errors, input_angle=angle, rated_torque=torque, **_ways(given))


def _error(design: RVReducer, errors: Any, given: Any) -> Solved:
    found = _turn(design, errors, given)
    return found.peak_to_peak, found.info.status


def _pin(design: RVReducer, errors: Any, given: Any) -> Solved:
    found = _turn(design, errors, given)
    return found.largest_pin, found.info.status


def _pressure(design: RVReducer, errors: Any, given: Any) -> Solved:
    found = equilibrium(
        errors.stiffened(design),
        errors,
        input_angle=given.input_angle,
        output_torque=given.output_torque,
        **_ways(given),
    )
    return jnp.max(found.pressure), found.info.status


def _of_bench(name: str) -> Any:
    def evaluate(design: RVReducer, errors: Any, given: Any) -> Solved:
        found = _bench(design, errors, given)
        return getattr(found, name), found.info.status

    return evaluate


def _curve(design: RVReducer, errors: Any, given: Any) -> tuple[Any, Any]:
    found = _turn(design, errors, given)
    return 2 * np.pi * np.arange(given.samples) / given.samples, found.error


RATED = ("rated_torque",)
DESCRIPTION = Description(
    design=RVReducer,
    conditions=Conditions,
    outputs={
        "loaded_transmission_error": Output("rad", "peak to peak over a crank turn, every pin under load", _error),
        "pin_force": Output("N", "largest force of a pin over a crank turn", _pin),
        "pin_pressure": Output("Pa", "largest contact pressure of a pin at the input angle", _pressure),
        "backlash": Output("rad", "turn of the output between both probe torques", _of_bench("backlash"), RATED),
        "bench_lost_motion": Output("rad", "at +-3 % of rated torque", _of_bench("lost_motion"), RATED),
        "torsional_stiffness": Output(
            "N m/rad", "between half and full rated torque", _of_bench("stiffness"), RATED, "N m/arcmin"
        ),
    },
    curve=Curve("Transmission error of the loaded reducer over one crank turn", "rad", _curve),
    unknown="friction, inertia, tilting; errors without a place (pin position, runout and pitch as bounds)",
)
