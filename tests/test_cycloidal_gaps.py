"""Depths of pins and holes, bearings, rows and contact laws of a single-stage drive, against the independent model."""

import functools

import jax
import numpy as np
import pytest
from cycloidal_cases import NAMED, design_of, dictionaries, drawn, errors_of

from rvjax import CycloidalErrors, RVErrors, loaded
from rvjax.loaded.cycloidal import drive_laws, layout
from rvjax.loaded.cycloidal_gaps import drive_at, drive_gaps, drive_rows
from rvjax.loaded.equilibrium import check_input
from rvjax.units import um
from tests.oracles import cycloidal as oracle

TWO = design_of(NAMED["c17: fit, errors"]["design"])
RING = design_of(NAMED["ring13: fit, errors"]["design"])
DRIVES = {"carrier, two discs": (TWO, False, False), "ring, one disc": (RING, True, True)}


def layout_of(design):
    """A held shaft has a floating carrier here."""
    carrier = "fixed" if design.stiffness.shaft_support is None else "floating"
    return layout(design, CycloidalErrors(), "hertz", carrier, "fixed")


@jax.jit
def contacts(design, errors, angle):
    e = design.cycloid.eccentricity + errors.eccentricity
    at = drive_at(design, e, angle)
    return drive_gaps(design, errors, at, e), drive_rows(design, layout_of(design), at)


@pytest.mark.parametrize("name", DRIVES)
def test_gaps_and_rows_are_those_of_the_independent_model(name):
    design, floats, held = DRIVES[name]
    given, rng = dictionaries(design), np.random.default_rng(11)
    sizes = tuple(design.counts[axis] for axis in ("discs", "pins", "teeth", "output_pins"))
    total, length = layout_of(design).unknowns, design.output.circle_radius
    for angle in (0.0, 0.7, -23.0, 410.0):
        errors = drawn(rng, sizes)
        found, rows = contacts(design, errors_of(errors), angle)
        at = oracle.drive(given, errors, angle)
        for mine, due in ((found.pins, at.pin_gap), (found.holes, at.hole_gap), (found.centres, at.centre_gap)):
            np.testing.assert_allclose(mine, due, rtol=0, atol=1e-7 * um)
        due = oracle.machine(given, errors, angle, 0.0, carrier="floating" if floats else "fixed")
        # the oracle has rotations in rad, and the shaft before the carrier
        turns, alpha = [3 * k + 2 for k in range(sizes[0])], 3 * sizes[0]
        order = [*range(alpha + 1), *(alpha + 1 + i for i in ((2, 3, 0, 1) if floats and held else ()))]
        scale = np.ones(total)
        scale[[*turns, alpha]] = 1 / length
        pins = np.zeros((sizes[0], sizes[1], total))
        for k in range(sizes[0]):
            pins[k, :, 3 * k : 3 * k + 3] = np.moveaxis(np.asarray(rows.pins)[:, k], 0, -1)
        for mine, theirs in (
            (pins.reshape(-1, total), due.groups[0].rows),
            (np.asarray(rows.holes).reshape(-1, total), due.groups[1].rows),
            (rows.bearings, due.bearing_rows),
        ):
            np.testing.assert_allclose(mine, (theirs * scale)[..., np.argsort(np.argsort(order))], rtol=0, atol=1e-11)


def test_nothing_is_exactly_nothing():
    """Zero errors and clearances: every gap is 0.0, at every angle."""
    design = TWO.replace(
        cycloid=TWO.cycloid.replace(equidistant_modification=0.0), output=TWO.output.replace(hole_clearance=0.0)
    )
    found, _ = contacts(design, CycloidalErrors(), 3.3)
    assert not any(np.any(np.asarray(each)) for each in found)


def test_a_longer_eccentricity_closes_every_hole():
    """The holes keep their size; the clearance of a hole is half of the diametral one."""
    at_rest, _ = contacts(TWO, CycloidalErrors(), 0.4)
    longer, _ = contacts(TWO, CycloidalErrors(eccentricity=3 * um), 0.4)
    np.testing.assert_allclose(at_rest.holes, -35 * um, rtol=1e-12)
    np.testing.assert_allclose(longer.holes, -32 * um, rtol=1e-12)
    np.testing.assert_allclose(longer.pins, at_rest.pins, rtol=1e-12)


@functools.partial(jax.jit, static_argnums=0)
def numbers(law, design, angle):
    return drive_laws(law, design, drive_at(design, design.cycloid.eccentricity, angle))


@pytest.mark.parametrize("law", ["hertz", "linear", "palmgren"])
@pytest.mark.parametrize("name", DRIVES)
def test_the_contact_laws_are_those_of_the_independent_model(name, law):
    """Two materials and one; a support at every pin, another at every output pin."""
    design, _, _ = DRIVES[name]
    pins, holes = (np.linspace(1e8, 3e8, design.counts[axis]) for axis in ("pins", "output_pins"))
    design = design.replace(
        contact=design.contact.replace(pin_support=pins), output=design.output.replace(pin_support=holes)
    )
    for softer in (design, DRIVES[name][0]):
        due = oracle.machine(dictionaries(softer), {}, 0.7, 0.0, law)
        for found, own in zip(numbers(law, softer, 0.7), due.groups):
            shape = (design.cycloid.disc_count, len(own.gap) // design.cycloid.disc_count)
            pairs = [(found.compliance, own.compliance), (found.radius, own.radius)]
            pairs += [(found.level, own.level)] if law == "hertz" else []
            for mine, theirs in pairs:
                np.testing.assert_allclose(np.broadcast_to(mine, shape).ravel(), theirs, rtol=1e-11)


LINEAR = {"contact": "linear"}
REFUSED = {
    "takes CycloidalErrors, got RVErrors": (TWO, RVErrors(), {}),
    "CycloidalReducer.stiffness = None": (TWO.replace(stiffness=None), CycloidalErrors(), {}),
    "CycloidalReducer.contact = None": (TWO.replace(contact=None), CycloidalErrors(), {}),
    "Contact.pin_stiffness = None": (
        TWO.replace(contact=TWO.contact.replace(pin_stiffness=None)), CycloidalErrors(), LINEAR,
    ),
    "OutputPins.pin_stiffness = None": (
        TWO.replace(output=TWO.output.replace(pin_stiffness=None)), CycloidalErrors(), LINEAR,
    ),
    "sun = 'floating': .*shaft_support": (TWO, CycloidalErrors(), {"sun": "floating"}),
    "contact = 'point'": (TWO, CycloidalErrors(), {"contact": "point"}),
    "carrier = 'loose'": (TWO, CycloidalErrors(), {"carrier": "loose"}),
    "CycloidalErrors.hole_position: shape": (TWO, CycloidalErrors(hole_position=np.zeros((2, 4, 2))), {}),
    "OutputPins.pin_support: shape": (
        TWO.replace(output=TWO.output.replace(pin_support=np.ones(5))), CycloidalErrors(), {},
    ),
    "CycloidalStiffness.eccentric_bearing: shape": (
        TWO.replace(stiffness=TWO.stiffness.replace(eccentric_bearing=np.ones(3))), CycloidalErrors(), {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_what_no_equilibrium_can_be_computed_of_is_named(message):
    design, errors, methods = REFUSED[message]
    check_input(TWO, CycloidalErrors(), "linear", "floating", "fixed")
    with pytest.raises(ValueError, match=message):
        loaded.equilibrium(design, errors, input_angle=0.0, output_torque=1.0, **methods)
