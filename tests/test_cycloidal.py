"""Records of a single-stage cycloidal drive: ratios, shapes, what they refuse."""

import dataclasses

import numpy as np
import pytest

from rvjax import Contact, CycloidalErrors, CycloidalReducer, CycloidalStiffness, CycloidStage, OutputPins, RVErrors
from rvjax.catalogue import RV_40E
from rvjax.errors import STAGES
from rvjax.units import GPa, mm, um

CYCLOID = CycloidStage(17, 18, 2, 1.6 * mm, 42.5 * mm, 2.5 * mm)
DRIVE = CycloidalReducer(CYCLOID, OutputPins(6, 32.3 * mm, 2.5 * mm, 70 * um), CycloidalStiffness(30e6))


def test_the_carrier_turns_against_the_shaft_and_the_ring_with_it():
    ring = DRIVE.replace(member="ring")
    assert (DRIVE.ratio, ring.ratio) == (-17, 18)
    assert (DRIVE.carrier_ratio, ring.carrier_ratio) == (-17, -18)
    assert (DRIVE.carrier_factor, ring.carrier_factor) == (1.0, -17 / 18)
    assert ring.kind == "cycloidal" and ring.error_record is CycloidalErrors


def test_the_shaft_is_the_one_crank():
    assert DRIVE.counts == {"discs": 2, "cranks": 1, "pins": 18, "teeth": 17, "output_pins": 6}
    errors = CycloidalErrors.for_design(DRIVE, hole_radius=2 * um, throw=np.array([1.0, 2.0]) * um)
    assert errors.hole_radius.shape == (2, 6) and errors.output_pin_offset == 0.0


def test_the_clearance_of_a_hole_is_that_of_its_diameter():
    made = OutputPins.from_hole(6, 32.3 * mm, 2.5 * mm, hole_radius=4.135 * mm, eccentricity=1.6 * mm)
    assert made.hole_clearance == pytest.approx(70 * um)


REFUSED = {
    "member = 'arm': must be one of carrier, ring": lambda: DRIVE.replace(member="arm"),
    "OutputPins.count = 2": lambda: OutputPins(2, 30 * mm, 3 * mm),
    "OutputPins.pin_radius = -0.003 m": lambda: OutputPins(6, 30 * mm, -3 * mm),
    "OutputPins.pin_stiffness = 0 N/m": lambda: OutputPins(6, 30 * mm, 3 * mm, pin_stiffness=0.0),
    "CycloidalStiffness.eccentric_bearing = 0 N/m": lambda: CycloidalStiffness(0.0),
    "CycloidalStiffness.shaft_support = -1 N/m": lambda: CycloidalStiffness(1.0, -1.0),
    "OutputPins.hole_clearance = -0.0032 m": lambda: DRIVE.replace(output=OutputPins(6, 0.03, 0.003, -3.2 * mm)),
    "CycloidStage.pin_count = 19": lambda: DRIVE.replace(cycloid=CycloidStage(17, 19, 2, 1e-3, 42.5e-3, 2.5e-3)),
    "Contact.pin_poisson_ratio = None": lambda: Contact(69 * GPa, 0.33, 6 * mm, pin_young_modulus=206 * GPa),
    "Contact.pin_young_modulus = None": lambda: Contact(69 * GPa, 0.33, 6 * mm, pin_poisson_ratio=0.3),
    "CycloidalErrors.hole_position: shape": lambda: CycloidalErrors.for_design(
        DRIVE, hole_position=np.zeros((2, 5, 2))
    ),
    "takes a design of kind CycloidalReducer": lambda: CycloidalErrors.for_design(RV_40E),
    "takes a design of kind RVReducer": lambda: RVErrors.for_design(DRIVE),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_is_an_error_that_names_the_field(message):
    with pytest.raises(ValueError, match=message):
        REFUSED[message]()


def test_every_error_has_a_part_and_is_read_by_the_loaded_model():
    fields = {f.name: f.metadata for f in dataclasses.fields(CycloidalErrors)}
    parts = {about["part"] for about in fields.values()}
    assert parts == {"shaft", "discs", "ring", "carrier", "output_pins", "bearings"} and parts <= set(STAGES)
    own = {name: about["read_by"] for name, about in fields.items()}
    frictions = {f"{place}_friction" for place in ("ring_pin", "output_pin", "arm_bearing", "drag")}
    assert {name for name, readers in own.items() if readers == ("running",)} == frictions
    assert {own[name] for name in own.keys() - frictions} == {("loaded", "life", "running")}
    vectors = {name for name, about in fields.items() if about["vector"]}
    assert vectors == {"pin_offset", "ring_centre", "disc_centre", "hole_position", "output_pin_offset", "shaft_centre",
                       "carrier_centre"}  # fmt: skip
    placed = {name for name, about in fields.items() if about["placed"]}
    assert {"throw", "eccentric_phase", "hole_radius", "output_pin_radius", "disc_pitch"} <= placed
    assert not placed & {"eccentricity", "bearing_clearance", "equidistant_modification"}
