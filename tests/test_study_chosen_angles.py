"""Units solved where their extremes are expected: few angles of a turn of the output in the place of all.

Oracles: the curves at all angles, from the program that learns; NumPy's choice; differences of the plain value.
"""

import math
import types
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import newton_alone

from rvjax import models, study
from rvjax.commands import check
from rvjax.commands.allocate import full_model_check
from rvjax.commands.budget.budgets import _of_curves
from rvjax.commands.compare import results
from rvjax.commands.montecarlo import batch
from rvjax.loaded import newton, outputs
from rvjax.loaded.observation import turn
from rvjax.loaded.revolution import Instants, summary
from rvjax.loaded.system import Pins, System
from rvjax.population import Population, Tolerance, drawn, root_key
from rvjax.records import Record, field, record
from rvjax.response import elements, unit_at_mid_points
from rvjax.response.parts import parts, unit_of
from rvjax.status import SolveInfo
from rvjax.study import chosen_angles as responses, study as definition
from rvjax.study.chosen_angles import Expected, learned, takes_few
from rvjax.study.response import DesignResponse, Response
from rvjax.tolerances import ReciprocalPower, Requirement, allocate
from rvjax.tolerances.allocation.whole_sample import nominal_outputs
from rvjax.units import arcmin

ANGLES, CHOSEN = 97, 12
NONE = np.zeros((2, 1))
NONE_FAILED = types.SimpleNamespace(samples=10, failed=0)
ERROR, LOADED = "loaded_transmission_error", "turn_pin_pressure"


def asked(**conditions):
    """The embedded drive over a turn of the output, at few angles of each unit unless said otherwise."""
    given = study.load("cycloidal-17", solve=False)
    changed = dict(span="output_turn", samples=ANGLES, chosen_angles=CHOSEN) | conditions
    limits = {ERROR: Requirement(upper=30 * arcmin, target=0.95), LOADED: given.requirements[LOADED]}
    return replace(given, conditions=replace(given.conditions, **changed), requirements=limits)


@pytest.fixture(scope="module", autouse=True)
def alone():
    """No unit here needs the interior point method."""
    with newton_alone():
        yield


@pytest.fixture(scope="module")
def drive():
    """The study, what it expects, and of eight units the errors and the curves at all angles, (8, n, c)."""
    own = asked()
    response, population = own.response(solve=False), Population.of(own.tolerances)
    errors = np.asarray(elements(population, drawn(population, root_key(5), np.uint32(0), count=8)))
    values, _ = responses._slopes(response, population, errors)
    return own, learned(response, population), population, errors, np.asarray(values)


def test_a_unit_has_the_extremes_of_its_chosen_angles_and_loses_little(drive):
    own, expected, population, errors, curves = drive
    chosen = own.response(solve=False).replace(expected=expected)
    (part,) = parts(chosen, population)
    values, status, _ = part.of_elements(population, errors)
    assert not status.any() and set(part.names) == {ERROR, LOADED}
    of_units = [expected.angles_of(population.fill(population.by_field(unit))) for unit in errors.T]
    numbers = np.stack([np.abs(expected.angles[:, None] - np.asarray(a)).argmin(axis=0) for a in of_units])
    assert numbers.shape == (8, CHOSEN) and len({tuple(row) for row in numbers}) == 8  # each unit has its own
    some = np.take_along_axis(curves, numbers[..., None], axis=1)
    error, pressure = some[..., 0].max(axis=1) - some[..., 0].min(axis=1), some[..., 1].max(axis=1)
    factors = np.asarray(expected.factors)
    assert np.all(factors[:2] > 1) and np.all(factors < 1.2)
    np.testing.assert_allclose(values[part.names.index(ERROR)], factors[0] * error, rtol=1e-9)
    np.testing.assert_allclose(values[part.names.index(LOADED)], factors[1] * pressure, rtol=1e-9)

    whole = curves[..., 0].max(axis=1) - curves[..., 0].min(axis=1)
    equal = curves[:, np.linspace(0, ANGLES, CHOSEN, endpoint=False).astype(int), 0]
    lost, by_equal = 1 - error / whole, 1 - (equal.max(axis=1) - equal.min(axis=1)) / whole
    assert lost.min() > -1e-9 and lost.mean() < 0.12 < by_equal.mean()
    assert abs(1 - (factors[0] * error / whole).mean()) < 0.7 * lost.mean()


def test_factors_are_those_of_other_units():
    """Of each unit that is left out, with the slopes of all others: the plain loop."""
    rng, places = np.random.default_rng(2), ((0, 1, 2), (0, -1, 2), (1, 1, 2))
    middle, slopes, z = rng.normal(size=(2, 30)), rng.normal(size=(6, 2, 30, 3)), rng.normal(size=(6, 3))
    seen = middle + np.einsum("ucne,ue->ucn", slopes, z)
    told = middle + np.einsum("cne,ue->ucn", slopes.mean(axis=0), z)
    whole, few = np.zeros(2), np.zeros(2)
    for u in range(6):
        due = middle + np.delete(slopes, u, axis=0).mean(axis=0) @ z[u]
        ends = [(0, 15), (15, 30)]
        at = [low + np.argmax(due[0, low:high]) for low, high in ends]
        at += [low + np.argmin(due[0, low:high]) for low, high in ends]
        at += [low + np.argmax(due[1, low:high]) for low, high in ends]
        whole += np.ptp(seen[u, 0]), seen[u, 1].max()
        few += np.ptp(seen[u, 0, at]), seen[u, 1, at].max()
    np.testing.assert_allclose(responses._factors(seen, told, places), whole / few, rtol=1e-12)
    np.testing.assert_array_equal(responses._factors(seen[:1], told[:1], places), 1.0)


def test_what_is_expected_follows_the_errors(drive):
    """Two thirds of the variance along the turn, for units that taught nothing; their mean curve explains a tenth."""
    _, expected, population, errors, curves = drive
    told = expected.middle[0] + np.einsum("ne,eu->un", expected.slopes[0], errors)
    told, error = (curve - curve.mean(axis=1, keepdims=True) for curve in (told, curves[..., 0]))
    assert ((told - error) ** 2).sum() < 0.4 * (error**2).sum()
    assert [name for name, _ in expected.fields] == [*population.active] and expected.slopes.shape == (
        3,
        ANGLES,
        len(errors),
    )


def test_units_that_fail_teach_nothing(monkeypatch):
    """The mean is that of the other units; where all fail it is zero."""
    own = asked()
    population, rng = Population.of(own.tolerances), np.random.default_rng(0)
    values, slopes = rng.normal(size=(8, ANGLES, 2)), rng.normal(size=(8, ANGLES, 2, population.numbers))
    values[3], slopes[5, :, 1, 0] = np.nan, np.nan
    values[:, 7] = np.nan
    monkeypatch.setattr(responses, "_slopes", lambda *_: (values, slopes))
    monkeypatch.setattr(responses, "UNITS", 8)
    found = learned(own.response(solve=False), population)
    some = np.array([0, 1, 2, 4, 6, 7])
    np.testing.assert_allclose(found.slopes[1, 0], slopes[some, 0, 1].mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.slopes[0, 0], slopes[[*some, 5], 0, 0].mean(axis=0), rtol=1e-12)
    assert not found.middle[:, 7].any() and not found.slopes[:, 7].any() and np.isfinite(found.middle).all()
    np.testing.assert_array_equal(found.factors, 1.0)  # a place where all fail

    values, slopes = rng.normal(size=(8, ANGLES, 2)), rng.normal(size=(8, ANGLES, 2, population.numbers))
    values[7] = np.nan
    factors = learned(own.response(solve=False), population).factors
    values, slopes = values[:7], slopes[:7]
    monkeypatch.setattr(responses, "UNITS", 7)
    np.testing.assert_allclose(factors, learned(own.response(solve=False), population).factors, rtol=1e-12)
    assert np.all(np.asarray(factors) > 1)
    values[2, 3] = np.nan  # one place of one unit
    assert np.all(np.asarray(learned(own.response(solve=False), population).factors) > 1)


def test_the_curves_of_a_unit_that_fails_have_no_value(drive):
    own, _, population, errors, curves = drive
    bad = errors.copy()
    bad[:, 3] = np.nan
    values, _ = responses._slopes(own.response(solve=False), population, bad)
    assert np.isnan(values[3]).all()
    np.testing.assert_allclose(np.delete(values, 3, axis=0), np.delete(curves, 3, axis=0), rtol=1e-9, atol=1e-15)


def test_units_of_every_command_choose_their_angles(monkeypatch):
    fields, places = (("throw", ()),), ((0, 1, 1), (0, -1, 1))
    one = Expected(
        np.zeros(ANGLES), np.zeros((1, ANGLES)), np.zeros((1, ANGLES, 1)), np.ones(1), NONE, NONE, fields, places
    )
    monkeypatch.setattr(definition, "learned", lambda *_: one)
    own, sampled = asked(), []
    assert own.units.expected is own.design_response().response.expected is one
    monkeypatch.setattr(
        batch.tolerances, "monte_carlo", lambda response, *_, **__: sampled.append(response) or NONE_FAILED
    )
    batch.run(own)
    assert [response.expected for response in sampled] == [one]

    def solved(response, *_, count):
        sampled.append(response)
        return {name: np.ones(count) for name in response.outputs}, None

    monkeypatch.setattr(check, "respond_units", solved)
    check._over_a_turn(own)
    assert [response.expected for response in sampled[1:]] == [one, None]
    assert [response.conditions.samples for response in sampled[1:]] == [ANGLES, 4 * ANGLES + 1]
    both = Requirement(lower=-1.0, upper=1.0, target=0.9)  # of a mean, for which all units need all angles
    loads = replace(own.conditions, second_torque=1.0)
    check._over_a_turn(replace(own, conditions=loads, requirements=own.requirements | {"mean_shift": both}))
    assert [response.expected for response in sampled[3:]] == [None, None]


def test_the_check_at_all_angles_has_those_of_the_study(monkeypatch):
    checked = []

    def stop(response, *_, **__):
        checked.append(response)
        raise InterruptedError

    monkeypatch.setattr(full_model_check, "monte_carlo", stop)
    for own in (asked(), asked(span="crank_turn", samples=12, chosen_angles=6)):
        with pytest.raises(InterruptedError):
            full_model_check.check_units(own, own.tolerances)
    assert [response.conditions.samples for response in checked] == [ANGLES, 217]
    assert all(response.expected is None and response.conditions.span == "output_turn" for response in checked)


def test_each_part_of_the_span_gives_its_highest_and_lowest_place():
    rng, n = np.random.default_rng(0), 10
    middle, slopes, vector = rng.normal(size=(2, n)), rng.normal(size=(2, n, 3)), rng.normal(size=3)
    unit = types.SimpleNamespace(a=jnp.asarray(vector[0]), b=jnp.asarray(vector[1:]))
    limits, fields, places = np.zeros((2, 3)), (("a", ()), ("b", (2,))), ((0, 1, 2), (0, -1, 3), (1, 1, 1))
    expected = Expected(np.arange(n) / 10.0, middle, slopes, np.ones(2), limits, limits, fields, places)
    curve, other = middle + slopes @ vector
    due = [*(k + np.argmax(curve[k : k + 5]) for k in (0, 5)), np.argmax(other)]
    due[2:2] = [low + np.argmin(curve[low:high]) for low, high in ((0, 3), (3, 7), (7, 10))]
    np.testing.assert_array_equal(np.asarray(jax.jit(lambda: expected.angles_of(unit))()), np.array(due) / 10)


@pytest.mark.parametrize(("solved", "curves"), [(7, 1), (6, 2), (6, 3), (16, 2), (24, 3), (25, 3), (1000, 3)])
def test_all_angles_are_shared_out(solved, curves):
    places = responses._places(solved, curves, ())
    assert sum(number for *_, number in places) in (solved, solved - (curves == 1))
    pressures = [number for k, _, number in places if k]
    least = max(solved // 6, curves - 1) if curves > 1 else 0
    assert sum(pressures) in (least, least + 1) and min(pressures, default=1) >= 1
    assert places[0][2] == places[1][2] >= solved // 4 and {k for k, *_ in places} == set(range(curves))
    assert responses._places(solved, curves, range(curves)) == places
    if curves > 1:  # outputs that read pressures alone
        alone = responses._places(solved, curves, range(1, curves))
        assert {k for k, *_ in alone} == set(range(1, curves)) and sum(number for *_, number in alone) == solved
        assert responses._places(solved, curves, (1,)) == ((1, 1, solved),)


@pytest.mark.long  # slopes of units at all angles: test_cycloidal_loaded.py; the rule is the same
def test_slopes_are_those_of_the_plain_value(drive):
    own, expected, population, errors, _ = drive
    (part,) = parts(own.response(solve=False).replace(expected=expected), population)
    values, _, state = part.of_elements(population, errors)
    k, direction = part.names.index(ERROR), np.random.default_rng(1).normal(size=(len(errors), 1)) * 1e-6
    pull = np.zeros_like(values)
    pull[k] = 1.0
    slopes = (part.slopes_of_elements(population, errors, state, pull) * direction).sum(axis=0)
    ahead, back = (part.of_elements(population, errors + sign * 1e-3 * direction)[0][k] for sign in (1, -1))
    np.testing.assert_allclose(slopes, (ahead - back) / 2e-3, rtol=1e-4, atol=1e-9)


def test_the_mean_of_chosen_angles_has_no_value():
    error, force, one = jnp.array([1.0, 3.0, 2.0]), jnp.zeros((3, 1, 1, 2)), jnp.ones(3)
    info = jax.vmap(lambda x: SolveInfo(jnp.int32(0), jnp.int32(1), 0 * x))(one)
    names = ("largest_pin", "largest_pressure", "largest_arm_bearing", "largest_support_bearing", "disc_sharing")
    loads = dict.fromkeys(names, one) | dict(crank_sharing=None, fewest_pins=one)
    some, all_ = (summary(Instants(error, loads, force, force[:, 0], info), spaced=spaced) for spaced in (False, True))
    assert some.peak_to_peak == all_.peak_to_peak == 2.0 and some.largest_pin == 1.0 and all_.mean == 2.0
    assert np.isnan(some.mean) and np.isnan(some.harmonics).all() and np.isfinite(all_.harmonics[0])


def test_errors_without_a_tolerance_count_as_zero(drive):
    """A unit whose error is the number 0 has the angles of one with zeros in all places; results say what is left."""
    own, expected, population, errors, _ = drive
    unit = population.fill(population.by_field(errors[:, 0]))
    field, shape = next((name, shape) for name, shape in expected.fields if shape)
    angles = [np.asarray(expected.angles_of(unit.replace(**{field: zero}))) for zero in (0.0, np.zeros(shape))]
    np.testing.assert_array_equal(*angles)
    line = f"each unit is solved at {CHOSEN} of {ANGLES} angles of the span: "
    line += "errors and pressures are estimates, other largest values may be larger"
    assert line in own.inaccurate() and line not in asked(chosen_angles=None).inaccurate()


def test_without_a_choice_all_angles_are_solved():
    own = asked()
    response = own.response(solve=False)
    assert takes_few(response, own.tolerances) and own.chooses_angles
    for changed in (dict(chosen_angles=None), dict(chosen_angles=ANGLES)):
        assert not asked(**changed).chooses_angles and asked(**changed).units.expected is None
    whole_curve = Response.of(own.design, (ERROR, "mean_shift"), replace(own.conditions, second_torque=1.0))
    assert not takes_few(whole_curve, own.tolerances)  # a mean needs them
    assert not takes_few(Response.of(own.design, ("backlash",), own.conditions), own.tolerances)
    assert not takes_few(response, own.design.error_record())  # no unit differs from another


def test_outputs_that_need_the_whole_curve_are_known():
    """Of the outputs that read a turn, these read no extremes; one more must be thought of."""
    for name in ("cycloidal-17", "rv-40e-whole"):
        own = study.load(name, solve=False)
        kind = models.kind(own.design)
        few = kind.extremes((ERROR,))
        response = replace(own.response(solve=False), outputs=tuple(kind.outputs))
        reading = {output for output in kind.outputs if (None, turn) in response.read(output)}
        assert reading - set(few.outputs) == {"mean_shift", "order_amplitude"} and few.source is turn


def test_a_limit_that_chosen_angles_miss_is_said():
    own = asked()
    outputs = full_model_check.counterparts(own)
    assert outputs == {ERROR: ERROR, LOADED: LOADED} and full_model_check.counterparts(asked(chosen_angles=None)) == {}
    found = full_model_check.Whole(
        share=full_model_check.wilson(90, 100, 0.95), units=100, within={ERROR: 1.0, LOADED: 0.9},
        mean={ERROR: 1e-3, LOADED: 5e8}, output=outputs, failed=0, unread=(), angles=ANGLES, beyond={LOADED: 5e7},
    )  # fmt: skip
    text = full_model_check.whole_text(found, own)
    assert (
        "at 97 angles" in text
        and "at the chosen angles, about" in text
        and "over a turn of the output, about" not in text
    )


def test_a_budget_has_all_angles_of_a_curve():
    given = _of_curves(asked(samples=481)).conditions
    assert (given.samples, given.chosen_angles, given.span) == (251, None, "output_turn")
    assert _of_curves(asked()).conditions.samples == ANGLES
    whole = asked(chosen_angles=None)
    assert _of_curves(whole) is whole


def test_the_forecast_counts_the_angles_that_are_solved():
    work = models.kind(asked().design).work[turn]
    assert work(asked().conditions) == ("turn", CHOSEN) and work(asked(chosen_angles=None).conditions) == (
        "turn",
        ANGLES,
    )


def test_a_unit_keeps_its_angles_in_other_tolerances(drive):
    """Whose values would jump where one angle is exchanged for another; without a tolerance an error is plain."""
    own, expected, population, errors, _ = drive
    names = [name for name, tolerance in population.active.items() if tolerance.half_width > 0]
    scale = dict(zip(names, np.random.default_rng(3).uniform(0.2, 3.0, len(names))))
    tolerances = own.tolerances.replace(
        **{n: (t := getattr(own.tolerances, n)).scaled(t.half_width * scale[n]) for n in names}
    )
    others, z = Population.of(tolerances), drawn(population, root_key(5), np.uint32(0), count=8)
    moved = np.asarray(elements(others, z))
    assert not np.allclose(moved, errors)
    there = expected.among(others)
    for unit, same in zip(moved.T, errors.T):
        angles = there.angles_of(others.fill(others.by_field(unit)))
        np.testing.assert_array_equal(angles, expected.angles_of(population.fill(population.by_field(same))))
    (part,) = parts(own.response(solve=False).replace(expected=expected), others)
    found = part.of_elements(others, moved)[0][part.names.index(LOADED)]
    curves = np.asarray(responses._slopes(own.response(solve=False), others, moved)[0])[..., 1]
    for value, unit, curve in zip(found, moved.T, curves):
        angles = np.asarray(there.angles_of(others.fill(others.by_field(unit))))
        places = np.abs(expected.angles[:, None] - angles).argmin(axis=0)
        assert value == pytest.approx(float(expected.factors[1]) * curve[places].max(), rel=1e-9)
    narrow = expected.replace(limits=expected.limits * np.array([[1.0], [0.0]]))
    unit = population.fill(population.by_field(errors[:, 0]))  # curves of units without any tolerance
    np.testing.assert_array_equal(narrow.angles_of(unit), expected.angles_of(unit))
    few = Population.of(own.tolerances.replace(**{names[0]: None}))
    width = math.prod(dict(expected.fields)[names[0]])
    np.testing.assert_array_equal(expected.among(few).own[:, :width], expected.limits[:, :width])


def test_curves_are_learned_again_after_the_first_sample(monkeypatch):
    """By the tolerances that it ends with: all later units choose by these."""
    places = []
    nominal = dict.fromkeys(("a", "b"), Tolerance(-1.0, 1.0))
    cost = ReciprocalPower(reference=1.0, finest=0.05, coarsest=5.0)

    @record
    class Near(Record):
        scale: Any = field("-", "of the tolerances", default=1.0)
        costly = False

        def near(self, population):
            places.append({name: float(t.half_width) for name, t in population.active.items()})
            return self.replace(scale=1.1)

        def __call__(self, errors):
            return self.scale * (errors["a"] + errors["b"])

    found = allocate(
        Near(), nominal, Requirement(upper=1.0, target=0.95), costs=dict.fromkeys("ab", cost),
        samples=2000, certificate_samples=2000,
    )  # fmt: skip
    assert len(places) == 1 and found.status == "OPTIMAL"
    deviate = 1.1 * math.sqrt(sum(float(w) ** 2 for w in found.half_widths.values())) / 3
    assert 1.0 / deviate == pytest.approx(1.645, rel=0.08)  # with the response that is good there


def test_a_unit_without_errors_or_at_the_mid_points_has_no_factor(drive):
    """Its curves are the expected ones; with a factor a limit on it would be missed without cause."""
    own, expected, population, errors, _ = drive
    response = own.response(solve=False).replace(expected=expected.replace(factors=7 * np.ones(3)))
    plain = response.replace(expected=expected.replace(factors=np.ones(3)))
    found, _ = unit_at_mid_points(response, population)
    values, _ = unit_at_mid_points(plain, population)
    assert found == values and response.central.expected.factors[0] == 1
    design = DesignResponse(response, ())
    nominal, _ = nominal_outputs(design, population, (LOADED,))
    zero, _ = unit_of(plain, population, np.zeros(len(errors)))
    assert nominal[LOADED] == pytest.approx(zero[LOADED], rel=1e-9)


def test_an_output_at_a_level_has_no_factor(drive):
    """Its level is measured at all of its angles."""
    own, expected, *_ = drive
    response = own.response(solve=False).replace(expected=expected)
    leveled = response.replace(levels=((ERROR, (("samples", 24),), "float64", None),))
    few = models.kind(own.design).extremes((ERROR,))
    assert [set(r._factors(few)) for r in (response, leveled)] == [{ERROR, LOADED}, {LOADED}]


def test_results_of_other_tolerances_learn_from_these(monkeypatch):
    own, seen = asked(), []
    other = own.tolerances.replace(pin_offset=None)
    monkeypatch.setattr(definition, "learned", lambda _, population: seen.append(population.active.keys()))
    own.at_few(own.response(solve=False)), own.at_few(own.response(solve=False), other)
    assert [("pin_offset" in names) for names in seen] == [True, False]

    half = own.tolerances.throw.half_width
    wide, widths = own.tolerances.replace(throw=own.tolerances.throw.scaled(2 * half)), []
    monkeypatch.setattr(
        definition, "learned", lambda _, population: widths.append(float(population.active["throw"].half_width))
    )
    monkeypatch.setattr(results, "monte_carlo", lambda response, tolerances, **_: response)
    results.crossed(own, wide)  # `compare --on`
    assert widths == [pytest.approx(2 * float(half))]


def test_a_design_learns_with_its_numbers(drive):
    own, expected, population, *_ = drive
    path, size = "cycloid.eccentricity", float(own.design.cycloid.eccentricity)
    response = DesignResponse(own.response(solve=False).replace(expected=expected), tuple(sorted(own.given)))
    same, other = (response.near(population.replace(values={path: factor * size})) for factor in (1.0, 1.05))
    np.testing.assert_allclose(same.response.expected.middle, expected.middle, rtol=1e-6, atol=1e-9)
    assert same.response.design is own.design
    assert np.max(np.abs(other.response.expected.middle[0] / expected.middle[0] - 1)) > 1e-3


def test_the_fit_of_a_drive_is_that_of_a_turn_of_its_shaft(monkeypatch):
    """What is asked of `loaded.clearance`, which has its own tests: without a number of turns a turn of the shaft."""
    own, wanted = asked(samples=24), []
    result = types.SimpleNamespace(least=0.0, info=types.SimpleNamespace(status=0))
    monkeypatch.setattr(outputs, "clearance", lambda *_, **how: wanted.append(how) or result)
    output = models.kind(own.design).outputs["fit_clearance"]
    for conditions in (own.conditions, replace(own.conditions, chosen_angles=None)):
        output.evaluate(own.design, own.design.error_record(), conditions)
    assert wanted == [dict(samples=CHOSEN), dict(turns=1.0, samples=24)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_half_of_the_pins_work_and_come_first(sign):
    """One side of the line through the centres, in the order round the ring: what sorting by the lever gives."""
    count = 9
    turned = 2 * np.pi * (np.arange(count)[None] + np.array([[0.3], [5.6]])) / count
    rows = np.stack([np.cos(turned), np.sin(turned), np.sin(turned - 1.0)])[None]
    gap = np.arange(2.0 * count).reshape(1, 2, count)
    pins = Pins(jnp.asarray(rows), jnp.asarray(gap), jnp.ones((1, 1)), jnp.asarray(gap))
    s = System(pins, None, None, None, None, jnp.array([sign]))
    found = newton._working_first(s).pins
    pressed = np.asarray(found.rows)[0, 2] * sign < 0
    for disc, (row, places) in enumerate(zip(pressed, np.asarray(found.gap)[0])):
        assert row[: row.sum()].all() and not row[row.sum() :].any() and count // 2 <= row.sum() <= count // 2 + 1
        assert (np.diff(places - disc * count) % count == 1).all()
        np.testing.assert_array_equal(
            np.asarray(found.rows)[0, 1, disc], rows[0, 1, disc][(places - disc * count).astype(int)]
        )
