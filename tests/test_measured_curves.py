"""Curves of a bench: nothing is corrected into something worse.

Oracle: the curve from which the readings are made. "Rest" is the rms of the curve less the table on 7,200 angles.
"""

import numpy as np
import pytest

from rvjax import catalogue, measured
from rvjax.identify.observation import svd
from rvjax.measured import findings, judge
from rvjax.measured.run import legs, places, repetition
from rvjax.measured.terms import LEAST, Model, Term, _thinned
from rvjax.units import arcsec, deg
from tests.measured_cases import NOISE, PARTS, TRUTH, curve, equal, evaluated, noise, run, said

# Sampling


def test_the_angles_repeat_at_the_number_of_equal_steps():
    rng = np.random.default_rng(0)
    for count in (12, 118, 720):
        assert repetition(equal(count) * deg, 1500.0) == count
    assert repetition(equal(720, 2) * deg, 1500.0) == 720
    assert repetition(np.arange(0, 340, 0.5) * deg, 1500.0) == 720
    assert repetition(np.linspace(0, 2 * np.pi, 73), 1500.0) == 72  # the last place is the first
    assert repetition(np.sort(rng.uniform(0, 2 * np.pi, 300)), 1500.0) == np.inf
    jitter = lambda share: (equal(118) + share * 360 / 118 * rng.uniform(-1, 1, 118)) * deg  # noqa: E731
    assert repetition(jitter(0.1), 1500.0) == pytest.approx(118, abs=1)  # correlation sin(0.2 pi)/(0.2 pi) = 0.94
    assert repetition(jitter(0.4), 1500.0) == np.inf  # 0.23


@pytest.mark.parametrize(
    ("points", "order", "looks"),
    [
        (36, 39, 3),
        (118, 78, 40),
        (145, 105, 40),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in ((36, 40, 4), (72, 39, 33), (90, 80, 10), (120, 80, 40), (144, 105, 39))
        ),
    ],
)
def test_an_order_of_the_reducer_that_looks_like_another_is_not_stored(points, order, looks):
    angle = equal(points)
    truth = {order: 3.0 * np.exp(0.4j)}
    judged, _, stored, rest = evaluated(angle, curve(angle * deg, truth) + noise(points), truth=truth)
    assert stored == [] and rest == pytest.approx(3 / np.sqrt(2), rel=1e-6)
    text = [finding.text for finding in findings(judged) if finding.name == "orders alike"]
    assert any(f"{points} points: order {order} (" in line and line.endswith(f"looks like {looks}") for line in text)


def test_two_points_in_a_period_show_one_phase_only():
    """cos(180 t) of 360 points is +1, -1, +1 ..., and sin(180 t) is zero at each."""
    judged = judge(run(equal(360), curve(equal(360) * deg, {40: 3.0}) + noise(360)), PARTS | {"holes": 180.0})
    text = [finding.text for finding in findings(judged) if finding.name == "orders alike"]
    assert "360 points: order 180 (holes) shows one phase only" in text


def test_orders_that_are_resolved_are_stored_at_any_density():
    rng = np.random.default_rng(1)
    for angle in (equal(180), equal(240), np.sort(rng.uniform(0, 360, 72)), equal(720), equal(180, 2)):
        _, fit, stored, rest = evaluated(angle, curve(angle * deg) + noise(len(angle)))
        assert stored == [39, 40, 78] and rest < 0.1 and fit.unsure == {}


@pytest.mark.parametrize(
    ("points", "order", "looks"),
    [
        (720, 650, 70),
        (360, 324, 36),
        *(pytest.param(*case, marks=pytest.mark.long) for case in ((720, 648, 72), (720, 700, 20), (720, 525, 195))),
    ],
)
def test_an_order_of_the_motor_is_not_stored(points, order, looks):
    """72, 70 and 20 are no orders of the reducer; 36 is near 39, but 324 = 4 x 81 of a sun looks like it."""
    angle = equal(points)
    error = curve(angle * deg, TRUTH | {order: 2.0}) + noise(points)
    parts = PARTS | {"sun": 81.0, "sun against the carrier": 80.0} if order % 81 == 0 else PARTS
    _, fit, stored, rest = evaluated(angle, error, parts)
    assert stored == [39, 40, 78] and rest < 0.1
    if looks <= 89:  # of 720 points that many orders are fitted
        assert f"order {order}" in fit.unsure[looks]
    angle = equal(1800)  # at these angles nothing looks like it
    _, _, stored, _ = evaluated(angle, curve(angle * deg, TRUTH | {70: 2.0}) + noise(1800))
    assert stored == [39, 40, 70, 78]


def test_singular_values_where_the_fast_driver_fails(monkeypatch):
    """Over three whole turns all singular values are equal; LAPACK's fast driver may not converge."""
    matrix = np.random.default_rng(0).standard_normal((30, 4))
    due = np.linalg.svd(matrix, compute_uv=False)

    def fails(*_, **__):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(np.linalg, "svd", fails)
    left, size, right = svd(matrix)
    np.testing.assert_allclose(size, due, rtol=1e-12)
    np.testing.assert_allclose(left * size @ right, matrix, atol=1e-12)


@pytest.mark.parametrize("alike", [False, True])
def test_the_score_with_one_term_less_is_that_of_its_fit(alike):
    """Of terms of every kind at uneven angles; an order twice, as a line too, is explained by the other."""
    rng = np.random.default_rng(4)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 300))
    value = 5 * np.cos(7 * angle) + 2 * np.sin(11.3 * angle) + 0.4 * angle + rng.normal(size=300)
    terms = [Term("order", 7.0), Term("line", 11.3), Term("drift"), Term("warm-up", 0.7), Term("step", 90.0)]
    terms += [Term("glitch", 33.0), Term("pair", 20.4), *([Term("line", 7.0)] if alike else [])]
    model = Model(angle, value, terms)
    assert (model.basis.shape[1] < len(model.owner)) == alike
    for term in terms:
        assert model.less(term) == pytest.approx(model.without(term).score, abs=1e-9), term
    lost = [model.less(term) - model.score for term in terms]
    assert (lost[0] < 1e-9) == alike and lost[1] > 100


def test_the_term_goes_first_that_explains_least():
    """Order 7 in noise beside a line at 7.1: either can go alone, the likelihood loses less without the line."""
    angle = equal(720) * deg
    value = np.cos(7 * angle) + 2 * np.random.default_rng(1).normal(size=720)
    model = Model(angle, value, [Term("order", 1.0), Term("order", 7.0), Term("line", 7.1)])
    _, order, line = (model.less(term) - model.score for term in model.terms)
    assert line < order < LEAST["order"]
    assert _thinned(model, keep=[1]).terms == model.terms[:2]


def test_a_high_order_at_uneven_angles_does_not_leak():
    rng = np.random.default_rng(2)
    angle = equal(720) + rng.uniform(-0.2, 0.2, 720)
    judged, _, stored, rest = evaluated(angle, curve(angle * deg, TRUTH | {650: 2.0}) + noise(720))
    assert stored == [39, 40, 78] and rest < 0.1
    assert said(judged)["highest resolved order"].value == 12 * 105


# Drift, steps, bad readings


@pytest.mark.parametrize(
    ("slope", "turns"),
    [(0.5, 1), (-10, 2), *(pytest.param(slope, 1, marks=pytest.mark.long) for slope in (10, 60, 1236))],
)
def test_a_drift_is_reported_and_not_stored(slope, turns):
    angle = equal(720, turns)
    judged, _, stored, rest = evaluated(angle, curve(angle * deg) + slope * angle / 360 + noise(len(angle)))
    assert stored == [39, 40, 78] and rest < 0.1
    found = said(judged)["drift per revolution"]
    assert found.warning and found.value == pytest.approx(slope * arcsec, abs=0.2 * arcsec)
    assert said(judged)["closure"].value == pytest.approx(slope * turns * arcsec, rel=0.05, abs=0.3 * arcsec)


@pytest.mark.parametrize("constant", [60, *(pytest.param(c, marks=pytest.mark.long) for c in (10, 150, 400))])
def test_a_warm_up_is_reported_and_not_stored(constant):
    angle = equal(720)
    error = curve(angle * deg) + 12 * (1 - np.exp(-angle / constant)) + noise(720)
    judged, _, stored, rest = evaluated(angle, error)
    assert stored == [39, 40, 78] and rest < 0.1
    assert said(judged)["warm-up"].value == pytest.approx(12 * arcsec, rel=0.1)


def test_low_orders_stay_beside_a_drift():
    truth = TRUTH | {2: 5.0j, 3: 2.0, 5: 1.0}
    angle = equal(720)
    _, _, stored, rest = evaluated(angle, curve(angle * deg, truth) + 10 * angle / 360 + noise(720), truth=truth)
    assert stored == [2, 3, 5, 39, 40, 78] and rest < 0.1


@pytest.mark.parametrize(("size", "at"), [(5, 137.0), (2, 40.0), (-8, 350.0)])
def test_a_lost_step_is_refused_with_its_place(size, at):
    angle = equal(720)
    error = curve(angle * deg) + size * (angle > at) + noise(720)
    where = rf"a.csv.*jumps by .* arcsec at {at + 0.5} deg \(row {int(2 * at) + 3}\)"
    with pytest.raises(ValueError, match=where) as caught:
        judge(run(angle, error, rows=np.arange(720) + 2), PARTS)
    assert float(str(caught.value).split("jumps by ")[1].split()[0]) == pytest.approx(size, abs=0.15)


@pytest.mark.parametrize(
    "rows", [(0,), (50, 51, 400), *(pytest.param((row,), marks=pytest.mark.long) for row in (100, 719))]
)
def test_a_bad_reading_is_named_and_left_out(rows):
    angle, error = equal(720), curve(equal(720) * deg) + noise(720)
    error[list(rows)] += 3600
    judged = judge(run(angle, error, rows=np.arange(720) + 2), PARTS)
    assert evaluated(angle, error)[2] == [39, 40, 78] and evaluated(angle, error)[3] < 0.1
    named = [f.text for f in findings(judged) if f.name == "bad reading"]
    assert sorted(int(text.split(",")[0].removeprefix("row ")) for text in named) == [row + 2 for row in rows]


@pytest.mark.parametrize("points", [12, 13, 24, *(pytest.param(n, marks=pytest.mark.long) for n in (16, 36, 48))])
@pytest.mark.parametrize("wrong", [{0: -36.2}, {7: -3.6}, {-1: 5.0}, {2: -36.2, 8: 20.0}, {7: -3.6, 8: -3.5}])
def test_wrong_readings_among_few_are_named_and_left_out(points, wrong):
    """A round of 0.3 deg with noise of 0.002 deg, on drives whose lowest orders are 39 and 16."""
    angle, rng = equal(points), np.random.default_rng(points)
    error = 0.3 * np.cos(angle * deg + 0.4) + 0.002 * rng.standard_normal(points)
    for parts in (PARTS, {"holes": 16.0, "pins": 17.0}):
        fine = judge(run(angle, error * 3600, rows=np.arange(points) + 2), parts)
        assert not fine.found("glitch") and len(fine.angle) == points
        bad = error.copy()
        bad[list(wrong)] = list(wrong.values())
        judged = judge(run(angle, bad * 3600, rows=np.arange(points) + 2), parts)
        named = [f.text for f in findings(judged) if f.name == "bad reading"]
        rows = sorted(int(text.split(",")[0].removeprefix("row ")) for text in named)
        assert rows == sorted(k % points + 2 for k in wrong) and len(judged.angle) == points - len(wrong)
        assert judged.noise < 0.004 * deg


@pytest.mark.parametrize("at", [0, 120, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 198))])
@pytest.mark.parametrize("back", [False, True])
def test_a_wrong_angle_is_a_bad_reading_and_no_pass(tmp_path, at, back):
    """Counts of an encoder; the first row, 2050 for 3, was a backward curve of two points."""
    counts = np.round(3 + np.arange(200) * 4096 / 200)
    error = curve(counts * 2 * np.pi / 4096, {39: 10 * np.exp(-1j), 41: 8.0}) + noise(200)
    if back:
        counts, error = np.concatenate([counts, counts[::-1]]), np.concatenate([error, error[::-1] + 2])
    counts[at] = (counts[at] + 2047) % 4096
    file = tmp_path / "bench.csv"
    file.write_text("angle,error [arcsec]\n" + "".join(f"{a},{e}\n" for a, e in zip(counts, error)))
    columns = {"angle": {"column": "angle", "unit": "count", "counts_per_turn": 4096}}
    runs = measured.read([file], columns).runs
    assert [(one.at.direction, len(one.angle)) for one in runs] == [("forward", 200), ("backward", 200)][: 1 + back]
    named = [f.text for one in runs for f in findings(judge(one, PARTS)) if f.name == "bad reading"]
    assert [text.split(",")[0] for text in named] == [f"row {at + 2}"]


# Noise


def remembers(count, share, seed, sd=0.6):
    rng = np.random.default_rng(seed)
    value, kept = 0.0, []
    for fresh in sd * rng.standard_normal(count + 200):
        value = share * value + fresh
        kept.append(value)
    return np.array(kept[200:])


@pytest.mark.parametrize("share", [0.3, 0.8, 1.0, *(pytest.param(x, marks=pytest.mark.long) for x in (0.6, 0.95))])
def test_noise_with_memory_is_not_stored(share):
    for seed in (0, 1, 2, 3, 46):  # the last random walk has a large order 2
        error = remembers(720, share, seed)
        assert evaluated(equal(720), error)[2] == [], seed
    error += curve(equal(720) * deg)  # three orders in such noise are
    assert evaluated(equal(720), error)[2] == [39, 40, 78]


def test_a_low_order_in_noise_with_memory_is_stored():
    truth = {3: 4.0, 39: 3.0, 80: 2.0j}
    error = curve(equal(720) * deg, truth) + remembers(720, 0.8, 7)
    judged, fit, stored, rest = evaluated(equal(720), error, truth=truth)
    assert stored == [3, 39, 80] and rest < 0.3 and fit.colour > 2
    assert said(judged)["memory of the noise"].value == pytest.approx(0.8, abs=0.1)


def test_independent_readings_have_the_level_of_independent_readings():
    """The sd of an order is noise sqrt(2/n); a level of 1 keeps the decision that a white spectrum has."""
    flat = 0
    for seed in range(10):
        _, fit, stored, _ = evaluated(equal(720), curve(equal(720) * deg) + noise(720, seed))
        assert stored == [39, 40, 78]
        flat += fit.colour == 1
        assert np.median(fit.found.sd) == pytest.approx(NOISE * arcsec * np.sqrt(2 / 720), rel=0.2)
    assert flat >= 6  # nine of ten by the test of the level


# Orders that are no whole numbers


@pytest.mark.parametrize(
    "order", [12.34, 66.5, *(pytest.param(x, marks=pytest.mark.long) for x in (3.5, 66.1, 66.6, 100.3))]
)
@pytest.mark.parametrize("turns", [1, 3])
def test_a_line_between_whole_orders_is_named_and_does_not_leak(order, turns):
    angle = equal(720, turns)
    error = curve(angle * deg, TRUTH | {order: 1.5j}) + noise(len(angle))
    judged, _, stored, rest = evaluated(angle, error)
    assert stored == [39, 40, 78] and rest < 0.1
    (line,) = judged.found("line")
    assert line.at == pytest.approx(order, abs=0.02 / turns)
    assert said(judged)[f"order {line.at:.5g}"].value == pytest.approx(1.5 * arcsec, rel=0.05)


def test_the_sun_of_a_ratio_that_is_no_whole_number_is_named():
    design = catalogue.RV_40E.replace(involute=catalogue.RV_40E.involute.replace(sun_teeth=13, planet_teeth=23))
    assert design.orders["sun"] == pytest.approx(1 + 23 * 40 / 13) and design.orders["disc teeth"] == 39
    angle = equal(720)
    error = curve(angle * deg, TRUTH | {design.orders["sun"]: 1.08}) + noise(720)
    judged, _, stored, rest = evaluated(angle, error, design.orders)
    assert stored == [39, 40, 78] and rest < 0.1
    assert said(judged)["order 71.769"].text.startswith("sun: ")


def test_neighbouring_whole_orders_are_no_line():
    truth = TRUTH | {41: 1.0, 42: 1.0j, 43: 0.5}
    _, fit, stored, rest = evaluated(equal(720), curve(equal(720) * deg, truth) + noise(720), truth=truth)
    assert stored == [39, 40, 41, 42, 43, 78] and rest < 0.1 and fit.unsure == {}


# Strokes, repeated readings, passes


@pytest.mark.parametrize("stroke", [340, 90, *(pytest.param(x, marks=pytest.mark.long) for x in (300, 200))])
def test_the_orders_of_the_reducer_are_known_from_a_part_of_a_turn(stroke):
    angle = np.arange(0, stroke + 0.25, 0.5)
    truth = TRUTH | {80: 1.0, 2: 2.0, 3: 1j} if stroke > 250 else TRUTH
    judged, fit, stored, rest = evaluated(angle, curve(angle * deg, truth) + noise(len(angle)), truth=truth)
    assert stored == sorted(truth) and rest < 0.15
    found = said(judged)["stroke"]
    assert found.warning and f"{stroke} deg of 360" in found.text and "closure" not in said(judged)
    at = {order: place for place, order in enumerate(fit.found.order.tolist())}
    if stroke == 340:
        assert fit.found.sd[at[39]] / arcsec == pytest.approx(NOISE * np.sqrt(2 / 680), rel=0.2)  # 0.011


@pytest.mark.parametrize("repeated", [False, True])
def test_a_gap_in_the_revolution_is_a_stroke_below_a_revolution(repeated):
    """A sensor that fails over 20 deg; three sweeps of a joint that moves 340 deg, whose angle wraps to 0."""
    sweep = np.arange(0, 340, 0.5)
    angle = np.concatenate([sweep, sweep + 360, sweep + 720]) if repeated else np.delete(equal(720), range(200, 240))
    judged, _, stored, rest = evaluated(angle, curve(angle * deg) + noise(len(angle)))
    assert stored == [39, 40, 78] and rest < 0.1 and not judged.sampling.whole
    assert said(judged)["gap in the revolution"].value == pytest.approx(20.5 * deg)
    uneven = np.sort(np.random.default_rng(6).uniform(0, 360, 400))
    assert judge(run(uneven, noise(400)), PARTS).sampling.whole


def test_what_a_short_stroke_does_not_determine_is_not_stored():
    angle = np.arange(0, 45, 0.5)
    _, fit, stored, rest = evaluated(angle, curve(angle * deg) + noise(90))
    assert stored == [78] and set(fit.unsure) >= {39, 40} and rest < 4.18
    assert set(fit.unsure.values()) == {"the stroke does not determine it"}


@pytest.mark.parametrize(("times", "spread"), [(3, 0.0), (5, 0.001), (12, 0.0)])
def test_repeated_readings_of_a_place_are_one_place(times, spread):
    rng = np.random.default_rng(3)
    angle = np.repeat(equal(180), times) + spread * rng.uniform(-1, 1, 180 * times)
    common = np.repeat(noise(180), times)  # of a place: more readings do not reduce it
    judged, fit, stored, rest = evaluated(angle, curve(angle * deg) + common + 0.1 * noise(180 * times, 1))
    assert (judged.sampling.points, judged.sampling.readings) == (180, 180 * times) and judged.sampling.whole
    assert stored == [39, 40, 78] and rest < 0.1
    assert np.median(fit.found.sd) / arcsec == pytest.approx(NOISE * np.sqrt(2 / 180), rel=0.25)
    whole = measured.checked(run(angle, 0 * angle), 40)  # identification takes it too
    assert len(whole.angle) == 180 * times
    same, _, place = places(np.arange(9.0), np.arange(9.0))
    assert same.tolist() == place.tolist() == list(range(9))


def test_passes_are_split_at_reversals_only():
    there = np.arange(0, 360, 0.5)
    back = np.concatenate([there, there[::-1]])
    assert [(leg.start, leg.stop) for leg in legs(back * deg)] == [(0, 720), (720, 1440)]
    assert len(legs(np.concatenate([back, there]) * deg)) == 3
    rng = np.random.default_rng(4)
    for one in (there, there[::-1], rng.permutation(there), there + rng.uniform(-3, 3, 720)):
        assert len(legs(one * deg)) == 1


def test_rows_in_no_order_are_one_turn():
    angle = np.random.default_rng(5).permutation(equal(720))
    judged, _, stored, rest = evaluated(np.unwrap(angle, period=360), curve(angle * deg) + noise(720))
    assert stored == [39, 40, 78] and rest < 0.1 and not judged.found("drift", "step")


@pytest.mark.parametrize("points", [12, 24])
def test_a_drift_over_few_places_is_not_order_1(points):
    """A wrong ratio gives 300 arcsec per revolution; a real order 1 of the same size is stored."""
    angle = equal(points)
    *_, ramp = fit_of(angle, curve(angle * deg) + 300 * angle / 360)
    assert ramp.found.order[ramp.seen].tolist() == []
    *_, real = fit_of(angle, curve(angle * deg) + 50 * np.sin(angle * deg))
    assert real.found.order[real.seen].tolist() == [1]


def fit_of(angle, error):
    return evaluated(angle, error + noise(len(angle)))[:2]
