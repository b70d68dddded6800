"""Depths of pins and holes, offsets of the bearings and their rows, against the independent model."""

import jax
import numpy as np
import pytest
from cycloidal_cases import NAMED, design_of, dictionaries, drawn, errors_of

from oracles import cycloidal as oracle
from rvjax import CycloidalErrors
from rvjax.loaded.cycloidal_gaps import Unknowns, drive_at, drive_gaps, drive_rows
from rvjax.units import um

TWO = design_of(NAMED["c17: fit, errors"]["design"])
RING = design_of(NAMED["ring13: fit, errors"]["design"])
DRIVES = {"carrier, two discs": (TWO, False, False), "ring, one disc": (RING, True, True)}


@jax.jit
def contacts(design, errors, angle):
    e = design.cycloid.eccentricity + errors.eccentricity
    at = drive_at(design, e, angle)
    held = design.stiffness.shaft_support is not None
    unknowns = Unknowns(design.cycloid.disc_count, held, held)
    return drive_gaps(design, errors, at, e), drive_rows(design, unknowns, at)


@pytest.mark.parametrize("name", DRIVES)
def test_gaps_and_rows_are_those_of_the_independent_model(name):
    design, floats, held = DRIVES[name]
    given, rng = dictionaries(design), np.random.default_rng(11)
    sizes = tuple(design.counts[axis] for axis in ("discs", "pins", "teeth", "output_pins"))
    unknowns, length = Unknowns(sizes[0], floats, held), design.output.circle_radius
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
        scale = np.ones(unknowns.total)
        scale[[*turns, alpha]] = 1 / length
        pins = np.zeros((sizes[0], sizes[1], unknowns.total))
        for k in range(sizes[0]):
            pins[k, :, 3 * k : 3 * k + 3] = np.moveaxis(np.asarray(rows.pins)[:, k], 0, -1)
        for mine, theirs in (
            (pins.reshape(-1, unknowns.total), due.groups[0].rows),
            (np.asarray(rows.holes).reshape(-1, unknowns.total), due.groups[1].rows),
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
