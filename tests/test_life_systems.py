"""Systems of ball and roller bearings: lives and torques against closed forms, bisection and differences."""

import math
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from life_cases import PLAN, plain
from scipy.integrate import quad
from test_life_balls import ARM, BALL_ARM, DESIGN, DUTY, ERRORS, ROLLERS, dynamic
from test_life_cycloidal import told as told_of_drive
from test_life_machine import LEFT, told

import rvjax
from rvjax import Bearings, CycloidalErrors, catalogue, life
from rvjax.life.machine import system
from rvjax.loaded import BearingForces, unchecked
from rvjax.status import SolveInfo
from rvjax.units import rpm

RATES = np.array([0.3, 1.1, 0.9, 2.0]), np.array([0.7, 0.2, 1.5])
SLOPES = 10 / 9, 9 / 8


def whole(arm, support, slopes=SLOPES):
    return system([(arm, slopes[0]), (support, slopes[1])])


def bisected(parts):
    """Rate at which the sum of (rate of a part / rate)^slope is 1, in plain Python."""
    low, high = 1e-300, 1e300
    for _ in range(3000):
        middle = math.sqrt(low) * math.sqrt(high)
        if sum((r / middle) ** slope for rates, slope in parts for r in rates if r) > 1:
            low = middle
        else:
            high = middle
    return low


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e12])
@pytest.mark.parametrize("share", [0.0, 1e-6, 1.0, 50.0])
def test_a_system_of_both_takes_the_slope_of_each(scale, share):
    arm, support = scale * RATES[0], scale * share * RATES[1]
    due = bisected([(arm.tolist(), SLOPES[0]), (support.tolist(), SLOPES[1])])
    assert float(jax.jit(whole)(arm, support)) == pytest.approx(due, rel=1e-12)


def test_many_unequal_bearings_in_a_system():
    """Twelve arms and sixteen supports over three decades: more than any reducer has."""
    rng = np.random.default_rng(0)
    parts = [(10 ** rng.uniform(-3, 0, n), slope) for n, slope in zip((12, 16), SLOPES)]
    due = bisected([(rates.tolist(), slope) for rates, slope in parts])
    assert float(system(parts)) == pytest.approx(due, rel=1e-12)


def test_equal_slopes_are_the_closed_form():
    """Two groups of one slope by the search, and one group by the formula, to rounding."""
    due = np.sum(np.concatenate(RATES) ** 1.125) ** (1 / 1.125)
    assert float(whole(*RATES, slopes=(1.125, 1.125))) == pytest.approx(due, rel=1e-13)
    assert float(system([(np.concatenate(RATES), 1.125)])) == pytest.approx(due, rel=1e-13)


def test_a_system_has_the_slopes_of_the_implicit_equation():
    """dL/dr_b = slope (r_b/L)^(slope - 1) / sum of slope (r/L)^slope; nothing where nothing turns; single precision."""
    found = float(jax.jit(whole)(*RATES))
    each = [e * (r / found) ** (e - 1) for r, e in zip(RATES, SLOPES)]
    due = [one / sum(np.sum(e * (r / found) ** e) for r, e in zip(RATES, SLOPES)) for one in each]
    for one, other in zip(jax.jit(jax.grad(whole, argnums=(0, 1)))(*RATES), due):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    with jax.debug_nans(True):
        still = jax.jit(jax.value_and_grad(whole, argnums=(0, 1)))(0 * RATES[0], 0 * RATES[1])
    assert all(not np.any(x) for x in jax.tree.leaves(still))
    single = jax.jit(whole)(*(jnp.asarray(r, jnp.float32) for r in RATES))
    assert single.dtype == jnp.float32 and float(single) == pytest.approx(found, rel=1e-6)


def test_a_mixed_system_has_the_second_slopes_of_differences():
    first = jax.jit(jax.grad(lambda r: whole(r, RATES[1])))
    way = np.array([1.0, -2.0, 0.5, 1.0])
    _, second = jax.jit(lambda: jax.jvp(first, (RATES[0],), (way,)))()
    due = (first(RATES[0] + 1e-5 * way) - first(RATES[0] - 1e-5 * way)) / 2e-5
    np.testing.assert_allclose(second, due, atol=1e-8)


def forces_of(function, monkeypatch, module="rated"):
    """A rating without equilibria: forces by a formula, see `test_life_machine`."""
    monkeypatch.setattr(sys.modules[f"rvjax.life.{module}"], "bearing_forces", function)


def test_a_torque_of_ball_arms_and_roller_supports(monkeypatch):
    """Arms under P and supports under P/2 at every angle; the life of both by bisection."""
    forces_of(told, monkeypatch)
    design = DESIGN.replace(bearings=Bearings(arm=ARM, support=ROLLERS.support))
    found = rvjax.check(life.rated_torque(design, ERRORS, life=2e7, output_speed=-15 * rpm, **PLAN | dict(samples=5)))
    force = float(found.torque) / design.cranks.circle_radius + LEFT
    arm = (force / dynamic(ARM)) ** 3
    support = (force / 2 / float(life.dynamic_rating(ROLLERS.support))) ** (10 / 3)
    rate = bisected([([arm] * 4, SLOPES[0]), ([support] * 4, SLOPES[1])])
    assert 1e6 / rate == pytest.approx(2e7 * 15 * rpm * 40 / (2 * np.pi), rel=1e-8)


def test_a_torque_of_a_drive_with_balls(monkeypatch):
    """Both discs' bearings under a constant force: C (1e6/revolutions)^(1/3) over 2^(1/(3 slope))."""
    forces_of(told_of_drive, monkeypatch)
    drive = catalogue.CYCLOIDAL_17.replace(bearings=Bearings(arm=ARM))
    options = dict(samples=5, output_speed=-20 * rpm, life=2e7)
    found = rvjax.check(life.rated_torque(drive, CycloidalErrors(), **options))
    pins = drive.cycloid.pin_count
    force = dynamic(ARM) * (1e6 / (2e7 * 20 * rpm * pins / (2 * np.pi))) ** (1 / 3) / 2**0.3
    lever = 2 * drive.cycloid.eccentricity * abs(drive.ratio)
    assert float(found.torque) == pytest.approx(force * lever, rel=1e-9)


def around(layout, read, torques, angles, *, near):
    """Forces in proportion to the torque, other ones at every angle, disc and crank."""
    many = len(angles), len(torques), layout.discs, layout.links
    steps = 10.0 + np.arange(np.prod(many) // len(torques)).reshape(many[0], 1, *many[2:])
    size = jnp.abs(torques).reshape(1, -1, 1, 1) * steps
    arm = jnp.stack([0.6 * size, 0.8 * size], axis=-1)
    info = SolveInfo(*(jnp.full(many[:2], value) for value in (jnp.int32(0), jnp.int32(1), 0.0)))
    return BearingForces(arm, 1.5 * arm[:, :, 0], info, None)


def rated_with_slope(samples):
    """Program: rating of the RV reducer under the duty, and the slope of the logarithm of its life to the bearings."""

    def one(bearings):
        found = life.rating(DESIGN.replace(bearings=bearings), ERRORS, DUTY, **PLAN | dict(samples=samples))
        return jnp.log(found.life), found

    return jax.jit(jax.grad(one, has_aux=True))


@pytest.mark.parametrize("forces", [around, pytest.param(None, marks=pytest.mark.long)])  # by formula; equilibria
def test_a_reducer_with_ball_arms_and_roller_supports(monkeypatch, forces):
    """Lives (C/P)^3 and (C/P)^(10/3); the system by Eq. 24 with both slopes; slopes by differences."""
    if forces is not None:
        forces_of(forces, monkeypatch, "rating")
    bearings, rate = plain(BALL_ARM), rated_with_slope(8 if forces is None else 7)  # programs of their own
    slope, found = rate(bearings)
    rvjax.check(found)
    if forces is not None:
        u = np.abs(DUTY.output_speed) * DUTY.time
        size = 10 + np.arange(7 * found.arm.size).reshape(7, *found.arm.shape)
        load = np.mean(size**3, axis=0) ** (1 / 3) * np.sum(u * np.abs(DUTY.output_torque) ** 3 / np.sum(u)) ** (1 / 3)
        np.testing.assert_allclose(found.arm_load, load, rtol=1e-9)
    turns = np.sum(np.abs(DUTY.output_speed) * DUTY.time) / np.sum(DUTY.time) * DESIGN.cycloid.pin_count / (2 * np.pi)
    due = 1e6 * (dynamic(ARM) / np.asarray(found.arm_load)) ** 3 / turns
    np.testing.assert_allclose(found.arm, due, rtol=1e-9)
    rating = float(life.dynamic_rating(ROLLERS.support))
    due = 1e6 * (rating / np.asarray(found.support_load)) ** (10 / 3) / turns
    np.testing.assert_allclose(found.support, due, rtol=1e-9)
    shares = [(float(found.life) / np.ravel(x)) ** e for x, e in zip((found.arm, found.support), SLOPES)]
    assert sum(map(np.sum, shares)) == pytest.approx(1, rel=1e-12)
    first = life.first_failures(found, BALL_ARM)
    np.testing.assert_allclose(first.arm.ravel(), shares[0], rtol=1e-12)
    np.testing.assert_allclose(first.support.ravel(), shares[1], rtol=1e-12)
    for place, name in (("arm", "ball_diameter"), ("arm", "inner_groove"), ("support", "roller_length")):
        part = getattr(bearings, place)
        own, ends = getattr(part, name), []
        for side in (-1e-6, 1e-6):
            moved = unchecked(bearings, **{place: unchecked(part, **{name: own * (1 + side)})})
            ends.append(np.log(float(rate(moved)[1].life)))
        due = (ends[1] - ends[0]) / 2e-6 / own
        assert float(getattr(getattr(slope, place), name)) == pytest.approx(float(due), rel=1e-4)


def test_shares_of_the_failures_of_both():
    """By integration of the hazards until the life, 10 % of such systems fail: within 1e-3."""
    lives = 1 / RATES[0], 1 / np.array([0.7, 0.2])
    found = unchecked(life.Rating(*(0.0,) * 7), life=1 / whole(*(1 / x for x in lives)), arm=lives[0], support=lives[1])
    shares = life.first_failures(found, Bearings(arm=ARM, support=ROLLERS.support))
    log = math.log(1 / 0.9)

    def survival(t):
        return math.exp(-log * sum(np.sum((t / x) ** e) for x, e in zip(lives, SLOPES)))

    for own, given, e in zip(lives, shares, SLOPES):
        for x, share in zip(own, np.ravel(given)):
            hazard = lambda t, x=x, e=e: log * e / x * (t / x) ** (e - 1) * survival(t)  # noqa: E731
            assert float(share) == pytest.approx(quad(hazard, 0, float(found.life))[0] / 0.1, rel=1e-3)
