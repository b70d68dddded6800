"""Fit without load: does a single-stage drive turn, or does it jam? Against a linear programme and closed forms.

One program serves all fits of two discs, with their slopes, and one all gaps of three.
"""

import copy

import jax
import numpy as np
import pytest
from cycloidal_cases import NAMED, SAMPLES, design_of, dictionaries, drawn, errors_of, fits, fits_with_slopes, placed
from scipy import optimize

from rvjax import CycloidalErrors, RVErrors, Status
from rvjax.catalogue import RV_40E
from rvjax.loaded import clearance, unchecked
from rvjax.loaded.cycloidal_gaps import lines
from rvjax.loaded.geometry import Lines, largest_gap
from rvjax.units import um
from tests.oracles import cycloidal as oracle

TWO = design_of(NAMED["c17: fit, errors"]["design"])
THREE = TWO.replace(cycloid=TWO.cycloid.replace(disc_count=3))
SIZES, LANES = (3, 18, 17, 6), 40


ANGLES = -17 * np.pi / 18 * 2 * np.arange(SAMPLES) / SAMPLES


@pytest.mark.parametrize("name", ["c17: fit, errors", pytest.param("ring13: fit, errors", marks=pytest.mark.long)])
def test_the_reference(name):
    case = NAMED[name]
    given = design_of(case["design"]), errors_of(case["errors"])
    assert case["options"]["samples"] == SAMPLES
    found = fits(given)[0] if name.startswith("c17") else clearance(*placed(*given), samples=SAMPLES)
    assert found.info.status == Status.CONVERGED and found.info.residual < 1e-7 * um
    np.testing.assert_allclose(found.at, case["expect"]["at"], rtol=1e-9, atol=1e-13)
    assert found.least == pytest.approx(case["expect"]["least"], rel=1e-9)


def gap(errors, angle):
    return largest_gap(*lines(THREE, errors, angle))


gaps = jax.jit(jax.vmap(gap))


def test_three_discs_share_one_carrier_as_in_a_linear_programme():
    """Holes of a disc turned by 60 um against its teeth, so that in many cases the carrier is the limit, not a disc."""
    rng = np.random.default_rng(2)
    drawn_ = [drawn(rng, SIZES, 8 * um) for _ in range(LANES)]
    for each in drawn_:
        each["hole_position"][..., 1] += 60 * um * rng.standard_normal((3, 1))
    angles = rng.uniform(-20, 20, LANES)
    found, left = gaps(stacked(drawn_), angles)
    due = [oracle.fit(dictionaries(THREE), each, angle) for each, angle in zip(drawn_, angles)]
    np.testing.assert_allclose(found, due, rtol=0, atol=1e-6 * um)
    assert np.max(np.abs(left)) < 1e-9 * um
    single = [discs_alone(THREE, each, angle) for each, angle in zip(drawn_, angles)]
    shared = np.sum(np.asarray(found) < np.array(single) - 0.01 * um)
    assert np.all(np.asarray(found) <= np.array(single) + 1e-6 * um) and 5 <= shared <= 35


def random_lines(count):
    """Gaps of any size over levers of two discs, with holes turned against their teeth: four passes are needed."""
    rng = np.random.default_rng(0)
    phase, turned, size = rng.uniform(0, 2 * np.pi, (count, 1, 1)), np.pi * np.arange(2)[:, None], 20 * um
    pins, holes = (np.sin(2 * np.pi * np.arange(n) / n + k * phase + turned) for n, k in ((18, 1), (6, 17)))
    gaps = [size * rng.standard_normal((count, 2, n)) for n in (18, 6)]
    gaps[1] += 3 * size * rng.standard_normal((count, 2, 1)) * holes
    return Lines(gaps[0], 5e-3 * pins), Lines(gaps[1], 0.02 * holes)


COUNT = 120


def programme(pins, holes):
    """Most s with s + lever beta_k <= gap of pins, s + lever (beta_k - alpha) <= gap of holes; lengths in um."""
    rows = []
    for k, (of_pins, of_holes) in enumerate(zip(pins.lever, holes.lever)):
        rows += [[1, *(lever * (k == i) for i in range(2)), 0] for lever in of_pins]
        rows += [[1, *(lever * (k == i) for i in range(2)), -lever] for lever in of_holes]
    due = np.concatenate([np.concatenate(each) for each in zip(pins.gap, holes.gap)]) / um
    return -optimize.linprog([-1, 0, 0, 0], A_ub=rows, b_ub=due, bounds=[(None, None)] * 4).fun * um


def test_the_tangents_end_at_the_linear_programme_and_say_where_they_do_not(monkeypatch):
    """With one pass the value is an upper bound, and the lower bound that comes with it is below the programme."""
    cases = random_lines(COUNT)
    due = np.array([programme(*jax.tree.map(lambda x, i=i: x[i], cases)) for i in range(COUNT)])
    found, left = jax.jit(jax.vmap(largest_gap))(*cases)
    np.testing.assert_allclose(found, due, rtol=0, atol=1e-6 * um)
    assert np.max(np.abs(left)) < 1e-9 * um
    monkeypatch.setattr("rvjax.loaded.geometry.STEPS", 1)
    found, left = jax.jit(jax.vmap(largest_gap))(*jax.tree.map(lambda x: x[:-1], cases))  # another program
    assert np.all(found > due[:-1] - 1e-6 * um) and np.max(found - due[:-1]) > 10 * um
    assert np.all(found - left < due[:-1] + 1e-6 * um) and np.max(left) > 10 * um


def stacked(drawn_):
    """Errors of all cases, without those that no fit reads."""
    each = [placed(THREE, errors_of(errors))[1] for errors in drawn_]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *each)


def discs_alone(design, errors, angle):
    """Least fit of the discs, each as the only one of its drive: disc k as the first after a turn of 2 pi k/nd."""
    at = oracle.drive(dictionaries(design), errors, angle)
    found = []
    for k in range(design.cycloid.disc_count):
        part = copy.copy(at)
        for name in ("b", "normal", "lever", "curvature", "pin_gap", "hole_gap", "centre_gap"):
            setattr(part, name, getattr(at, name)[k : k + 1])
        found.append(oracle.fit_of(part))
    return min(found)


def test_closed_forms():
    """Without errors the tighter of flank and holes is the fit; bearings do not help, a throw closes both."""
    cases, due = [], []
    for flank, hole, least in ((60, 70, 35), (20, 70, 20), (-8, 70, -8), (60, -10, -5)):
        design = TWO.replace(
            cycloid=TWO.cycloid.replace(equidistant_modification=flank * um),
            output=TWO.output.replace(hole_clearance=hole * um),
        )
        for errors in (CycloidalErrors(), CycloidalErrors(bearing_clearance=50 * um, support_clearance=20 * um)):
            cases.append((design, errors))
            due.append(least)
    np.testing.assert_allclose([found.least / um for found in fits(*cases)], due, rtol=0, atol=1e-9)


def test_slopes_are_those_of_the_plain_value():
    """At input angle 0, where one pin has no lever; the limit is the carrier."""
    given = drawn(np.random.default_rng(7), (2, *SIZES[1:]), 8 * um)
    given["hole_position"][..., 1] += 200 * um * np.array([[1.0], [-1.0]])
    errors, rng = placed(TWO, errors_of(given))[1], np.random.default_rng(8)
    ways = {
        name: 1e-3 * um * rng.standard_normal(np.shape(getattr(errors, name)))
        for name in ("eccentricity", "equidistant_modification", "pin_offset", "throw", "eccentric_phase",
                     "hole_position", "output_pin_radius", "shaft_centre", "carrier_centre")
    }  # fmt: skip
    moved = [errors.replace(**{n: getattr(errors, n) + s * way}) for n, way in ways.items() for s in (1, -1)]
    along = [placed(TWO, CycloidalErrors().replace(**{name: way}))[1] for name, way in ways.items()]
    still = placed(TWO, CycloidalErrors(bearing_clearance=1.0))[1]
    found = [(TWO, errors, way) for way in (*along, still)]
    found = fits_with_slopes(*found[:8]) + fits_with_slopes(*found[8:])
    ends = [each.at[0] for some in (moved[:8], moved[8:16], moved[16:]) for each in fits(*((TWO, e) for e in some))]
    assert found[0][0].at[0] < discs_alone(TWO, given, 0.0) - 1 * um
    for number, name in enumerate(ways):
        due = float(ends[2 * number] - ends[2 * number + 1]) / 2
        assert found[number][1] == pytest.approx(due, rel=1e-5, abs=1e-12 * um), name
    assert found[-1][1] == 0.0
    three = placed(THREE, errors_of(drawn(np.random.default_rng(7), SIZES)))[1]
    jax.eval_shape(jax.grad(gap, has_aux=True), three, jax.numpy.zeros(()))  # in reverse mode, too


def test_a_case_that_cannot_be_has_a_status():
    """Beside cases that can be."""
    changed = [
        (Status.CONVERGED, "cycloid", dict(disc_phase=0.1)),  # not read, nor is the shortening
        (Status.UNDERCUT, "cycloid", dict(pin_radius=9e-3)),
        (Status.INVALID_GEOMETRY, "cycloid", dict(pin_radius=-1.0)),
        (Status.INVALID_GEOMETRY, "cycloid", dict(eccentricity=3e-3)),
        (Status.INVALID_GEOMETRY, "output", dict(hole_clearance=-3.3e-3)),
        (Status.CONVERGED, "output", dict(hole_clearance=-2e-3)),  # diametral, and the throw counts twice
        (Status.INVALID_GEOMETRY, "output", dict(circle_radius=0.0)),
        (Status.NONFINITE, "output", dict(circle_radius=np.nan)),
    ]
    made = [unchecked(TWO, **{part: unchecked(getattr(TWO, part), **new)}) for _, part, new in changed]
    found = fits(*((design, CycloidalErrors()) for design in made))
    found += fits((TWO, CycloidalErrors(throw=np.nan)))
    assert [Status(int(each.info.status)) for each in found] == [*(status for status, *_ in changed), Status.NONFINITE]
    assert [bool(np.isnan(each.least)) for each in found] == [each.info.status != Status.CONVERGED for each in found]


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
        clearance(TWO, CycloidalErrors(), samples=0)


def test_batches():
    """Every unit of a batch as if it were alone."""
    every = [{"throw": np.array([t, t / 2]), "shaft_centre": t} for t in (0.0, 12e-6, -12e-6)]
    found = [each.at for each in fits(*((TWO, errors_of(errors)) for errors in every))]
    due = [[oracle.fit(dictionaries(TWO), errors, angle) for angle in ANGLES] for errors in every]
    np.testing.assert_allclose(found, due, rtol=0, atol=1e-6 * um)
    assert len(np.unique(np.round(found, 9))) > 3


@pytest.mark.long  # types of results follow those of inputs: test_records.py and test_batching.py
def test_float32_gives_the_same_to_its_rounding():
    errors = drawn(np.random.default_rng(4), (2, *SIZES[1:]), 8 * um)
    single = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), errors_of(errors))
    found = clearance(TWO, single, samples=2)
    assert found.at.dtype == np.float32
    due = [oracle.fit(dictionaries(TWO), errors, angle) for angle in ANGLES[[0, 3]]]
    np.testing.assert_allclose(found.at, due, rtol=0, atol=0.02 * um)
