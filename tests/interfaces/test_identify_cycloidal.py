"""Bench of a single-stage drive whose ring is the output: identified errors, tables of a controller, bad files.

The curves are revolutions of a known unit, sampled finely; a corrected command is proved by equilibria at its angles.
"""

import functools
import json

import jax
import numpy as np
import pytest
from cycloidal_cases import placed

from rvjax import CycloidalErrors, cli, compensation, loaded, models, study
from rvjax.catalogue import CYCLOIDAL_15, CYCLOIDAL_17
from rvjax.loaded import observation
from rvjax.loaded.equilibrium import error_alone
from rvjax.render import Figure
from rvjax.study.identification import part_orders
from rvjax.units import arcsec, um

STUDY = """
[design]
base = "cycloidal-17"
member = "ring"
cycloid.disc_count = 1
[conditions]
output_torque = "4 N m"
rated_torque = "4 N m"
samples = 24
[tolerances.ring_centre]
position = "diametral 40 um"
[tolerances.shaft_centre]
position = "diametral 40 um"
[tolerances.carrier_centre]
position = "diametral 40 um"
[tolerances.bearing_clearance]
lower = "0 um"
upper = "20 um"
[tolerances.hole_radius]
half_width = "10 um"
[identify]
model = "loaded"
orders = [17, 18]
noise = "1 arcsec"
nuisance = ["offset"]
[identify.unknown.eccentric_bearing]
lower = "10 N/um"
upper = "50 N/um"
"""
TRUTH = {
    "ring_centre[0]": 9 * um, "ring_centre[1]": -4 * um, "shaft_centre[0]": -3 * um, "shaft_centre[1]": 7 * um,
    "carrier_centre[0]": 5 * um, "carrier_centre[1]": 8 * um, "bearing_clearance": 6 * um, "eccentric_bearing": 25e6,
    "offset": 40 * arcsec,
}  # fmt: skip
POINTS = 900


@pytest.fixture(scope="module")
def unit():
    """A drive and its errors, holes among them."""
    design = study.parse_study(STUDY, name="unit", solve=False).design
    design = design.replace(stiffness=design.stiffness.replace(eccentric_bearing=TRUTH["eccentric_bearing"]))
    centres = {
        name: [TRUTH[f"{name}[{k}]"] for k in (0, 1)] for name in ("ring_centre", "shaft_centre", "carrier_centre")
    }
    holes = 3 * um * np.random.default_rng(3).standard_normal((1, 6))
    errors = {name: np.array(value) for name, value in centres.items()} | {"hole_radius": holes}
    return design, CycloidalErrors.for_design(design, bearing_clearance=TRUTH["bearing_clearance"], **errors)


@pytest.fixture(scope="module")
def error(unit):
    """Errors at some input angles under a torque, by one program for any number of them up to that of a turn."""
    design, own = unit
    layout = loaded.check_input(design, own, "hertz", "fixed", "fixed")
    at = jax.jit(jax.vmap(functools.partial(error_alone, layout), (None, None, 0, None)))

    def found(angle, torque, errors=own):
        every = np.asarray(at(*placed(design, errors), np.resize(angle, POINTS), torque))
        assert np.all(np.isfinite(every))
        return every[: len(angle)]

    return found


@pytest.fixture(scope="module")
def turns(unit, error):
    """Errors over a turn of the output, forward and backward."""
    return [error(unit[0].ratio * 2 * np.pi * np.arange(POINTS) / POINTS, torque) for torque in (4.0, -4.0)]


@pytest.fixture(scope="module")
def here(tmp_path_factory, turns):
    """A folder with the study and the curves of both directions, 1 arcsec of noise in every part of an order."""
    folder, rng = tmp_path_factory.mktemp("drive"), np.random.default_rng(4)
    rows = ["angle [deg],error [arcsec],torque [N m],direction"]
    for turn, word in zip(turns, ("forward", "backward")):
        error = (turn + TRUTH["offset"]) / arcsec + np.sqrt(POINTS / 2) * rng.standard_normal(POINTS)
        rows += [f"{360 * k / POINTS:.6f},{value:.4f},4,{word}" for k, value in enumerate(error)]
    (folder / "unit.toml").write_text(STUDY)
    (folder / "unit.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture(autouse=True)
def there(here, monkeypatch):
    monkeypatch.chdir(here)
    monkeypatch.setattr(Figure, "content", lambda *_: b"")


@pytest.mark.long  # its program is twice those of the curves; test_cli_identify.py finds the errors of an RV reducer
def test_the_errors_of_a_drive_are_found(here):
    """The ring acts at order zc, shaft and carrier at order zp; only their sum is seen well, and no single hole is."""
    assert cli.main(["identify", "unit.toml", "unit.csv", "--quiet", "--results", "out"]) == 0
    found = json.loads((here / "out" / "result.json").read_text())
    assert found["adequate"] is True and found["fit"]["p_model"] > 0.01
    for name, value in TRUTH.items():
        half = (found["upper"][name] - found["lower"][name]) / 2
        assert abs(found["value"][name] - value) < 2 * half, name  # four standard deviations
    width = {name: found["upper"][name] - found["lower"][name] for name in TRUTH}
    assert all(width[f"ring_centre[{k}]"] < 0.5 * um < 2 * um < width[f"carrier_centre[{k}]"] for k in (0, 1))
    pairs = {frozenset(pair[:2]) for pair in found["inseparable"]}
    assert {frozenset((f"shaft_centre[{k}]", f"carrier_centre[{k}]")) for k in (0, 1)} <= pairs
    assert {found["verdict"][f"hole_radius[0,{m}]"] for m in range(6)} == {"unseen"}
    assert found["verdict"]["bearing_clearance"] == "identified"
    shares = found["shares"]
    assert shares["order 017"]["ring_centre"] > 0.9 > 0.05 > abs(shares["order 017"]["shaft_centre"])
    assert abs(shares["order 018"]["ring_centre"]) < 0.05


def test_a_table_corrects_the_output(here, error, turns):
    """Equilibria at the corrected angles of the shaft; the order of the holes, 108, is above three times the pins.

    The error arises at the corrected angle: there the waves of the curve, whose shortest ones are not resolved.
    """
    assert cli.main(["compensate", "unit.toml", "unit.csv", "--quiet", "--export", "t.json", "--results", "made"]) == 0
    angle = 2 * np.pi * np.arange(0, POINTS, 15) / POINTS
    curves = json.loads((here / "made" / "result.json").read_text())["curves"]
    for sign, curve, whole in zip((1, -1), curves, turns):
        table = compensation.read(f"t-4_N_m_{curve['direction']}.json")
        assert table.ratio == 18 and {17, 18, 36, 90, 108} <= set(table.orders) == set(curve["order"])
        correction = np.interp(angle, table.angle, table.correction)
        command = 18 * angle + correction
        after = command / 18 + error(command, 4.0 * sign) - angle
        waves = 2 * np.fft.rfft(whole)[:-1] / POINTS
        waves[0] /= 2
        there = np.real(np.exp(1j * np.outer(command / 18, np.arange(len(waves)))) @ waves)
        assert np.std(after - there - correction / 18) < 1.5 * arcsec
        assert abs(np.mean(after - whole[::15])) < 3 * arcsec  # a table holds no mean
        assert np.std(whole) > 50 * arcsec and np.std(after) < 0.15 * np.std(whole)


def test_the_housing_makes_its_own_orders_only(unit, error):
    """Exact at any size of the errors: a carrier at rest with random pins makes multiples of zp."""
    design, rng = unit[0], np.random.default_rng(8)
    fixed = {"carrier_centre": 20 * um * rng.standard_normal(2), "shaft_centre": 20 * um * rng.standard_normal(2)}
    pins = {"output_pin_offset": 20 * um * rng.standard_normal((6, 2)), "bearing_clearance": np.asarray(6 * um)}
    fixed |= pins | {"ring_centre": np.zeros(2), "hole_radius": np.zeros((1, 6))}
    curve = error(design.ratio * 2 * np.pi * np.arange(900) / 900, 4.0, CycloidalErrors.for_design(design, **fixed))
    waves = 2 * np.abs(np.fft.rfft(curve)) / 900
    alone = list(part_orders(design, range(1, 450)))
    assert {17, 34, 51} < set(alone) and not {18, 36, 108} & set(alone)
    assert waves[18] > 20 * arcsec and np.max(waves[alone]) < 1e-6 * waves[18]
    assert part_orders(CYCLOIDAL_15, (15, 16, 17, 18)) == (16, 17)  # the ring at rest: holes and teeth have 3 in common


def test_the_curve_of_another_reducer_is_noticed(here, capsys):
    """Orders of 39 teeth and 40 pins on a drive with 18; the measured curves of the drive itself say nothing."""
    at = np.arange(720) * np.pi / 360
    lines = {2: 9.0, 39: 12.0, 40: 20.0, 80: 6.0, 36: 3.0}
    values = sum(size * np.cos(k * at + k) for k, size in lines.items()) + np.random.default_rng(1).normal(size=720)
    rows = [f"{180 * x / np.pi:.6f},{value:.4f}" for x, value in zip(at, values)]
    (here / "other.csv").write_text("\n".join(["angle [deg],error [arcsec]", *rows]) + "\n")
    assert cli.main(["compensate", "unit.toml", "other.csv", "--quiet", "--results", "other"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "no part of this drive" in line]
    assert line.startswith("warning: orders 39, 40, 80") and "not multiples of 17 or 18" in line
    rms = float(line.split("they have")[1].split()[0])
    assert rms == pytest.approx(np.hypot.reduce([12, 20, 6]) / np.sqrt(2), rel=0.02)
    assert cli.main(["compensate", "unit.toml", "unit.csv", "--quiet", "--results", "own"]) == 0
    assert "no part of this drive" not in capsys.readouterr().out


LINES = {17: 5.0, 18: 4.0, 108: 18.0, 216: 5.0, 306: 2.0, 324: 2.0, 432: 1.0, 540: 0.6, 612: 0.4, 648: 0.4}


@pytest.mark.parametrize("member", ["carrier", "ring"])
def test_orders_of_the_passing_holes_are_not_mistaken(monkeypatch, member):
    """The error is told by a formula over the turn of the output; the angles are few, none of its lines is aliased."""
    calls = []

    def told(layout, design, errors, angle, torque):
        calls.append(angle)
        lines = [k for k in LINES if k % 18 == 0 or not alike]
        return torque * sum(LINES[k] * jax.numpy.cos(k * angle / design.ratio + k) for k in lines)

    monkeypatch.setattr(observation, "error_alone", told)
    design = CYCLOIDAL_17.replace(member=member)
    curve = models.kind(design).observations("loaded")["curve"]
    given = models.kind(design).conditions(output_torque=8.8, samples=12)
    for alike, orders in ((False, (17, 18, 36)), (True, (18, 36)), (False, (108,)), (False, tuple(range(1, 41)))):
        predict = jax.jit(lambda torques: curve.predict(design, CycloidalErrors(), given, torques, orders, alike))  # noqa: B023
        mean, found = predict(np.array([2.0, -1.0]))
        due = np.array([LINES.get(k, 0.0) * np.exp(1j * k) for k in orders])
        np.testing.assert_allclose(found, [2 * due, -due], atol=1e-9)
        np.testing.assert_allclose(mean, 0, atol=1e-9)
    assert len(calls) == 4


def curve_of(points, text="angle [deg],error [arcsec]"):
    rng = np.random.default_rng(0)
    return "\n".join([text, *(f"{360 * k / points:.6f},{rng.normal():.3f}" for k in range(points))]) + "\n"


@pytest.mark.parametrize(
    ("change", "data", "words"),
    [
        (('["offset"]', '["reading"]'), "", "the deformed housing is modelled for RV reducers only; an eccentric"),
        (('"loaded"', '"four_bar"'), "", "identify.model = 'four_bar': must be one of loaded"),
        (("unknown.eccentric_bearing", "unknown.pin_support"), "", "'output.pin_support' or 'contact.pin_support'"),
        (("unknown.eccentric_bearing", "unknown.pin_radius"), "", "an error of the parts; write its limits in [tole"),
        (("unknown.eccentric_bearing", "unknown.sun_support"), "", "no number of this design"),
        (("[17, 18]", "[18]"), curve_of(90), "90 points: order 108 (holes) looks like order 18"),
        (("[17, 18]", "[17, 18]"), curve_of(30), "a gap of 12 deg in the angle; order 18 needs at most 10 deg"),
        (("[17, 18]", "[17, 18]"), "frequency [Hz]\n20\n30\n", "identify.model = 'loaded' takes curve or loop"),
        (('member = "ring"', 'member = "sun"'), "", "design.member = 'sun': must be one of carrier, ring"),
    ],
)
def test_bad_input_is_one_line(here, capsys, change, data, words):
    (here / "bad.toml").write_text(STUDY.replace(*change))
    (here / "bad.csv").write_text(data or curve_of(360))
    assert cli.main(["identify", "bad.toml", "bad.csv", "--quiet", "--results", "bad"]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said and "\n" not in said and not (here / "bad").exists()


def test_a_number_that_two_parts_have_is_named_with_its_part():
    given = STUDY.replace("unknown.eccentric_bearing", 'unknown."output.pin_support"')
    question = study.parse_study(given, name="unit", solve=False)
    model = study.inverse_problem(question).model
    moved = {name: np.zeros(t.shape) for name, t in study.inverse_problem(question).prior.items()}
    seen = [jax.eval_shape(model, moved | {"output.pin_support": value}) for value in (1e7, 2e7)]
    assert seen[0].keys() == {"order 017", "order 018", "mean"}
