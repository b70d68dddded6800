"""Tolerances of errors with a place: words of drawings, a spectrum of pitch, bounds that follow from places."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import RVErrors, lost_motion
from rvjax.catalogue import RV_40E
from rvjax.population.population import Population
from rvjax.study import StudyError, parse_study
from rvjax.tolerances import Tolerance, for_design, rss, sample
from rvjax.units import um

TEXT = """
[design]
base = "rv-40e"
[tolerances.disc_centre]
runout = "15 um"
[tolerances.pin_ring]
position = "diametral 20 um"
batch = 0.4
[tolerances.disc_pitch]
cumulative = "19 um"
spectrum = [1, 0.5]
[tolerances.disc_bore]
position = "diametral 13 um"
distribution = "von_mises"
concentration = 2
[requirement.lost_motion]
upper = "2 arcmin"
[requirement.misfit]
upper = "30 um"
"""


def parsed(old="", new=""):
    assert old in TEXT
    return parse_study(TEXT.replace(old, new, 1) if old else TEXT, name="x.toml", solve=False)


def test_words_of_drawings_are_lengths_in_any_direction():
    """Half a runout; the radius of a zone; half of what lies between the highest and the lowest tooth."""
    found = parsed().tolerances
    for name, length, law in (
        ("disc_centre", 7.5, "rayleigh"),
        ("pin_offset", 10.0, "rayleigh"),
        ("disc_bore", 6.5, "von_mises"),
    ):
        tolerance = getattr(found, name)
        assert (tolerance.lower, tolerance.upper) == pytest.approx((0, length * um)), name
        assert tolerance.distribution == law and tolerance.is_vector
    assert found.pin_offset.batch == 0.4 and found.pin_offset.shape == (40, 2) and found.pin_radii is None
    assert found.disc_pitch.half_width == pytest.approx(9.5 * um) and found.disc_pitch.law.spectrum == (1.0, 0.5)


REFUSED = [
    ('runout = "15 um"', 'runout = "15 um"\nupper = "3 um"', ["disc_centre", "runout or upper"]),
    ('runout = "15 um"', 'runout = "15 kg"', ["tolerances.disc_centre.runout", "15 kg", "um"]),
    ('runout = "15 um"', 'runout = "-15 um"', ["tolerances.disc_centre.runout = '-15 um'", "negative"]),
    ('runout = "15 um"', 'runout = "15 um"\ndistribution = "normal"', ["disc_centre.distribution", "rayleigh"]),
    ("disc_centre", "bearing_clearance", ["bearing_clearance.runout = '15 um'", "only vectors", "disc_centre"]),
    ("disc_centre", "disc_profile", ["disc_profile.runout", "only vectors"]),
    ('"diametral 13 um"', '"13 um"', ["disc_bore.position = '13 um'", "diametral 20 um"]),
    ('"diametral 20 um"', '"diametral 20"', ["tolerances.pin_ring.position", "'20'"]),
    ('"diametral 20 um"\nbatch = 0.4', '"diametral 20 um"\nbatch = 1', ["pin_offset", "batch", "below 1"]),
    ("batch = 0.4", 'colour = "red"', ["tolerances.pin_ring.colour", "batch"]),
    ('position = "diametral 20 um"', "", ["tolerances.pin_ring", "position, radius or both"]),
    ("batch = 0.4", 'radius = "1 um"', ["tolerances.pin_radii", "do not use it", "loaded_transmission_error"]),
    ("[tolerances.disc_pitch]", "[tolerances.sun_runout]", ["sun_runout.cumulative", "disc_pitch"]),
    ("disc_centre", "sun_runout", ["tolerances.sun_runout", "do not use it", "loaded_transmission_error"]),
    ("spectrum = [1, 0.5]", "spectrum = [0, 0]", ["disc_pitch", "spectrum", "not all zero"]),
    ("[1, 0.5]", str([1] * 20), ["disc_pitch", "20 waves", "19"]),
    ("[1, 0.5]", "[1, 0.5]\nbatch = 0.2", ["disc_pitch", "batch", "spectrum"]),
    ("[requirement.l", '[tolerances.pin_offset]\nhalf_width = "1 um"\n[requirement.l', ["pin_offset", "pin_ring"]),
]


@pytest.mark.parametrize(("old", "new", "words"), REFUSED)
def test_bad_tolerances_are_one_clear_line(old, new, words):
    with pytest.raises(StudyError, match=r"^x\.toml: ") as caught:
        parsed(old, new)
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_pitch_has_the_waves_it_is_given():
    """Linear in z, so that the response to single z is the law: covariance = s^2 sum a_h^2 cos(h turn) / sum a_h^2."""
    tolerance = Tolerance.symmetric(9 * um, distribution="spectrum", spectrum=(1.0, 0.0, 0.5), shape=(2, 13))
    impulse = np.asarray(tolerance.deviate(jnp.eye(26).reshape(2, 13, 26))).reshape(26, 26)
    turn = 2 * np.pi * (np.arange(13)[:, None] - np.arange(13)) / 13
    due = (3 * um) ** 2 * (np.cos(turn) + 0.25 * np.cos(3 * turn)) / 1.25
    np.testing.assert_allclose(impulse @ impulse.T, np.kron(np.eye(2), due), atol=1e-14 * um)  # roundings of 9 um^2
    np.testing.assert_allclose(tolerance.law.correlation(tolerance), due / (3 * um) ** 2, atol=1e-14)


def test_spread_of_correlated_pitch():
    """rss of g . e is g' Sigma g, here of the closed form."""
    tolerances = {"pitch": Tolerance.symmetric(9 * um, distribution="spectrum", spectrum=(1.0, 0.5), shape=(7,))}
    weight = np.random.default_rng(0).normal(size=7)
    turn = 2 * np.pi * (np.arange(7)[:, None] - np.arange(7)) / 7
    due = (3 * um) ** 2 * weight @ ((np.cos(turn) + 0.25 * np.cos(2 * turn)) / 1.25) @ weight
    for order in (1, 2):
        found = rss(lambda errors: jnp.sum(weight * errors["pitch"]), tolerances, order=order)
        assert found.sd**2 == pytest.approx(due, rel=1e-12)


def test_bounds_follow_from_places():
    """Twice the longest eccentricity; the largest tangential offset; the largest range round a disc."""
    offset = np.zeros((40, 2))
    offset[3], offset[7] = (9 * um, -2 * um), (0, 1 * um)
    pitch = np.zeros((2, 39))
    pitch[1, 4], pitch[1, 20], pitch[0, 0] = 5 * um, -3 * um, 6 * um
    names = ("disc_runout", "pin_position", "disc_cumulative_pitch")
    errors = RVErrors(disc_centre=np.array([[3.0, -4.0], [0.0, 1.0]]) * um, pin_offset=offset, disc_pitch=pitch)
    found = errors.bounded(names)
    assert [float(getattr(found, name)) / um for name in names] == pytest.approx([10, 2, 8])
    assert found.disc_centre is errors.disc_centre and float(errors.bounded(("pin_position",)).disc_runout) == 0
    slope = jax.grad(lambda e: e.bounded(names).disc_runout)(RVErrors(disc_centre=np.zeros((2, 2))))
    np.testing.assert_array_equal(slope.disc_centre, 0.0)  # finite where nothing is off


def test_one_table_drives_the_bounded_and_the_placed_model():
    """The response of the lost motion is that of the bounds of the same unit; an own tolerance of a bound stays."""
    asked = parsed()
    response = asked.response()
    assert set(response.bounds) == {"disc_runout", "pin_position", "disc_cumulative_pitch"}
    unit = jax.jit(lambda number: sample(asked.tolerances, number, seed=1))(5)  # one program for all operations
    runout = 2 * np.linalg.norm(unit.disc_centre, axis=1).max()
    bounds = dict(disc_runout=runout, pin_position=np.abs(unit.pin_offset[:, 1]).max())
    bounds["disc_cumulative_pitch"] = np.ptp(unit.disc_pitch, axis=1).max()
    due = lost_motion.geometric(RV_40E, RVErrors(**bounds)).total
    assert float(response(unit).value["lost_motion"]) == pytest.approx(float(due), rel=1e-12)
    own = parsed("[tolerances.disc_c", '[tolerances.disc_runout]\nlower = "0 um"\nupper = "15 um"\n[tolerances.disc_c')
    assert "disc_runout" not in own.response().bounds
    assert any(re.search("disc_runout: disc_centre is the same error", line) for line in own.doubts)
    assert not any("same error" in line for line in asked.doubts)


def test_a_ring_of_pins_has_a_common_and_a_single_part():
    """Covariance of two pins over that of one: `batch`. 4000 units: correlations to 1/sqrt(4000), five of these."""
    ring = {"pin_offset": Tolerance(0.0, 10 * um, distribution="rayleigh", batch=0.4)}
    population = Population.of(for_design(RV_40E, **ring))
    z = population.draw(jax.random.key(0), jnp.arange(4000, dtype=jnp.uint32))
    pins = np.asarray(population.errors(z).pin_offset)[[0, 9]].reshape(4, -1)
    due = np.kron([[1, 0.4], [0.4, 1]], np.eye(2))
    np.testing.assert_allclose(np.corrcoef(pins), due, atol=5 / np.sqrt(4000))
