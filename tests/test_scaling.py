"""What follows a number of a design: gears and crank circle by geometry, the rest by laws of scaling."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import study
from rvjax.catalogue import RV_320E
from rvjax.study.goals import refuse_variable
from rvjax.study.kinds import changed, number_at, outside
from rvjax.study.kinds.rv_facts import FOLLOWING, LAWS
from rvjax.units import mm

CASES = json.loads((Path(__file__).parent / "reference" / "codesign.json").read_text())["cases"]
LAW = [case for case in CASES if case["kind"] == "law"]
QUESTION = """
[tolerances.crank_eccentricity]
half_width = "5 um"
[cost.crank_eccentricity]
scale = 1
reference = "5 um"
finest = "1 um"
coarsest = "20 um"
[requirement.transmission_error]
upper = "1 arcmin"
target = 0.99
[conditions]
angles = 8
"""
CONTACT = """
[design.contact]
young_modulus = "206 GPa"
poisson_ratio = 0.3
face_width = "20 mm"
"""
SPRING = 'cranks.bearing_stiffness = "6e8 N/m"\n'


def asked(more="", base="rv-320e"):
    text = f'[design]\nbase = "{base}"\n{more}'
    return study.parse_study(text + QUESTION, name="x", solve=False)


@pytest.mark.parametrize("case", LAW, ids=[case["id"] for case in LAW])
def test_ratios_of_the_reference(case):
    """Numbers that the published reducer lacks are added; a study that gives them would make them stand."""
    given = case["given"]
    base = asked(CONTACT).design
    base = base.replace(
        cranks=base.cranks.replace(bearing_stiffness=6e8),
        contact=base.contact.replace(pin_stiffness=1e8, pin_support=1e9),
        stiffness=base.stiffness.replace(output_support=1e9, output_torsion=1e6),
    )
    values = {path: given["ratios"][name] * number_at(base, path) for name, path in given["numbers"].items()}
    found = changed(base, values)
    for path, ratio in case["expected"].items():
        assert number_at(found, path) / number_at(base, path) == pytest.approx(ratio, rel=1e-7), path


def test_the_module_moves_gears_crank_circle_and_what_follows_it():
    """By hand: module times 1.1; supports with (1.1)^0.8, crank torsion with its cube, gear inertia with its fourth."""
    made = asked(CONTACT)
    found = made.design_with({"involute.module": 1.1 * made.design.involute.module})
    for path, power in {
        "involute.centre_distance": 1, "involute.sun_radius": 1, "involute.planet_base_radius": 1,
        "cranks.circle_radius": 1, "stiffness.support_bearing": 0.8, "stiffness.planet_crank_torsion": 3,
        "inertia.planet_inertia": 4, "inertia.crank_mass": 2, "bearings.support.roller_length": 1,
        "stiffness.turning_arm_bearing": 0, "inertia.disc_mass": 0, "bearings.arm.roller_length": 0,
    }.items():  # fmt: skip
        assert number_at(found, path) / number_at(RV_320E, path) == pytest.approx(1.1**power, rel=1e-12), path


def test_wider_discs_do_not_overlap_on_their_cranks():
    """The spacing of the discs grows as their width, and the shares of the supports stay; given places refuse it."""
    made = asked(base="rv-40e-whole")
    wider = made.design_with({"contact.face_width": 16 * mm})
    places, before = wider.bearings, made.design.bearings
    assert float(np.diff(places.disc_position)[0]) == pytest.approx(16 * mm)
    for name in ("disc_position", "planet_position"):
        ratio = np.asarray(getattr(places, name)) / places.support_span
        np.testing.assert_allclose(ratio, np.asarray(getattr(before, name)) / before.support_span, rtol=1e-12)
    with pytest.raises(ValueError, match=r"bearings.disc_position is given, but follows it"):
        refuse_variable(made.design, "contact.face_width", {"bearings.disc_position"})


def test_base_circles_follow_the_pressure_angle():
    """r_b = m z cos(alpha)/2 at a centre distance that stands: a steeper flank has a smaller base circle."""
    gears = changed(RV_320E, {"involute.pressure_angle": np.radians(25.0)}).involute
    before = RV_320E.involute
    for name in ("sun_base_radius", "planet_base_radius"):
        pitch = getattr(before, name) / np.cos(before.pressure_angle)
        assert getattr(gears, name) == pytest.approx(pitch * np.cos(np.radians(25.0)), rel=1e-6)
    assert gears.sun_base_radius < before.sun_base_radius


def test_a_given_number_stands():
    made = asked("stiffness.turning_arm_bearing = '5e8 N/m'\n" + CONTACT)
    wider = made.design_with({"contact.face_width": 30 * mm})
    assert wider.stiffness.turning_arm_bearing == 5e8
    assert wider.stiffness.disc_pin_mesh == pytest.approx(1.5 * RV_320E.stiffness.disc_pin_mesh)
    assert wider.bearings.arm.roller_length == pytest.approx(1.5 * RV_320E.bearings.arm.roller_length)
    stiff = made.design_with({"contact.face_width": 30 * mm}, similar=False)
    assert stiff.stiffness.disc_pin_mesh == RV_320E.stiffness.disc_pin_mesh
    wheels = made.design_with({"involute.module": 1.1 * RV_320E.involute.module}, similar=False)
    assert wheels.cranks.circle_radius == pytest.approx(1.1 * RV_320E.cranks.circle_radius)
    assert wheels.stiffness.support_bearing == RV_320E.stiffness.support_bearing


def test_the_shortening_follows_and_the_rating_of_a_given_capacity():
    made = asked(CONTACT, base="rv-20e")
    assert made.design.cycloid.shortening == 0.72
    found = made.design_with({"cycloid.eccentricity": 0.8 * mm})
    assert found.cycloid.shortening_coefficient == pytest.approx(0.8 * 40 / 52)
    arm = RV_320E.bearings.arm.replace(capacity=30_000.0, static_capacity=40_000.0)
    design = asked(CONTACT).design
    design = design.replace(bearings=design.bearings.replace(arm=arm))
    wider = changed(design, {"contact.face_width": 25 * mm}).bearings.arm
    assert wider.capacity == pytest.approx(30_000 * 1.25 ** (7 / 9))
    assert wider.static_capacity == pytest.approx(50_000)


def test_without_values_the_design_is_that_of_the_study():
    made = asked(CONTACT)
    assert jax.tree.all(jax.tree.map(np.array_equal, made.design_with({}), made.design))


def test_derivatives_are_those_of_differences():
    made = asked(CONTACT)

    def disc_inertia(ring):
        return made.design_with({"cycloid.pin_circle_radius": ring}).inertia.disc_inertia

    at, step = 114 * mm, 1e-6
    due = (disc_inertia(at + step) - disc_inertia(at - step)) / (2 * step)
    assert jax.grad(disc_inertia)(at) == pytest.approx(float(due), rel=1e-7)


def test_one_harmonic_is_an_element():
    made = asked(CONTACT + '[design.cycloid]\nprofile_modification = ["0 um", "1 um", "0 um", "0 um"]\n')
    found = made.design_with({"cycloid.profile_modification[2]": jnp.asarray(2e-6)})
    np.testing.assert_allclose(found.cycloid.profile_modification, [0, 1e-6, 2e-6, 0])


def test_laws_that_are_used_and_their_interval():
    made = asked(CONTACT)
    used = FOLLOWING.called(made.design, ["contact.face_width"], made.given)
    numbers = [number for _, numbers in used for number in numbers]
    assert "stiffness.turning_arm_bearing" in numbers and "stiffness.support_bearing" not in numbers
    assert "cranks.bearing_stiffness" not in numbers  # the RV-320E has none
    assert all(law.source and 0 < law.interval[0] < 1 < law.interval[1] for law in LAWS)
    far = made.design_with({"contact.face_width": 50 * mm})
    assert "contact.face_width: 2.5 times" in outside(made.design, far, [law for law, _ in used])[0]
    assert outside(made.design, made.design, [law for law, _ in used]) == []


@pytest.mark.parametrize(
    ("path", "more", "words"),
    [
        ("cycloid.excentricity", "", "unknown number of the design"),
        ("cycloid.pin_count", "", "is an integer, 40"),
        ("involute.centre_distance", "", "follows from involute.module"),
        ("cycloid.shortening", "", "follows from eccentricity and pin circle radius"),
        ("contact.pin_support", CONTACT, "has no contact.pin_support"),
        ("involute.module", 'involute.centre_distance = "63 mm"\n', "centre_distance is given, but follows it"),
        ("cycloid.eccentricity", "cycloid.shortening = 0.7\n", "shortening is given, but follows it"),
        ("cycloid.eccentricity[0]", "", "is one number"),
        ("cycloid..x", "", "unknown number|must be a path"),
    ],
)
def test_what_cannot_vary_is_one_line(path, more, words):
    made = asked(more)
    with pytest.raises(ValueError, match=words):
        refuse_variable(made.design, path, made.given)


def test_an_element_must_be_named():
    made = asked('[design.cycloid]\nprofile_modification = ["0 um", "1 um", "0 um", "0 um"]\n')
    for path in ("cycloid.profile_modification", "cycloid.profile_modification[4]"):
        with pytest.raises(ValueError, match=r"name one element, cycloid.profile_modification\[0\]"):
            refuse_variable(made.design, path, made.given)


def test_an_unknown_path_is_one_line():
    with pytest.raises(ValueError, match="unknown number of the design"):
        asked().design_with({"cycloid.excentricity": 1.0})


def test_laws_are_called_by_what_follows_another_law():
    """The crank circle follows the module of the gears; bearings and masses of the cranks follow the crank circle."""
    used = {
        law.name for law, _ in FOLLOWING.called(study.load("rv-40e-whole", solve=False).design, ["involute.module"])
    }
    circle = {law.name for law in LAWS if "cranks.circle_radius" in law.follows}
    assert "gears" in used and "support bearings" in used & circle
