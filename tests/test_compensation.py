"""Compensation: orders worth storing, what stays, a virtual drive, schedules and files.

Oracles: independent cases (tests/reference/assembly.json), the mean square over drawn phases, a drive in which the
corrected command is made wrong by the error itself, parsers of the standard library.
"""

import ast
import csv
import json
import math
import re
import xml.dom.minidom
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from assembly_cases import cases

from rvjax import compensation
from rvjax.compensation import correction, export, phase_residual, predicted, read, residual, schedule, table
from rvjax.units import arcsec

RATIO = 121.0
TURN = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)


def complex_of(pairs):
    return np.array([complex(*pair) for pair in pairs])


def curve(order, value, angle):
    return np.real(np.exp(1j * np.multiply.outer(angle, order)) @ np.asarray(value))


def rms(values):
    return math.sqrt(np.mean(np.square(values)))


def drive(order, value, command):
    """Where the output stands: theta_in/ratio + d."""
    return command / RATIO + curve(order, value, command / RATIO)


def unit(amplitudes, phase=0.3):
    return np.array(list(amplitudes)), np.array(list(amplitudes.values())) * arcsec * np.exp(1j * phase)


@pytest.mark.parametrize("case", cases("stored"), ids=lambda case: case["id"])
def test_stored_orders_of_the_reference(case):
    given, expected = case["given"], case["expected"]
    found = correction(
        given["order"],
        complex_of(given["value"]),
        ratio=RATIO,
        sd=given["sd"],
        angle_sd=given["angle_sd"],
        count=given["count"],
        shrink=given["shrunk"],
    )
    assert found.order.tolist() == expected["order"]
    for name in ("gain", "saved", "before_rms", "residual_rms"):
        np.testing.assert_allclose(getattr(found, name), expected[name], rtol=1e-12, err_msg=name)
    given_value = dict(zip(given["order"], complex_of(given["value"])))
    np.testing.assert_allclose(found.value, found.gain * [given_value[k] for k in found.order.tolist()], rtol=1e-13)


@pytest.mark.parametrize("case", cases("curve"), ids=lambda case: case["id"])
def test_curves_of_the_reference(case):
    given, expected = case["given"], case["expected"]
    found = correction(given["order"], complex_of(given["value"]), ratio=given["ratio"])
    angle = np.array(given["angle"])
    np.testing.assert_allclose(found.output(angle), expected["output"], rtol=0, atol=1e-18)
    np.testing.assert_allclose(found.input(angle), expected["input"], rtol=0, atol=1e-16)
    np.testing.assert_allclose(phase_residual(given["order"], given["shift"]), expected["phase_residual"], rtol=1e-13)
    left = residual(found, given["order"], complex_of(given["applied_to"]), shift=given["shift"])
    assert left.rms == pytest.approx(expected["left_rms"], rel=1e-12)
    for side, factor in (("output", 1), ("input", given["ratio"])):
        rows = table(found, given["points"], side=side)
        assert rows.error_bound == pytest.approx(factor * expected["interpolation"], rel=1e-12)


def test_a_turned_table_leaves_the_phase_residual():
    order, value = unit({39: 5.0, 78: 3.0})
    found, shift = correction(order, value, ratio=RATIO), 0.01
    left = residual(found, order, value, shift=shift)
    np.testing.assert_allclose(np.abs(left.value), np.abs(value) * phase_residual(order, shift), rtol=1e-12)
    turned = curve(order, value, TURN) + found.output(TURN + shift)
    assert rms(turned) == pytest.approx(left.rms, rel=1e-12)  # a table turned by `shift` reads its row there
    other = value * np.exp(1j * np.array([0.7, -1.1]))  # of another phase, so that the sense of the turn counts
    left = residual(found, order, other, shift=shift)
    assert rms(curve(order, other, TURN) + found.output(TURN + shift)) == pytest.approx(left.rms, rel=1e-12)
    assert phase_residual(60, math.radians(1)) == pytest.approx(1) and phase_residual(61, math.radians(1)) > 1


def test_what_is_expected_to_stay_is_the_mean_over_drawn_zeros():
    """Oracle: draws of amplitudes and of the zero. A mean of n squares errs by their spread/sqrt(n); five of these."""
    order, value = unit({3: 2.0, 40: 4.0, 81: 6.0})
    sd, angle_sd, n = 0.4 * arcsec, 0.012, 200_000
    rng = np.random.default_rng(1)
    for shrink in (True, False):
        found = correction(order, value, ratio=RATIO, sd=sd, angle_sd=angle_sd, shrink=shrink)
        truth = value + sd * (rng.standard_normal((n, 3)) + 1j * rng.standard_normal((n, 3)))
        kept = np.isin(order, found.order) * (np.exp(-((order * angle_sd) ** 2) / 2) if shrink else 1.0) * value
        turned = np.exp(1j * order * angle_sd * rng.standard_normal((n, 3)))
        squares = np.sum(np.abs(truth - kept * turned) ** 2, axis=1) / 2
        assert abs(squares.mean() - found.residual_rms**2) < 5 * squares.std() / math.sqrt(n)
        assert found.before_rms**2 == pytest.approx(np.sum(np.abs(value) ** 2 / 2 + sd**2), rel=1e-13)


def test_storing_does_harm_beyond_a_phase_of_1_177():
    edge = math.sqrt(2 * math.log(2))
    for phase, kept in ((edge - 1e-9, True), (edge + 1e-9, False)):
        found = correction([10], [1e-5], ratio=RATIO, angle_sd=phase / 10, shrink=False)
        assert (found.order.size == 1) == kept == (found.saved[0] > 0)
        assert correction([10], [1e-5], ratio=RATIO, angle_sd=phase / 10).order.size == 1  # shrunk, it always saves


def test_the_orders_that_save_most_are_stored_and_none_that_save_nothing():
    found = correction([81, 3, 40, 7], [1e-6, 3e-6, 2e-6, 0.0], ratio=RATIO, count=2)
    assert found.order.tolist() == [3, 40] and found.saved.argmax() == 1
    assert correction([81, 3, 7], [1e-6, 3e-6, 0.0], ratio=RATIO).order.tolist() == [3, 81]
    empty = correction([81], [1e-6], ratio=RATIO, count=0)
    assert empty.residual_rms == empty.before_rms and empty.output(0.3) == 0
    assert not table(empty, 1).correction.any()


def test_identified_orders_bring_their_spread():
    order, value = unit({3: 2.0, 40: 4.0})
    identified = SimpleNamespace(order=order, value=value, sd=np.array([1e-7, 2e-7]))
    found = correction(order, identified, ratio=RATIO)
    assert found.sd.tolist() == [1e-7, 2e-7]
    assert correction(order, identified, ratio=RATIO, sd=3e-7).sd.tolist() == [3e-7, 3e-7]


def test_a_virtual_drive_with_its_correction_stands_where_it_should():
    """The command is moved before the error is made, which leaves -d' d; one more step squares d'."""
    order, value = unit({1: 60.0, 39: 4.0, 78: 3.0})
    found = correction(order, value, ratio=RATIO)
    steepest = np.abs(curve(order, 1j * order * value, TURN)).max()
    most = np.abs(curve(order, value, TURN)).max()
    once = drive(order, value, RATIO * TURN + found.input(TURN)) - TURN
    bend = np.abs(curve(order, order**2 * value, TURN)).max()  # Taylor: what is left of d(theta - d) after -d' d
    first = -curve(order, 1j * order * value, TURN) * curve(order, value, TURN)
    np.testing.assert_allclose(once, first, rtol=0, atol=bend * most**2 / 2)
    assert rms(once) > 0.02 * arcsec  # to be seen beside 67 arcsec
    twice = drive(order, value, RATIO * (TURN + found.output(TURN + found.output(TURN)))) - TURN
    assert np.abs(twice).max() < steepest**2 * most < 0.2 * np.abs(once).max()
    wrong = drive(order, value, RATIO * TURN - found.input(TURN)) - TURN
    assert rms(wrong) > 1.9 * rms(curve(order, value, TURN))


def test_the_correction_stands_in_a_jitted_program():
    found = correction(*unit({3: 2.0, 40: 4.0}), ratio=RATIO)
    jitted = jax.jit(jax.vmap(found.input))(jnp.asarray(TURN[:50]))
    np.testing.assert_allclose(jitted, found.input(TURN[:50]), rtol=0, atol=1e-16)
    assert isinstance(found.output(0.3), float)


def test_a_table_closes_and_keeps_its_bound():
    found = correction(*unit({3: 2.0, 40: 4.0, 81: 3.0}), ratio=RATIO)
    rows = table(found, 200)
    assert rows.angle[0] == 0 and rows.angle[-1] == 2 * math.pi and rows.correction[0] == rows.correction[-1]
    np.testing.assert_allclose(rows.correction, found.input(rows.angle), rtol=0, atol=1e-15)
    off = np.abs(np.interp(TURN, rows.angle, rows.correction) - found.input(TURN))
    alone = correction([81], [2e-5], ratio=RATIO)
    worst = np.abs(np.interp(TURN, rows.angle, table(alone, 200).correction) - alone.input(TURN)).max()
    assert off.max() < rows.error_bound and worst > 0.98 * table(alone, 200).error_bound  # reached at a crest


def load_law(torque):
    """Measured amplitudes, arcsec over kN m (XiLab, forward), under fixed phases."""
    a0, a1 = np.array([1.81, 2.15, 3.16, -0.35, 0.84]), np.array([1.11, 2.23, -0.35, 4.09, 0.34])
    return np.array([3, 39, 40, 78, 81]), (a0 + a1 * torque) * arcsec * np.exp(1j * np.arange(5))


def test_a_schedule_follows_the_load_where_one_table_does_not():
    made = {(t, way): correction(*load_law(t), ratio=RATIO) for t in (0.4, 1.2) for way in (1, -1)}
    made[(1.2, -1)] = correction([3], [9e-6], ratio=RATIO)
    found = schedule(made)
    one = made[(1.2, 1)]
    left = dict(zip(*(lambda r: (r.order.tolist(), np.abs(r.value)))(residual(one, *load_law(0.6)))))
    assert left[78] == pytest.approx(4.09 * 0.6 * arcsec, rel=1e-12)  # 2.45 arcsec
    for torque in (0.4, 0.6, 1.0, 1.2):
        assert residual(found.at(torque, 1), *load_law(torque)).rms < 1e-12 * arcsec * 1e6
    held = found.at(5.0, 1), found.at(0.0, 1)
    assert held[0] is made[(1.2, 1)] and held[1] is made[(0.4, 1)]
    back = found.at(0.8, -1)  # half of either, and nothing of the other direction
    np.testing.assert_allclose(back.value, 0.5 * made[(0.4, -1)].value + 0.5 * np.array([9e-6, 0, 0, 0, 0]), rtol=1e-12)
    with pytest.raises(ValueError, match=r"direction = 0: .* 1, -1"):
        found.at(1.0, 0)


def test_the_peak_to_peak_is_that_of_the_curve():
    """Two orders, certain amplitudes: the curve has peaks of 2 and of 1.125, its Hilbert transform has other ones."""
    order, value = np.array([1, 2]), np.array([1.0, 1.0]) * arcsec
    left = predicted(correction(order, value, ratio=RATIO, count=0), draws=4)
    due = np.ptp(curve(order, value, TURN))
    assert left.peak_to_peak.value == pytest.approx(due, rel=0.02) == 3.125 * arcsec
    assert left.rms.value == pytest.approx(rms(curve(order, value, TURN)), rel=1e-9)


def test_an_input_that_turns_against_the_output_has_the_table_of_the_other_sign():
    order, value = unit({3: 10.0, 40: 5.0})
    there, back = (table(correction(order, value, ratio=ratio)) for ratio in (RATIO, -RATIO))
    np.testing.assert_allclose(back.correction, -there.correction, rtol=1e-12)
    assert back.error_bound == pytest.approx(there.error_bound) and there.error_bound > 0


def test_between_two_torques_independent_errors_average():
    """Half of each: variances add up with the squares of the weights, so that a mean of two is known better."""
    order, value = unit({3: 10.0})
    made = {
        (torque, 1): correction(order, value, ratio=RATIO, sd=sd * arcsec) for torque, sd in ((0.0, 3.0), (100.0, 4.0))
    }
    found = schedule(made)
    assert found.at(50.0, 1).sd / arcsec == pytest.approx([2.5])
    assert found.at(25.0, 1).sd / arcsec == pytest.approx([np.hypot(0.75 * 3.0, 0.25 * 4.0)])


def test_prediction_holds_at_another_temperature():
    """Repeated curves, amplitudes and zero drawn anew: 95 % intervals of rms and peak to peak hold 95 % of them.

    150 curves: 0.95 +- 4 sqrt(0.95 0.05/150) = 0.071; 256 draws move a quantile by 0.013 more.
    """
    order, truth = unit({1: 2.0, 6: 5.0, 7: 6.0, 13: 3.0})  # low orders, whose curves need few points
    sd, angle_sd, n = 0.3 * arcsec, 0.012, 150
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, n, 4)) + 1j * rng.standard_normal((2, n, 4))
    hits = np.zeros(2)
    grid = np.exp(1j * np.outer(order, np.arange(110) * 2 * np.pi / 110))
    for k in range(n):
        found = correction(order, truth + sd * noise[0, k], ratio=RATIO, sd=sd, angle_sd=angle_sd)
        left = residual(found, order, truth, shift=angle_sd * rng.standard_normal())
        expected = predicted(found, draws=256, seed=k)
        swing = np.ptp((left.value @ grid).real)
        pairs = ((left.rms, expected.rms), (swing, expected.peak_to_peak))
        hits += [interval.lower <= seen <= interval.upper for seen, interval in pairs]
    assert (np.abs(hits / n - 0.95) < 0.085).all(), hits / n


CURVE = correction(*unit({3: 2.0, 40: 4.0, 81: 3.0}), ratio=RATIO)
ENDINGS = (".csv", ".json", ".txt", ".xml", ".st")


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_are_read_back_with_all_bits(tmp_path, ending):
    rows = table(CURVE)
    export(rows, tmp_path / f"drive{ending}")
    back = read(tmp_path / f"drive{ending}")
    assert back.name == "te_correction"
    for name in ("angle", "correction"):
        assert (getattr(back, name) == getattr(rows, name)).all()
    if ending == ".json":
        assert (back.ratio, back.orders, back.error_bound) == (RATIO, (3, 40, 81), rows.error_bound)


def test_other_parsers_read_the_same_numbers(tmp_path):
    rows = table(CURVE, 200)
    for ending in ENDINGS:
        export(rows, tmp_path / f"t{ending}", joint={"stiffness": 9.2e6, "damping": 0.1}, seed=7)
    pairs = np.stack([rows.angle, rows.correction], axis=1)
    with (tmp_path / "t.csv").open(newline="") as file:
        head, *lines = csv.reader(file)
    assert head == ["angle [rad]", "correction [rad]"]
    assert (np.array(lines, float) == pairs).all()
    given = json.loads((tmp_path / "t.json").read_text())
    assert (pairs == np.array([given["angle"], given["correction"]]).T).all()
    assert given["unit"] == "rad" and given["seed"] == 7 and given["orders"] == [3, 40, 81] and given["versions"]
    text = (tmp_path / "t.txt").read_text().splitlines()
    assert text[:2] == ["#1", "double te_correction(201,2)"]
    assert (np.loadtxt(text[2:]) == pairs).all()
    document = xml.dom.minidom.parse(str(tmp_path / "t.xml"))
    found = {item.getAttribute("name"): item for item in document.getElementsByTagName("numeric")}
    for name, column in (("te_correction_angle", pairs[:, 0]), ("te_correction", pairs[:, 1])):
        assert found[name].parentNode.tagName == "custom" and int(found[name].getAttribute("size")) == 201
        assert (np.array(found[name].getAttribute("data").split(), float) == column).all()
    joint = document.getElementsByTagName("joint")[0]
    assert float(joint.getAttribute("stiffness")) == 9.2e6 and not joint.hasAttribute("frictionloss")
    structured = (tmp_path / "t.st").read_text()
    assert structured.startswith("VAR_GLOBAL CONSTANT") and structured.rstrip().endswith("END_VAR")
    lists = dict(re.findall(r"(\w+) : ARRAY\[0\.\.200\] OF LREAL := (\[[^]]*\]);", structured))
    for name, column in (("te_correction_angle", pairs[:, 0]), ("te_correction", pairs[:, 1])):
        numbers = ast.literal_eval(lists[name])  # a number without point or exponent would be an int
        assert all(isinstance(number, float) for number in numbers) and numbers == column.tolist()


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("content", ["", "nothing here", "[]", "{}", "<mujoco/>", "angle [rad],correction [rad]\n1"])
def test_a_file_without_a_table_is_refused_in_one_line(tmp_path, ending, content):
    path = tmp_path / f"bad{ending}"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"holds no table of a correction \(.*\)$") as error:
        read(path)
    assert "\n" not in str(error.value)


GOOD = dict(order=[3, 40], value=[1e-6, 2e-6], ratio=RATIO)
BAD = [
    (dict(value=[1e-6]), "value: 1 numbers in rad for 2 orders"),
    (dict(order=[3, 3]), "order = 3: duplicate"),
    (dict(order=[0, 3]), "order = 0: must be a whole number per output turn, at least 1"),
    (dict(order=[2.5, 3]), "order = 2.5: must be a whole number"),
    (dict(order=[math.nan, 3]), "order = nan: must be a whole number"),
    (dict(value=[1e-6, math.nan]), "value = .* rad of order 40: must be finite"),
    (dict(angle_sd=-1e-3), "angle_sd = -0.001 rad: must be finite, zero or positive"),
    (dict(sd=-1e-6), "sd = -1e-06 rad: must be finite, zero or positive"),
    (dict(sd=[1e-6]), "sd: 1 numbers in rad for 2 orders"),
    (dict(ratio=0.0), "ratio = 0.0: must be finite and not 0"),
    (dict(count=-1), "count = -1: must be a whole number of at least 0"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_input_is_one_line(change, message):
    given = GOOD | change
    with pytest.raises(ValueError, match=message) as error:
        correction(given.pop("order"), given.pop("value"), **given)
    assert "\n" not in str(error.value)


def test_bad_tables_and_files_are_one_line(tmp_path):
    with pytest.raises(ValueError, match="points = 162: must be at least 163, twice the highest order and one"):
        table(CURVE, 162)
    assert table(CURVE, 163).angle.size == 164
    with pytest.raises(ValueError, match="side = 'left': must be one of input, output"):
        table(CURVE, side="left")
    for call in (lambda p: export(table(CURVE), p), read):
        with pytest.raises(ValueError, match=r"t\.dat: must end with one of \.csv, \.json, \.txt, \.xml, \.st"):
            call(tmp_path / "t.dat")
    with pytest.raises(ValueError, match=r"joint\['mass'\] = 1.0: must be a finite number of stiffness"):
        export(table(CURVE), tmp_path / "t.xml", joint={"mass": 1.0})
    with pytest.raises(ValueError, match="corrections: must hold"):
        schedule({})
    with pytest.raises(ValueError, match=r"ratio: .* 40, 121"):
        schedule({(1.0, 1): CURVE, (2.0, 1): correction([1], [1e-6], ratio=40.0)})
    assert not list(tmp_path.iterdir()) and compensation.__all__
