"""Figures of a single-stage drive: reference, closed forms of rigid discs, statuses, and the known drives."""

import jax
import numpy as np
import pytest
from cycloidal_cases import NAMED, SAMPLES, design_of, dictionaries, fits

from rvjax import CycloidalErrors, Status, catalogue, geometry
from rvjax.geometry.outputs import largest_share
from rvjax.loaded import unchecked
from rvjax.units import GPa, mm, um
from tests.oracles import cycloidal as oracle

TWO = design_of(NAMED["c17: figures"]["design"])


@pytest.mark.parametrize("name", ["c17: figures", "ring13: figures"])
def test_the_reference(name):
    case = NAMED[name]
    found = geometry.figures(design_of(case["design"]), **case["options"])
    assert found.info.status == Status.CONVERGED
    assert (found.crank_room, found.contact_ratio, found.mass) == (None, None, None)
    for key, due in case["expect"].items():
        assert key == "status" or getattr(found, key) == pytest.approx(due, rel=1e-6), key
    back = geometry.figures(design_of(case["design"]), -case["options"]["output_torque"])
    assert back.pin_pressure == found.pin_pressure and back.eccentric_force == found.eccentric_force


def test_the_largest_share_of_an_output_pin():
    """4/n for an even number; the published shares of odd ones."""
    for pins in (4, 6, 12):
        assert largest_share(pins) == pytest.approx(4 / pins, rel=1e-12)
    for pins, due in {3: 1.2492, 5: 0.8396, 7: 0.5626, 9: 0.4476}.items():
        assert largest_share(pins) == pytest.approx(due, abs=6e-5)


def test_both_members_at_the_same_torque_of_the_carrier():
    carrier, ring = geometry.figures(TWO, 8.5), geometry.figures(TWO.replace(member="ring"), 9.0)
    for name in ("pin_pressure", "hole_pressure", "eccentric_force"):
        assert getattr(ring, name) == pytest.approx(float(getattr(carrier, name)), rel=1e-12)


def test_the_material_of_the_pins_counts():
    """Compliances add: pins of the discs' material, rigid pins, and the square root of the stiffness in between."""
    contact = TWO.contact
    same = TWO.replace(contact=contact.replace(pin_young_modulus=69 * GPa, pin_poisson_ratio=0.33))
    none = TWO.replace(contact=contact.replace(pin_young_modulus=None, pin_poisson_ratio=None))
    rigid = TWO.replace(contact=contact.replace(pin_young_modulus=1e9 * GPa))
    figures = [geometry.figures(each, 13.2) for each in (same, none, rigid)]
    for name in ("pin_pressure", "hole_pressure"):
        given, plain, hard = (float(getattr(each, name)) for each in figures)
        assert given == pytest.approx(plain, rel=1e-12) and hard == pytest.approx(np.sqrt(2) * plain, rel=1e-6)


def test_without_contact_and_without_torque():
    bare = geometry.figures(TWO.replace(contact=None), 5.0)
    assert bare.hole_pressure is None and bare.pin_pressure is None and bare.envelope_volume is None
    assert bare.eccentric_force > 0
    slope = jax.jit(jax.grad(lambda torque: geometry.figures(TWO, torque).eccentric_force))(0.0)
    assert np.isfinite(slope) and geometry.figures(TWO).hole_pressure == 0.0


def test_a_drive_that_cannot_be_has_a_status():
    def found(part, **changes):
        return geometry.figures(unchecked(TWO, **{part: unchecked(getattr(TWO, part), **changes)}), 5.0)

    thick = found("cycloid", pin_radius=9 * mm)
    assert thick.info.status == Status.UNDERCUT and np.isnan(thick.pin_pressure) and thick.hole_pressure > 0
    for part, changes in (
        ("output", {"hole_clearance": -3.3 * mm}), ("output", {"pin_radius": 0.0}), ("contact", {"face_width": 0.0}),
        ("contact", {"pin_young_modulus": -1.0}), ("cycloid", {"eccentricity": 3 * mm}),
    ):  # fmt: skip
        impossible = found(part, **changes)
        assert impossible.info.status == Status.INVALID_GEOMETRY and np.isnan(impossible.hole_wall), changes
    assert found("output", circle_radius=np.nan).info.status == Status.NONFINITE
    assert found("cycloid", shortening=np.nan).info.status == Status.CONVERGED  # not read


DRIVES = {"15": 150 * um, "17": 35 * um, "29": 5 * um}


@pytest.mark.parametrize("lobes", [pytest.param(n, marks=[] if n == "17" else [pytest.mark.long]) for n in DRIVES])
def test_the_known_drives_turn_freely_and_have_room_for_their_holes(lobes):
    design = getattr(catalogue, f"CYCLOIDAL_{lobes}")
    angles = 2 * np.pi * design.ratio / design.cycloid.pin_count * np.arange(SAMPLES) / SAMPLES
    least = min(oracle.fit(dictionaries(design), {}, angle) for angle in angles)
    assert least == pytest.approx(DRIVES[lobes], abs=1e-6 * um)
    if lobes == "17":  # by the program of its size
        assert fits((design, CycloidalErrors()))[0].least == pytest.approx(DRIVES[lobes], abs=1e-9 * um)
    found = geometry.figures(design, 5.0)
    assert found.hole_gap > 0 and found.hole_wall > 0 and found.pin_gap > 0 and found.convex_radius > 0
    assert abs(design.ratio) == int(lobes) and catalogue.citation(f"cycloidal-{lobes}")
    assumed = catalogue.assumed(f"cycloidal-{lobes}")
    assert {"stiffness.eccentric_bearing", "output.hole_clearance", "contact.young_modulus"} <= set(assumed)
    assert "cycloid.eccentricity" not in assumed


def test_another_kind_of_design_is_refused():
    with pytest.raises(ValueError, match="got CamRollerReducer"):
        geometry.figures(catalogue.CORR)
