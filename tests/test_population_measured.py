"""Measured parts: figures against printed tables, intervals against simulation, correlation against its population."""

import itertools
import math
import re

import numpy as np
import pytest

from rvjax import catalogue, tolerances
from rvjax.population.distributions import Empirical
from rvjax.population.measured import _capability
from rvjax.population.population import Population
from rvjax.tolerances import (
    ReciprocalPower,
    Requirement,
    Tolerance,
    UnitFile,
    allocate,
    for_design,
    measured,
    monte_carlo,
)
from rvjax.units import deg, um

LOT = "Teil;pin_radius [µm];Bohrung;crank_phase [arcmin]\nA;1,0;12;3\nB;2,5;8;-1\nC;-0,5;;2\nD;4,0;10;0\nE;3,0;9;1\n"
COLUMNS = {"pin_radius": "pin_radius", "disc_bore[0,1,0]": {"column": "Bohrung", "unit": "um"}}


@pytest.fixture
def write(tmp_path):
    def text(content, name="lot.csv"):
        (tmp_path / name).write_text(content, "utf-8-sig")
        return tmp_path / name

    return text


def test_figures_of_a_lot_by_hand(write):
    """Five pins: mean 2, sd sqrt(3.125); four degrees: Student 2.776, chi-square 0.484 and 11.143 (printed tables)."""
    found = measured(write(LOT), COLUMNS, design=catalogue.RV_40E, limits={"pin_radius": (-2 * um, 5 * um)})
    pin, sd = found.columns["pin_radius"], math.sqrt(3.125) * um
    assert (pin.unit, pin.n, pin.minimum, pin.maximum) == ("m", 5, -0.5 * um, pytest.approx(4 * um))
    assert pin.mean.value == pytest.approx(2 * um) and pin.sd.value == pytest.approx(sd)
    assert pin.mean.upper - pin.mean.value == pytest.approx(2.776 * sd / math.sqrt(5), rel=2e-4)
    assert pin.sd.lower == pytest.approx(sd * math.sqrt(4 / 11.143), rel=2e-4)
    assert pin.sd.upper == pytest.approx(sd * math.sqrt(4 / 0.4844), rel=2e-4)
    cpk = 3 * um / (3 * sd)  # the upper limit is nearer
    assert pin.cpk.value == pytest.approx(cpk)
    assert pin.cpk.lower == pytest.approx(cpk - 1.959964 * math.sqrt(1 / 45 + cpk**2 / 8), rel=1e-6)
    assert pin.cpk.upper - pin.cpk.value == pytest.approx(pin.cpk.value - pin.cpk.lower)
    bore = found.columns["disc_bore[0,1,0]"]
    assert bore.n == 4 and bore.cpk is None and bore.limits is None and found.together == 4
    law = found.tolerances["pin_radius"]
    assert law.distribution == "empirical" and (law.lower, law.upper) == (-2 * um, 5 * um)
    np.testing.assert_allclose(law.law.values, np.array([-0.5, 1, 2.5, 3, 4]) * um)
    natural, shape = found.tolerances["disc_bore"], (2, 2, 2)
    assert natural.middle == pytest.approx(9.75 * um) and natural.shape == shape
    assert natural.half_width == pytest.approx(3 * np.std([12, 8, 10, 9], ddof=1) * um)
    assert for_design(catalogue.RV_40E, **found.tolerances).disc_bore.shape == shape
    everything = measured(write(LOT), design=catalogue.RV_40E)
    assert list(everything.columns) == ["pin_radius", "crank_phase"] and everything.columns["crank_phase"].unit == "rad"
    assert everything.columns["crank_phase"].maximum == pytest.approx(3 * deg / 60)


@pytest.mark.parametrize("capability", [0.4, 1.33])
def test_the_interval_of_cpk_holds_the_true_one(capability):
    """2000 lots of 50: 95 % and its binomial error of 0.5 %, four times, and 1.5 % for the normal approximation."""
    lots = np.random.default_rng(8).standard_normal((2000, 50))
    limits = (-9.0, 3 * capability)
    found = [_capability(lot.mean(), lot.std(ddof=1), 50, limits, 0.95) for lot in lots]
    held = np.mean([one.lower <= capability <= one.upper for one in found])
    assert abs(held - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 2000) + 0.015


def test_the_correlation_is_that_of_the_population_whatever_the_laws(write):
    """800 parts of a Gaussian copula with correlations 0.6 and -0.3: four errors (1 - r^2)/sqrt(n) of its estimate."""
    true = {("a", "b"): 0.6, ("b", "c"): -0.3, ("a", "c"): 0.0}
    root = np.linalg.cholesky([[1, 0.6, 0], [0.6, 1, -0.3], [0, -0.3, 1]])
    z = root @ np.random.default_rng(5).standard_normal((3, 800))
    laws = np.exp(0.8 * z[0]), z[1], np.arctan(5 * z[2])
    text = "a [um],b [um],c [um]\n" + "".join(",".join(map(str, row)) + "\n" for row in zip(*laws))
    lot = write(text)
    found = measured(lot)
    assert found.together == 800
    for pair, r in true.items():
        bound = 4 * (1 - r**2) / math.sqrt(800)
        assert abs(found.correlation[pair] - r) < bound
        assert found.pairs[pair].lower < found.pairs[pair].value < found.pairs[pair].upper
        assert found.pairs[pair].upper - found.pairs[pair].lower == pytest.approx(0.98 * bound, rel=0.2)
    # the same lot drawn again: its laws and its correlation
    again = UnitFile(lot.with_name("v.csv"), errors=True, units=dict.fromkeys("abc", "m"))
    options = dict(samples=800, seed=5, chunk=800, correlation=found.correlation, save=again)
    drawn = monte_carlo(lambda e: e["a"] + e["b"], found.tolerances, **options)
    other = measured(again.path, {name: f"{name} [m]" for name in "abc"})
    for pair in itertools.combinations("abc", 2):
        assert abs(other.pairs[pair].value - found.pairs[pair].value) < 4 / math.sqrt(800)
    expected = found.columns["a"].mean.value + found.columns["b"].mean.value
    assert abs(drawn.mean.value - expected) < 4 * drawn.mean.error


def test_columns_of_elements_are_one_law_and_correlate(write):
    rng = np.random.default_rng(2)
    first = rng.standard_normal(40)
    rows = zip(first, 0.9 * first + 0.3 * rng.standard_normal(40) + 5, rng.standard_normal(40))
    text = "b[0] [um],b[1] [um],a [um]\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    found = measured(write(text))
    assert found.tolerances["b"].shape == (2,) and len(found.tolerances["b"].law.values) == 80
    assert found.columns["b[1]"].mean.value - found.columns["b[0]"].mean.value == pytest.approx(5 * um, abs=0.5 * um)
    assert set(found.correlation) == {("b[0]", "b[1]"), ("b[0]", "a"), ("b[1]", "a")}
    assert Population.of(found.tolerances, found.correlation).mixing.shape == (3, 3)
    assert found.correlation["b[0]", "b[1]"] > 0.85
    limits = {"b": Tolerance(-9 * um, 9 * um, shape=(2,), batch=0.4, size=0.02), "a": Tolerance(-9 * um, 9 * um)}
    kept = measured(write(text), limits=limits).tolerances["b"]
    assert kept.batch == 0 and kept.size == 0.02 and kept.upper == 9 * um  # the pairs say how alike the elements are
    whole = measured(write(text), {"b": "b[0] [um]", "a": "a"}, limits=limits)
    assert whole.tolerances["b"].batch == 0.4 and whole.correlation == {}  # which element was it?


def test_too_few_parts_tell_no_correlation(write):
    found = measured(write("a [um],b [um],c [um]\n1,2,3\n2,1,5\n4,4,4\n"))
    assert found.pairs["a", "b"].lower == -1 and found.pairs["a", "b"].upper == 1  # three parts say nothing
    with pytest.raises(ValueError, match=r"lot\.csv: 3 parts with all of a, b, c do not give a correlation of 3"):
        _ = found.correlation
    same = measured(write("a [um],b [um]\n1,2\n2,4\n4,8\n5,1\n"))
    assert 0 < abs(same.correlation["a", "b"]) < 1


DIAL = "a [mm],b [mm]\n0.01,0.00\n0.01,0.00\n0.02,0.00\n" + 7 * "0.01,0.00\n"


def test_readings_that_are_equal_have_the_spread_of_a_step(write):
    """Ten readings of a dial of 0.01 mm: sd 0.01 mm/sqrt(12), chi-square 2.700 of nine degrees, lower end 0."""
    limits = {"a": (0.0, 20 * um), "b": (-10 * um, 10 * um)}
    with pytest.warns(UserWarning, match="different values, in steps of 0.01 mm") as said:
        found = measured(write(DIAL), limits=limits)
    assert [re.search("(.): 10 readings with (.) d", str(one.message)).groups() for one in said] == [
        ("a", "2"),
        ("b", "1"),
    ]
    two, one = found.columns["a"], found.columns["b"]
    assert (two.distinct, one.distinct) == (2, 1) and two.step == one.step == pytest.approx(10 * um)
    assert two.sd.value == pytest.approx(10 * um / math.sqrt(10)) and two.sd.lower > 0
    step = 10 * um / math.sqrt(12)
    assert one.sd.value == pytest.approx(step) and one.sd.lower == 0
    assert one.sd.upper == pytest.approx(step * math.sqrt(9 / 2.7004), rel=1e-4)
    assert one.cpk.value == pytest.approx(10 * um / (3 * step)) and 0 < one.cpk.lower < one.cpk.upper < math.inf
    assert one.mean.error == pytest.approx(step / math.sqrt(10))
    np.testing.assert_allclose(found.tolerances["b"].law.values, np.arange(-4.5, 5) * um, atol=1e-18)
    np.testing.assert_allclose(
        found.tolerances["a"].law.values[[0, 8, 9]], np.array([10 - 40 / 9, 10 + 40 / 9, 20]) * um
    )
    with pytest.raises(ValueError, match=r"lot\.csv: b: 10 equal readings do not vary: no correlation"):
        _ = found.correlation


@pytest.mark.parametrize(
    ("readings", "step"),
    [
        ("5,0;5,0;5,0;5,0", 0.1),  # the last digit, with a decimal comma
        ("12;12;12", 1.0),
        ("3;3.0;3", 0.1),  # the finest of them
        ("0.005;0.005;0.005;0.010;0.005;0.005;0.005;0.005;0.005;0.005;0.005;0.005;0.005", 0.005),  # steps of five
        ("3e-1;3e-1;3e-1", 0.1),
    ],
)
def test_the_step_of_an_instrument_is_read_from_its_readings(write, readings, step):
    with pytest.warns(UserWarning, match="in steps of"):
        found = measured(write("a [um];b\n" + ";x\n".join(readings.split(";")) + ";x\n"))
    assert found.columns["a"].step == pytest.approx(step * um)
    assert found.columns["a"].sd.value == pytest.approx(step * um / math.sqrt(12))


def test_readings_finer_than_their_spread_stay_as_they_are(write):
    """Two parts of a fine instrument; integers that repeat, but spread over more than a step."""
    for text, step in (("10.123\n10.456\n", 0.001), ("1\n1\n2\n3\n3\n4\n1\n5\n", 1.0)):
        found = measured(write("a [um]\n" + text))
        given = np.sort([float(line) for line in text.split()]) * um
        np.testing.assert_allclose(found.tolerances["a"].law.values, given, rtol=1e-12)
        assert found.columns["a"].sd.value == pytest.approx(given.std(ddof=1))
        assert found.columns["a"].step == pytest.approx(step * um)


def test_a_positive_error_is_never_spread_below_zero(write):
    text = "bearing_clearance [mm]\n" + "0.00\n" * 6
    with pytest.warns(UserWarning, match="bearing_clearance: 6 readings with 1 different"):
        found = measured(write(text), design=catalogue.RV_40E).tolerances["bearing_clearance"].law.values
    assert found.min() == 0.0 and found.max() == pytest.approx(5 / 12 * 10 * um)


COSTS = {name: ReciprocalPower(finest=1 * um, coarsest=100 * um) for name in "ab"}


def test_a_lot_without_spread_does_not_open_to_the_coarsest(write):
    """Ten values 1 um apart at a half-width of 10 um: 85 % of units lie within 4.25 um, and within 30 um at 70.6 um."""
    limits = {"a": Tolerance(0.0, 1 * um), "b": Tolerance(-10 * um, 10 * um)}
    with pytest.warns(UserWarning, match="in steps of"):
        lot = measured(write(DIAL), {"b": "b"}, limits=limits).tolerances
    requirement = Requirement(lower=-30 * um, upper=30 * um, target=0.85)
    options = dict(samples=2048, certificate_samples=20_000)
    found = allocate(lambda e: e["b"], lot, requirement, costs={"b": COSTS["b"]}, **options)
    assert found.status == "OPTIMAL"
    assert found.tolerances["b"].half_width == pytest.approx(30 / 4.25 * 10 * um, rel=0.02)
    equal = limits | {"b": Tolerance(-10 * um, 10 * um, distribution="empirical", values=[1e-7] * 10)}
    with pytest.raises(ValueError, match="tolerances: b does not vary: empirical values that are all equal"):
        allocate(lambda e: e["a"] + e["b"], equal, requirement, costs=COSTS, **options)


def test_a_study_takes_equal_readings_of_a_file_as_steps(write):
    about = {"file": str(write(DIAL)), "column": "b [mm]"}
    np.testing.assert_allclose(Empirical.parsed("values", about, "m"), np.arange(-4.5, 5) * um, atol=1e-18)


@pytest.mark.parametrize(
    ("text", "columns", "words"),
    [
        (LOT, {"pin_radius": "pins"}, "columns.pin_radius = 'pins': no column of the file; it has Teil, pin_radius"),
        (LOT, {"pin_radius": "Bohrung"}, "column 'Bohrung': has no unit; write \"pin_radius [m]\""),
        (LOT, {"pin_radius": "crank_phase"}, 'in another one, under "pin_radius [m]" (m, mm, um, cm)'),
        (LOT, {"pin": "pin_radius"}, "columns: 'pin' is no error of this design; it has"),
        (LOT, {"disc_bore[0,1]": COLUMNS["disc_bore[0,1,0]"]}, "'disc_bore[0,1]' is no element of shape (2, 2, 2)"),
        (LOT, {"pin_radius": "Teil [um]"}, "no column of the file"),
        ("x [kg]\n1\n2\n", None, 'no column is called as an error with its unit, such as "pin_radius [um]"'),
        ("pin_radius [um]\n1\n", None, "pin_radius: 1 parts measured, at least 2 are needed"),
        ("pin_radius [um]\n1\nzwei\n", None, "row 3, pin_radius = 'zwei': must be a number in um"),
        ("disc_runout [um];Bohrung\n1;x\n", {"disc_bore": COLUMNS["disc_bore[0,1,0]"]}, "row 2, disc_bore = 'x'"),
    ],
)
def test_bad_tables_are_one_line(write, text, columns, words):
    with pytest.raises(ValueError, match=re.escape(words)) as error:
        measured(write(text), columns, design=catalogue.RV_40E)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("upper", [5 * um, -3 * um])
def test_a_limit_on_one_side_has_its_capability(write, upper):
    """Mean 2, sd sqrt(3.125); the other end of the tolerance is that of an error without limits, or the limit."""
    found = measured(write(LOT), COLUMNS, design=catalogue.RV_40E, limits={"pin_radius": (-math.inf, upper)})
    sd, law = math.sqrt(3.125) * um, found.tolerances["pin_radius"]
    assert found.columns["pin_radius"].cpk.value == pytest.approx((upper - 2 * um) / (3 * sd))
    assert law.upper == upper and law.lower == pytest.approx(min(2 * um - 3 * sd, upper))
    open_ = measured(write(LOT), COLUMNS, design=catalogue.RV_40E, limits={"pin_radius": (-math.inf, math.inf)})
    assert open_.columns["pin_radius"].cpk is None


def test_limits_that_are_none_are_refused(write):
    with pytest.raises(ValueError, match=r"limits: pin_radius = 3: must be a Tolerance, or \(lower, upper\) in SI"):
        measured(write(LOT), COLUMNS, limits={"pin_radius": 3})
    both = {"disc_bore": COLUMNS["disc_bore[0,1,0]"], "disc_bore[0,1,0]": "pin_radius"}
    with pytest.raises(ValueError, match="disc_bore has both a column and columns of elements"):
        measured(write(LOT), both, design=catalogue.RV_40E)
    assert tolerances.measured is measured
