"""Operating conditions of the whole reducer under load, for its outputs and its bench observations."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rvjax.loaded.inputs import SUPPORTS
from rvjax.loaded.laws import CONTACTS
from rvjax.outputs import condition

SPANS = ("crank_turn", "output_turn")


@dataclass(frozen=True)
class Conditions:
    """Operating conditions of a whole reducer and of its test bench; None only where no output needs the value."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)
    second_torque: float = condition(None, "of the discs on the carrier, the second one", unit="N m")
    rated_torque: float = condition(None, "of which a test bench takes shares", unit="N m")
    input_angle: float = condition(0.0, "of the sun, at which the bench twists the output", unit="rad")
    probe_angles: int = condition(
        1, "input angles of the bench, equally spaced over the span from the input angle on", minimum=1, maximum=1000
    )
    span: str = condition("crank_turn", "along which the reducer turns", choices=SPANS)
    samples: int = condition(48, "input angles over the span", minimum=4, maximum=100_000)
    order: int = condition(None, "periods in one turn of the output", minimum=1, maximum=50_000)
    pin_contact: str = condition("hertz", "contact law of discs and pins", choices=CONTACTS)
    carrier: str = condition("fixed", "centre of the carrier", choices=SUPPORTS)
    sun: str = condition("fixed", "centre of the sun", choices=SUPPORTS)


def without_sun(name: str, conditions: type, said: Mapping[str, str]) -> Any:
    """Class of the same conditions of a single-stage drive: without a first stage.

    Args:
        name: of the class.
        conditions: class of those of an RV reducer.
        said: meanings of fields that differ.
    """
    fields: list[Any] = [
        (f.name, Any, dataclasses.field(default=f.default, metadata={**f.metadata, "meaning": meaning}))
        for f in dataclasses.fields(conditions)
        if f.name != "sun"
        for meaning in (said.get(f.name, f.metadata["meaning"]),)
    ]
    return dataclasses.make_dataclass(name, fields, frozen=True)


DriveConditions = without_sun(
    "DriveConditions",
    Conditions,
    {
        "output_torque": "torque of the discs on the output",
        "second_torque": "of the discs on the output, the second one",
        "input_angle": "of the shaft, at which the bench twists the output",
    },
)
"""Conditions of a single-stage drive."""


def ways(given: Any) -> dict[str, str]:
    """Methods of the equilibrium, as its keyword arguments."""
    return dict(contact=given.pin_contact, carrier=given.carrier, sun=getattr(given, "sun", "fixed"))
