"""All crank bearings of one reducer: invariants, derivatives against differences, extremes. One program serves most.

The search for a torque runs on forces by a closed form; `test_life.py` and the long profile have those of equilibria.
"""

import dataclasses
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from crank_turn import crank_turn
from life_cases import BASIC, NAMED, PLAN, duty_of, rate, rate_together, rate_with_slopes, unit_of

import rvjax
from rvjax import Bearings, RVErrors, Status, life, study
from rvjax.life.machine import check_plan, reliability_factor
from rvjax.loaded import BearingForces, admit, bearing_forces, unchecked
from rvjax.population import Population, drawn, root_key
from rvjax.records import promote
from rvjax.status import SolveInfo
from rvjax.study import Response
from rvjax.units import rpm

CASE = NAMED[BASIC]
DESIGN, ERRORS = unit_of(CASE)
DUTY = duty_of(CASE)
ARM, SUPPORT = DESIGN.bearings.arm, DESIGN.bearings.support
FIELDS = ("life", "arm", "support", "arm_load", "support_load", "static_safety")


@pytest.fixture(scope="module")
def rated():
    return rvjax.check(rate_together(DESIGN, ERRORS, DUTY))


def assert_same(found, due, factor=1.0, rtol=1e-11):
    for name in ("life", "arm", "support"):
        np.testing.assert_allclose(getattr(found, name), factor * np.asarray(getattr(due, name)), rtol=rtol)
    for name in ("arm_load", "support_load", "static_safety"):
        np.testing.assert_allclose(getattr(found, name), getattr(due, name), rtol=rtol)


def test_phases_may_be_split_and_in_any_order(rated):
    """Two phases of one, with the rest last; a phase of zero time is read by the static safety alone."""
    assert_same(rate_together(DESIGN, ERRORS, jax.tree.map(lambda x: x[[2, 3, 0, 1]], DUTY)), rated)
    torque, speed = (np.r_[x[:3], x[0]] for x in (DUTY.output_torque, DUTY.output_speed))
    split = life.Duty(torque, speed, [0.05, 0.5, 0.2, 0.15])
    whole = life.Duty(torque, speed, [0.2, 0.5, 0.2, 0.0])
    assert_same(rate_together(DESIGN, ERRORS, split), rate_together(DESIGN, ERRORS, whole))
    peak = DUTY.replace(output_torque=np.r_[DUTY.output_torque[:3], 2060.0], time=np.r_[0.2, 0.5, 0.3, 0.0])
    calm = peak.replace(output_torque=np.r_[DUTY.output_torque[:3], 0.0])
    high, low = rate_together(DESIGN, ERRORS, peak), rate_together(DESIGN, ERRORS, calm)
    assert float(high.life) == pytest.approx(float(low.life), rel=1e-12)
    assert float(high.static_safety) < 0.6 * float(low.static_safety)


def test_lives_are_of_revolutions(rated):
    """Only shares of the time count; speed shortens lives in proportion; its sign does not matter; rest lengthens."""
    assert_same(rate_together(DESIGN, ERRORS, DUTY.replace(time=7 * DUTY.time)), rated)
    assert_same(rate_together(DESIGN, ERRORS, DUTY.replace(output_speed=-3 * DUTY.output_speed)), rated, 1 / 3)
    longer = DUTY.replace(time=np.r_[DUTY.time[:3], 1.1])
    assert_same(rate_together(DESIGN, ERRORS, longer), rated, 2.0)


def test_bearings_are_a_series_system(rated):
    """Eq. 24, and the powers of the ratings."""
    share = np.sum((rated.life / rated.arm) ** 1.125) + np.sum((rated.life / rated.support) ** 1.125)
    assert float(share) == pytest.approx(1, rel=1e-12)
    strong = jax.tree.map(lambda x: x, DESIGN)
    arm = strong.bearings.arm.replace(rating_factor=2.2)
    support = strong.bearings.support.replace(rating_factor=2.2)
    strong = strong.replace(bearings=strong.bearings.replace(arm=arm, support=support))
    assert_same(rate_together(strong, ERRORS, DUTY), rated, 2 ** (10 / 3))


def test_reliability_scales_all_lives_alike(rated):
    """Eq. 23: the table of ISO 281:2007, to its last digit."""
    for reliability, factor in ((0.95, 0.64), (0.99, 0.25)):
        found = rate_together(DESIGN, ERRORS, DUTY, reliability=reliability)
        a1 = 0.95 * (np.log(1 / reliability) / np.log(1 / 0.9)) ** (1 / 1.5) + 0.05
        assert_same(found, rated, a1)
        assert a1 == pytest.approx(factor, abs=0.005)
    shares = np.array([90, 95, 96, 97, 98, 99, 99.2, 99.4, 99.6, 99.8, 99.9, 99.92, 99.94, 99.95]) / 100
    table = [1, 0.64, 0.55, 0.47, 0.37, 0.25, 0.22, 0.19, 0.16, 0.12, 0.093, 0.087, 0.080, 0.077]
    factors = np.asarray(reliability_factor(shares))
    np.testing.assert_allclose(factors[:10], table[:10], atol=0.005)
    np.testing.assert_allclose(factors[10:], table[10:], atol=0.0005)


def test_derivatives_are_those_of_the_plain_value():
    """A unit whose contacts stay closed near this torque; a step of 1e-9 m, 1e-6 of the rest: 1e-3 of the slope."""
    given = (DESIGN, ERRORS, DUTY, 0.95)
    _, slope = rate_with_slopes(*given)
    rng = np.random.default_rng(0)

    def number(part, step):
        design, errors, duty, reliability = (*given[:part], jax.tree.map(np.add, given[part], step), *given[part + 1 :])
        return np.log(float(rate_together(design, errors, duty, reliability).life))

    for part in range(4):
        sizes = jax.tree.map(lambda x, part=part: 1e-9 if part == 1 else 1e-6 * np.abs(x), given[part])
        step = jax.tree.map(lambda x, s: s * rng.choice([-1.0, 1.0], np.shape(x)), given[part], sizes)
        ends = [number(part, jax.tree.map(lambda s, side=side: side * s, step)) for side in (-1, 1)]
        due = sum(np.sum(a * b) for a, b in zip(*map(jax.tree.leaves, (slope[part], step))))
        assert (ends[1] - ends[0]) / 2 == pytest.approx(float(due), rel=1e-3, abs=1e-9), part
    for name in ("pin_position", "disc_runout", "disc_cumulative_pitch", "sun_flank"):
        assert not np.any(getattr(slope[1], name)), name  # bounds, and errors of other models
    assert float(slope[3]) < 0


def test_nothing_that_turns_under_load_is_an_infinite_life():
    still = DUTY.replace(output_speed=np.zeros(4))
    found, slopes = rate_with_slopes(DESIGN, ERRORS, still)
    assert not any(np.any(slope) for slope in jax.tree.leaves(slopes))
    assert int(found.info.status) == Status.UNLOADED and np.isinf(found.arm).all() and np.isinf(found.support).all()
    assert not np.any(found.arm_load) and np.isfinite(found.static_safety)


def test_a_bad_number_is_a_status_and_leaves_its_neighbours(rated, thorough):
    """In any column, of a phase at rest too; a bearing that cannot be, a negative time, nothing but zero times."""
    column = {name: np.tile(getattr(DUTY, name), (8, 1)) for name in ("output_torque", "output_speed", "time")}
    column["output_torque"][1, 3] = np.nan
    column["output_speed"][2, 3] = np.inf
    column["time"][3, 0] = -0.1
    column["time"][4] = 0.0
    diameter = np.full(8, 6e-3)
    diameter[5], diameter[6] = 33e-3, np.nan
    radius = np.zeros(8) + ERRORS.pin_radius
    radius[7] = np.nan

    def one(torque, speed, time, diameter, radius, rate=rate_together):
        duty = unchecked(DUTY, output_torque=torque, output_speed=speed, time=time)
        arm = unchecked(DESIGN.bearings.arm, roller_diameter=diameter)
        design = DESIGN.replace(bearings=unchecked(DESIGN.bearings, arm=arm))
        return rate(design, ERRORS.replace(pin_radius=radius), duty)

    cases = list(zip(*column.values(), map(float, diameter), map(float, radius)))
    found = jax.tree.map(lambda *leaves: np.stack(leaves), *(one(*case) for case in cases))
    finite, fits = Status.NONFINITE, Status.INVALID_GEOMETRY
    due = [Status.CONVERGED, finite, finite, fits, fits, fits, finite, finite]
    many = jax.vmap(partial(one, rate=rate))
    for result in (found, *([many(*column.values(), diameter, radius)] if thorough else [])):
        assert [int(s) for s in result.info.status] == due
        for name in FIELDS:
            values = np.asarray(getattr(result, name))
            assert np.isnan(values[1:]).all(), name
            np.testing.assert_allclose(values[0], getattr(rated, name), rtol=1e-9)


def test_single_precision_is_good_to_a_percent(rated, thorough):
    """By default the types alone: equilibria and bearings have their numbers elsewhere."""
    small = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (DESIGN, ERRORS, DUTY))
    found = rate(*small) if thorough else jax.eval_shape(rate, *small)
    for name in FIELDS:
        assert getattr(found, name).dtype == jnp.float32, name
        if thorough:
            np.testing.assert_allclose(getattr(found, name), getattr(rated, name), rtol=0.01)


# --- the torque for a life

SOUGHT = PLAN | dict(life=2e7, output_speed=15 * rpm, contact="linear")


@pytest.mark.long  # by default under forces by a closed form, below
def test_a_torque_for_a_life_falls_with_life_and_speed():
    """As many revolutions need the same torque; none gives more than interference leaves."""
    found = rvjax.check(life.rated_torque(DESIGN, ERRORS, **SOUGHT))
    twice = life.rated_torque(DESIGN, ERRORS, **(SOUGHT | dict(life=1e7, output_speed=30 * rpm)))
    assert float(twice.torque) == pytest.approx(float(found.torque), rel=1e-9)
    longer = life.rated_torque(DESIGN, ERRORS, **(SOUGHT | dict(life=2.2e7)))
    assert float(longer.torque) < float(found.torque)
    found = life.rated_torque(DESIGN, ERRORS, **(SOUGHT | dict(life=1e15)))
    assert int(found.info.status) == Status.NO_BRACKET and np.isnan(found.torque)


@pytest.mark.long  # programs of Hertzian pins and of the slope; many steps of many equilibria
def test_a_torque_for_a_life_gives_it_back():
    """Its derivative is that of its differences."""
    options = PLAN | dict(output_speed=15 * rpm)
    asked = lambda x: life.rated_torque(DESIGN, ERRORS, life=x, **options)  # noqa: E731
    torque = float(rvjax.check(asked(2e7)).torque)
    duty = life.Duty(np.full(4, torque), np.full(4, -15 * rpm), np.ones(4))
    assert float(rate(DESIGN, ERRORS, duty).life) == pytest.approx(2e7, rel=1e-9)
    _, slope = jax.jvp(lambda x: asked(x).torque, (2e7,), (1.0,))  # of forward mode; test_derivatives.py transposes it
    ends = [asked(2e7 * share).torque for share in (1 - 1e-4, 1 + 1e-4)]
    assert float(slope) == pytest.approx(float(ends[1] - ends[0]) / 4e3, rel=1e-4) and float(slope) < 0
    found = asked(1e-6)
    assert int(found.info.status) == Status.CONTACT_OVERLOAD and np.isnan(found.torque)


LEFT, MOST = 50.0, 200.0  # N of interference; N m at which a contact law ends, between the start and the root


def told(layout, read, torques, angles, start, *, near):
    """Forces that are the same at every angle: the torque over the circle of the cranks, and what interference adds."""
    size = torques / read.design.cranks.circle_radius + LEFT
    force = jnp.stack([size, 0 * size], axis=-1)[None, :, None, :]
    many, supports = (len(angles), len(torques)), (len(angles), len(torques), layout.links, 2)
    arm = jnp.broadcast_to(force[:, :, None], (*many, layout.discs, layout.links, 2))
    status = jnp.broadcast_to(jnp.where(torques > MOST, int(Status.CONTACT_OVERLOAD), 0).astype(jnp.int32), many)
    info = SolveInfo(status, jnp.ones(many, jnp.int32), jnp.zeros(many))
    return BearingForces(arm, jnp.broadcast_to(force, supports), info, start)


def test_the_search_for_a_torque_under_forces_of_a_closed_form(monkeypatch):
    """Force P = T/R + interference; a series of arms under P and supports under P/2, Eqs. 6, 21 and 24."""
    monkeypatch.setattr(sys.modules["rvjax.life.rated"], "bearing_forces", told)
    design = DESIGN.replace(bearings=Bearings(arm=ARM, support=SUPPORT))
    options = PLAN | dict(samples=5, output_speed=-15 * rpm, reliability=0.95)  # a program that no other test has

    def search(time):
        found = life.rated_torque(design, ERRORS, life=time, **options)
        return float(found.torque), int(found.info.status)

    rates = [(share / float(life.dynamic_rating(b))) ** (10 / 3) for b, share in ((ARM, 1.0), (SUPPORT, 0.5))]
    system = np.sum(4 * np.power(rates, 9 / 8)) ** (8 / 9)  # four of each, under 1 N
    factor = 0.95 * (np.log(0.95) / np.log(0.9)) ** (1 / 1.5) + 0.05
    force = (1e6 / system / (2e7 * 15 * rpm * 40 / (2 * np.pi) / factor)) ** 0.3
    assert search(2e7) == (pytest.approx((force - LEFT) * design.cranks.circle_radius, rel=1e-9), Status.CONVERGED)
    assert search(1e15) == (pytest.approx(np.nan, nan_ok=True), Status.NO_BRACKET)
    assert search(1e-6) == (pytest.approx(np.nan, nan_ok=True), Status.CONTACT_OVERLOAD)


def test_the_slope_of_a_torque_for_a_life(monkeypatch):
    """Of ln T, where 0 = 30 - ln(budget) - 4 ln T - tilt T; the rule is linear, `test_derivatives.py` transposes it."""
    rated = sys.modules["rvjax.life.rated"]

    def missing(plan, given, x, start):
        return 30 - jnp.log(given.budget) - 4 * x - given.tilt * jnp.exp(x), jnp.int32(0), jnp.int32(1), start

    monkeypatch.setattr(rated, "_missing", missing)
    plan = check_plan(DESIGN, ERRORS, 5, 1.0, "basic", 0.9, 0.0, ("hertz", "fixed", "fixed"))
    design, errors, one = promote(DESIGN, ERRORS, 1.0)

    def solved(budget, tilt):
        return rated._solve(plan, rated.Given(design, errors, one, design.bearings, budget, tilt, one))[0]

    given = jnp.array(3.0), jnp.array(2e-4)
    x, slope = jax.jit(partial(jax.jvp, solved))(given, (jnp.array(0.7), jnp.array(-1e-4)))
    torque = float(jnp.exp(x))
    assert 30 - np.log(3.0) - 4 * float(x) == pytest.approx(2e-4 * torque, rel=1e-9)
    assert float(slope) == pytest.approx((-0.7 / 3.0 + 1e-4 * torque) / (4 + 2e-4 * torque), rel=1e-9)


def lacking(**changes):
    return DESIGN.replace(bearings=DESIGN.bearings.replace(**changes))


TAPERED = dict(support=SUPPORT.replace(contact_angle=0.2), preload=900.0)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: rate(DESIGN.replace(bearings=None), ERRORS, DUTY), "RVReducer.bearings = None"),
        (lambda: rate(DESIGN, ERRORS, DUTY, method="iso"), "method = 'iso'"),
        (lambda: rate(DESIGN, ERRORS, DUTY, reliability=1.0), "reliability = 1: must lie between 0 and 1"),
        (lambda: rate(DESIGN, ERRORS, DUTY, reliability=-0.5), "reliability = -0.5"),
        (lambda: rate(DESIGN, ERRORS, DUTY, samples=0), "samples = 0: must be an integer of at least 1"),
        (lambda: rate(DESIGN, ERRORS, DUTY, turns=0.51), "turns = 0.51: must be a whole number of crank turns"),
        (lambda: rate(DESIGN, ERRORS, DUTY, turns=0.0), "turns = 0: must be"),
        (lambda: rate(DESIGN, ERRORS, DUTY, tilt=1e-3), "tilt = 0.001 rad"),
        (lambda: rate(DESIGN, ERRORS, (412.0, 1.0, 1.0)), "duty: must be a Duty"),
        (lambda: life.Duty([1.0, 2.0], [1.0], [1.0, 1.0]), "output_speed: shape .1,. has 1 phases"),
        (lambda: life.Duty([], [], []), "output_torque = .* must have at least one phase"),
        (lambda: life.Duty([1.0], [1.0], [-1.0]), "Duty.time = .*: must be zero or positive"),
        (lambda: life.Duty([1.0, 1.0], [1.0, 1.0], [0.0, 0.0]), "Duty.time = .*: must have a positive sum"),
        (lambda: lacking(arm=ARM.replace(contact_angle=0.1)), "Bearings.arm.contact_angle = 0.1 rad: must be 0"),
        (lambda: lacking(support=SUPPORT.replace(contact_angle=0.1)), "tapered supports need preload in N"),
        (lambda: rate(lacking(arm=ARM.replace(capacity=31.0)), ERRORS, DUTY), "Bearings.arm.capacity = 31 N: must be"),
        (lambda: lacking(support_span=None), "Bearings.support_span = None: give all of"),
        (lambda: lacking(preload=900.0), "support.contact_angle = 0 rad: must be positive"),
        (lambda: rate(lacking(**TAPERED), ERRORS, DUTY, method="raceway"), "method = 'raceway': must be \"basic\""),
        (lambda: rate(lacking(disc_position=np.ones(3)), ERRORS, DUTY), r"Bearings.disc_position: shape \(3,\)"),
        (lambda: life.rated_torque(DESIGN, ERRORS, life=0.0, output_speed=1.0), "life = 0 s: must be positive"),
        (lambda: life.rated_torque(DESIGN, ERRORS, life=1.0, output_speed=0.0), "output_speed = 0 rad/s"),
    ],
)
def test_what_cannot_be_is_one_line(call, told):
    with pytest.raises(ValueError, match=told) as raised:
        call()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('time = "1 h"', 'time = "-1 h"', r"duty\[0\].time = -3600 s: must not be negative"),
        ('time = "1 h"', 'time = "0 h"', "duty.time = 0 s in all phases: must have a positive sum"),
        ('"15 rpm"', '"0 rpm"', "duty.output_speed = 0 rad/s in all phases that last: must not be 0 in all of them"),
        ('time = "1 h"', "", r"duty\[0\].time is missing: every phase has one, in s"),
        ('time = "1 h"', 'time = ["1 h", "2 h"]', r"duty\[0\].time = \['1 h', '2 h'\]: needs one number"),
        ("[conditions]", '[design.bearings.arm]\ncapacity = "31 N"\n[conditions]', "arm.capacity = 31 N: must be"),
        ("[conditions]", "[design.bearings.arm]\nrollers = 30\n[conditions]", "roller_diameter = 0.006 m: .* overlap"),
        (
            "[conditions]", '[design.bearings]\ndisc_position = ["1 mm", "2 mm", "3 mm"]\n[conditions]',
            r"design.bearings.disc_position: shape \(3,\) does not fit",
        ),
    ],
)  # fmt: skip
def test_a_study_that_cannot_have_a_life_is_one_line(old, new, told):
    text = study.load("rv-40e-whole", solve=False).text
    assert old in text
    with pytest.raises(study.StudyError, match=told) as raised:
        study.parse_study(text.replace(old, new, 1), name="x", solve=False)
    assert "\n" not in str(raised.value)


@pytest.mark.long
def test_the_example_of_the_page():
    """RV-40E with the bearings of the catalogue: docs/models/life.md prints these numbers."""
    none, duty = RVErrors(), life.Duty([412.0], [15 * rpm], [1.0])
    hours = {m: float(life.rating(DESIGN, none, duty, method=m).life) / 3600 for m in ("basic", "raceway", "slices")}
    assert hours["basic"] == pytest.approx(9688, rel=1e-3)
    assert hours["raceway"] == pytest.approx(8469, rel=1e-3)
    assert hours["slices"] == pytest.approx(33495, rel=5e-3)
    rated = [life.rated_torque(DESIGN, none, life=6000 * 3600.0, output_speed=n * rpm) for n in (5, 15, 60)]
    torques = [float(found.torque) for found in rated]
    np.testing.assert_allclose(torques, [661.5, 475.7, 313.8], rtol=2e-4)


ASKED = ("loaded_transmission_error", "arm_bearing_force", "life", "static_safety")
PHASES = ((412.0, 1.5, 1.0), (-200.0, 3.0, 0.5))


def test_a_crank_turn_and_a_life_are_one_part():
    """With a level of its own, or alone, either is a part for itself."""
    asked = crank_turn("rv-40e-whole", 24)
    groups = [set(part.outputs) for part in asked.response().parts()]
    turn = {"loaded_transmission_error", "turn_pin_pressure", "arm_bearing_force"}
    assert sorted(groups, key=len) == [{"misfit"}, {"bench_lost_motion"}, turn | {"life"}]
    alone = asked.response().replace(levels=(("life", (("life_samples", 24),), "float64", None),))
    assert {"life"} in [set(part.outputs) for part in alone.parts()]
    assert [part.curve for part in alone.parts()].count(True) == 1


@pytest.mark.long
def test_a_crank_turn_and_a_life_in_one_loop_are_what_they_are_apart():
    asked = study.load("rv-40e-whole", solve=False)
    given = dataclasses.replace(asked.conditions, samples=4, life_samples=6, duty=PHASES)
    population = Population.of(asked.tolerances)
    errors = population.errors(drawn(population, root_key(1), jnp.uint32(0), count=1)[:, 0])
    whole, turn, life_ = (jax.jit(Response.of(asked.design, names, given)) for names in (ASKED, ASKED[:2], ASKED[2:]))
    apart = turn(errors).value | life_(errors).value
    for name, value in whole(errors).value.items():
        np.testing.assert_allclose(value, apart[name], rtol=1e-9, err_msg=name)


@pytest.mark.long
def test_near_angles_start_from_the_one_before():
    """24 angles start from the one before and give the forces of cold starts; 12 start from the linear step."""
    plans = [check_plan(DESIGN, ERRORS, n, 1.0, "basic", 0.9, 0.0, ("hertz", "fixed", "fixed")) for n in (12, 24)]
    assert [plan.near for plan in plans] == [False, True]
    plan = plans[1]

    @jax.jit
    def both(design, errors):
        read = admit(plan.layout, *promote(design, errors), jnp.array([412.0, -200.0]), 0.0)
        angles = plan.input_angles(read.design, read.torque.dtype)
        return [bearing_forces(plan.layout, read, read.torque, angles, near=near) for near in (False, True)]

    cold, warm = both(DESIGN, ERRORS)
    assert np.all(cold.info.status == Status.CONVERGED) and np.all(warm.info.status == Status.CONVERGED)
    np.testing.assert_allclose(warm.arm, cold.arm, rtol=1e-9, atol=1e-6)
    assert np.array_equal(warm.info.steps[0], cold.info.steps[0])  # nothing lies before it
    assert np.any(warm.info.steps != cold.info.steps)
