"""Fit without load: does a single-stage drive turn, or does it jam? Against a linear programme and closed forms."""

import copy

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cycloidal_cases import NAMED, design_of, dictionaries, drawn, errors_of, placed

from oracles import cycloidal as oracle
from rvjax import CycloidalErrors, RVErrors, Status
from rvjax.catalogue import RV_40E
from rvjax.loaded import clearance as fit, unchecked
from rvjax.loaded.cycloidal_fit import largest_gap, lines
from rvjax.units import um

TWO = design_of(NAMED["c17: fit, errors"]["design"])
THREE = TWO.replace(cycloid=TWO.cycloid.replace(disc_count=3))
SIZES, LANES = (3, 18, 17, 6), 40


def clearance(design, errors, samples=6):
    return fit(design, errors, turns=None, samples=samples)


def of_one_program(design, errors):
    """The same for errors at every place: one program for all cases of one size."""
    return clearance(*placed(design, errors))


@pytest.mark.parametrize("name", ["c17: fit, errors", "ring13: fit, errors"])
def test_the_reference(name):
    case = NAMED[name]
    found = of_one_program(design_of(case["design"]), errors_of(case["errors"]))
    assert case["options"]["samples"] == 6
    assert found.info.status == Status.CONVERGED and found.info.residual < 1e-7 * um
    np.testing.assert_allclose(found.at, case["expect"]["at"], rtol=1e-9, atol=1e-13)
    assert found.least == pytest.approx(case["expect"]["least"], rel=1e-9)


@jax.jit
@jax.vmap
def gap(errors, angle):
    return largest_gap(*lines(THREE, errors, angle))


def test_three_discs_share_one_carrier_as_in_a_linear_programme():
    """Holes of a disc turned by 60 um against its teeth, so that in many cases the carrier is the limit, not a disc."""
    rng = np.random.default_rng(2)
    drawn_ = [drawn(rng, SIZES, 8 * um) for _ in range(LANES)]
    for each in drawn_:
        each["hole_position"][..., 1] += 60 * um * rng.standard_normal((3, 1))
    angles = rng.uniform(-20, 20, LANES)
    found, left = gap(jax.tree.map(lambda *leaves: np.stack(leaves), *map(errors_of, drawn_)), angles)
    due = [oracle.fit(dictionaries(THREE), each, angle) for each, angle in zip(drawn_, angles)]
    np.testing.assert_allclose(found, due, rtol=0, atol=1e-6 * um)
    assert np.max(np.abs(left)) < 1e-9 * um
    single = [discs_alone(each, angle) for each, angle in zip(drawn_, angles)]
    shared = np.sum(np.asarray(found) < np.array(single) - 0.01 * um)
    assert np.all(np.asarray(found) <= np.array(single) + 1e-6 * um) and 5 <= shared <= 35


def discs_alone(errors, angle):
    """Least fit of the discs, each as the only one of its drive: disc k as the first after a turn of 2 pi k/nd."""
    at = oracle.drive(dictionaries(THREE), errors, angle)
    found = []
    for k in range(3):
        part = copy.copy(at)
        for name in ("b", "normal", "lever", "curvature", "pin_gap", "hole_gap", "centre_gap"):
            setattr(part, name, getattr(at, name)[k : k + 1])
        found.append(oracle.fit_of(part))
    return min(found)


def test_closed_forms():
    """Without errors the tighter of flank and holes is the fit; bearings do not help, a throw closes both."""
    for flank, hole, due in ((60, 70, 35), (20, 70, 20), (-8, 70, -8), (60, -10, -5)):
        design = TWO.replace(
            cycloid=TWO.cycloid.replace(equidistant_modification=flank * um),
            output=TWO.output.replace(hole_clearance=hole * um),
        )
        for errors in (CycloidalErrors(), CycloidalErrors(bearing_clearance=50 * um, support_clearance=20 * um)):
            assert of_one_program(design, errors).least == pytest.approx(due * um, abs=1e-9 * um)


def test_slopes_are_those_of_the_plain_value():
    """At input angle 0, where one pin has no lever; the limit is the carrier."""
    given = drawn(np.random.default_rng(7), SIZES, 8 * um)
    given["hole_position"][..., 1] += 200 * um * np.array([[1.0], [-1.0], [0.5]])
    errors, rng = jax.tree.map(lambda leaf: np.asarray(leaf, float), errors_of(given)), np.random.default_rng(8)
    ways = {
        name: 1e-3 * um * rng.standard_normal(getattr(errors, name).shape)
        for name in ("eccentricity", "equidistant_modification", "pin_offset", "throw", "eccentric_phase",
                     "hole_position", "output_pin_radius", "shaft_centre", "carrier_centre")
    }  # fmt: skip
    moved = [errors, *(errors.replace(**{n: getattr(errors, n) + s * way}) for n, way in ways.items() for s in (1, -1))]
    moved += [errors] * (LANES - len(moved))
    value, *ends = gap(jax.tree.map(lambda *leaves: np.stack(leaves), *moved), np.zeros(LANES))[0]
    assert value < discs_alone(given, 0.0) - 1 * um
    slopes = jax.jit(jax.grad(lambda errors: clearance(THREE, errors, 1).least))(errors)
    for number, (name, way) in enumerate(ways.items()):
        slope = float(np.sum(np.asarray(getattr(slopes, name)) * way))
        due = float(ends[2 * number] - ends[2 * number + 1]) / 2
        assert slope == pytest.approx(due, rel=1e-5, abs=1e-12 * um), name
    assert float(slopes.bearing_clearance) == 0.0


def test_a_case_that_cannot_be_has_a_status():
    def status(part, **changes):
        whole = unchecked(TWO, **{part: unchecked(getattr(TWO, part), **changes)})
        found = of_one_program(whole, CycloidalErrors())
        assert np.isnan(found.least) == (found.info.status != Status.CONVERGED)
        return Status(int(found.info.status))

    assert status("cycloid", shortening=0.9) == Status.CONVERGED  # not read
    assert status("cycloid", pin_radius=9e-3) == Status.UNDERCUT
    assert status("cycloid", pin_radius=-1.0) == Status.INVALID_GEOMETRY
    assert status("cycloid", eccentricity=3e-3) == Status.INVALID_GEOMETRY
    assert status("output", hole_clearance=-3.3e-3) == Status.INVALID_GEOMETRY
    assert status("output", hole_clearance=-2e-3) == Status.CONVERGED  # diametral, and the throw counts twice
    assert status("output", circle_radius=0.0) == Status.INVALID_GEOMETRY
    assert status("output", circle_radius=np.nan) == Status.NONFINITE
    assert of_one_program(TWO, CycloidalErrors(throw=np.nan)).info.status == Status.NONFINITE


def test_what_does_not_fit_together_is_an_error():
    with pytest.raises(ValueError, match="takes CycloidalErrors, got RVErrors"):
        clearance(TWO, RVErrors())
    with pytest.raises(ValueError, match="takes RVErrors, got CycloidalErrors"):
        clearance(RV_40E, CycloidalErrors())
    with pytest.raises(ValueError, match=r"CycloidalErrors.hole_radius: shape \(3, 6\)"):
        clearance(TWO, CycloidalErrors(hole_radius=np.zeros((3, 6))))
    with pytest.raises(ValueError, match=r"RVErrors.pin_radii: shape \(3,\)"):
        clearance(RV_40E, RVErrors(pin_radii=np.zeros(3)))
    with pytest.raises(ValueError, match="samples = 0"):
        clearance(TWO, CycloidalErrors(), 0)


def test_batches():
    """Every unit of a batch as if it were alone."""
    throws = jnp.asarray([0.0, 12e-6, -12e-6])

    @jax.jit
    @jax.vmap
    def at(throw):
        return clearance(TWO, CycloidalErrors(throw=jnp.stack([throw, throw / 2]), shaft_centre=throw), 2).at

    found = np.asarray(at(throws))
    for throw, mine in zip(np.asarray(throws), found):
        errors = {"throw": np.array([throw, throw / 2]), "shaft_centre": throw}
        due = [oracle.fit(dictionaries(TWO), errors, angle) for angle in (0.0, -17 * np.pi / 18)]
        np.testing.assert_allclose(mine, due, rtol=0, atol=1e-6 * um)
    assert len(np.unique(found.round(9))) > 3


def test_float32_gives_the_same_to_its_rounding():
    errors = drawn(np.random.default_rng(4), (2, 18, 17, 6), 8 * um)
    single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), errors_of(errors))
    found = clearance(TWO, single, 2)
    assert found.at.dtype == np.float32
    due = [oracle.fit(dictionaries(TWO), errors, angle) for angle in (0.0, -17 * np.pi / 18)]
    np.testing.assert_allclose(found.at, due, rtol=0, atol=0.02 * um)
