"""One bearing: closed forms, invariants, derivatives against differences, what cannot be rated.

Two programs for each method serve all cases: `lived`, and `slopes` for a few of them at once.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from life_cases import EXAMPLE
from loaded_cases import at, plain
from scipy.special import hyp2f1

from rvjax import RollerBearing, Status, life
from rvjax.life.damage import J4, J45, METHODS, ratings
from rvjax.loaded import unchecked
from rvjax.records import promote

RATING = 23759.782321641203  # N, worked by hand
ANGLES = 2 * np.pi * np.arange(36) / 36
ALIKE = np.ones(36)
SLOPES = ["basic", pytest.param("raceway", marks=pytest.mark.long), "slices"]  # a program each; laminae are of raceways


def fixed(size):
    return np.tile([size, 0.0], (len(ANGLES), 1))


def turning(size, angle=ANGLES):
    return size * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def lived(force, bearing=EXAMPLE, *, angle=ANGLES, weight=ALIKE, method="basic", clearance=0.0, tilt=0.0, crowned=True):
    """The life, every argument given and in one type."""
    numbers = plain(dict(angle=angle, weight=weight, clearance=clearance, tilt=tilt))
    return life.bearing_life(*plain((bearing, force)), method=method, crowned=crowned, **numbers)


@cache
def slopes(method):
    """Program: slopes of life and load together, of each case to all numbers, and the results."""

    def one(bearing, force, given):
        found = life.bearing_life(bearing, force, method=method, **given)
        return both(found), found

    return jax.jit(jax.vmap(jax.grad(one, argnums=(0, 1, 2), has_aux=True)))


def both(found):
    """Life and load in one number, each of size 1."""
    return found.life / 1e8 + found.load / 1e3


def slopes_of(method, *cases):
    """Of five cases (bearing, force, more arguments): slopes and results."""
    own = dict(angle=ANGLES, weight=ALIKE) | (dict(clearance=0.0, tilt=0.0) if method == "slices" else {})
    given = [plain((bearing, force, own | more)) for bearing, force, more in cases]
    given += given[:1] * (5 - len(given))  # one program
    return slopes(method)(*jax.tree.map(lambda *leaves: np.stack(leaves), *given))


def test_a_rating_is_a_million_revolutions():
    """The rating factor enters once, a given rating takes its place, two rows are one of double length."""
    assert float(life.bearing_life(EXAMPLE, fixed(RATING)).life) == pytest.approx(1e6, rel=1e-12)
    plain = float(life.dynamic_rating(EXAMPLE.replace(rating_factor=1.0)))
    assert float(life.dynamic_rating(EXAMPLE)) / plain == pytest.approx(1.1, rel=1e-12)
    longer = EXAMPLE.replace(roller_length=2 * EXAMPLE.roller_length)
    assert float(life.dynamic_rating(longer)) / RATING == pytest.approx(2 ** (7 / 9), rel=1e-12)
    given = EXAMPLE.replace(capacity=2 * RATING)
    found = life.bearing_life(given, fixed(RATING), angle=ANGLES, method="raceway")
    assert float(found.life) == pytest.approx(2 ** (10 / 3) * 1e6, rel=1e-6)


def test_the_static_rating_of_inclined_rollers():
    """ISO 76: C0 = 44 (1 - Dw cos(a)/Dpw) Z Lw Dw cos(a), lengths in mm."""
    tilted = EXAMPLE.replace(contact_angle=0.4)
    d, length, pitch = (1e3 * x for x in (EXAMPLE.roller_diameter, EXAMPLE.roller_length, EXAMPLE.pitch_diameter))
    due = 44 * (1 - d * np.cos(0.4) / pitch) * EXAMPLE.rollers * length * d * np.cos(0.4)
    assert float(life.static_rating(tilted)) == pytest.approx(due, rel=1e-9)


@pytest.mark.parametrize(("a", "b"), [(2763.1, 1961.9), (1000.0, 1000.0), (1.0, 500.0)])
def test_a_fixed_and_a_turning_load_have_a_closed_form(a, b):
    """Eq. 26, whatever the phase; neither the largest load nor the cubic mean."""
    due = np.hypot(a, b) * hyp2f1(-5 / 6, -1 / 3, 1, (2 * a * b / (a * a + b * b)) ** 2) ** 0.3
    for phase in (0.0, 1.0):
        force = fixed(a) + turning(b, ANGLES + phase)
        assert float(lived(force).load) == pytest.approx(due, rel=1e-6)  # kink at a = b


def test_the_ring_in_which_a_load_stands_decides():
    """Eq. 10: a load fixed in the outer ring counts as it is, one that turns with the inner ring for 2.7 % more."""
    found = lived(fixed(1000.0), method="raceway")
    assert float(found.load) == pytest.approx(1000.0, rel=1e-7)
    rated, k = jax.jit(ratings)(promote(EXAMPLE)), J45 / J4
    x = (J45 * float(rated.inner) / (J4 * float(rated.outer))) ** 4.5
    due = 1000 * ((k**4.5 + x * k**-4.5) / (1 + x)) ** (2 / 9)
    found = lived(turning(1000.0), method="raceway")
    assert float(found.load) == pytest.approx(due, rel=1e-7) and due == pytest.approx(1026.84, abs=0.01)


@pytest.mark.parametrize("method", ["basic", "raceway"])
def test_lives_fall_with_the_exponent_of_iso_281(method):
    force = fixed(900.0) + turning(700.0)
    lives = [float(lived(s * force, method=method).life) for s in (1.0, 3.0)]
    assert lives[0] / lives[1] == pytest.approx(3 ** (10 / 3), rel=1e-12)


def test_straight_laminae_without_clearance_follow_the_fourth_power():
    lives = [float(lived(s * fixed(2000.0), method="slices", crowned=False).life) for s in (1.0, 2.0)]
    assert lives[0] / lives[1] == pytest.approx(16, rel=1e-9)


@pytest.mark.parametrize(
    ("share", "flat", "profile", "tilted", "loose"),
    [
        (0.1, 20709.1, 8211.9, 5347.1, 7164.2),
        (0.2, 1294.32, 754.61, 571.97, 703.80),
        (0.4, 80.895, 61.622, 53.446, 56.842),
    ],
)
def test_laminae_agree_with_the_standard(share, flat, profile, tilted, loose):
    """Constant load, inner ring turns: lives in Mrev, evaluated with 1001 laminae and means over standing rollers;
    points of the ring and 41 laminae differ by 0.5 % from it, 1.5 % where few rollers carry."""
    force = fixed(share * RATING)
    ways = (
        (flat, {"crowned": False}),
        (profile, {}),
        (tilted, {"tilt": 1e-3}),
        (loose, {"clearance": 10e-6, "crowned": False}),
    )
    for due, options in ways:
        found = lived(force, method="slices", **options)
        assert float(found.life) / 1e6 == pytest.approx(due, rel=0.015), options


@pytest.mark.parametrize("method", METHODS)
def test_weights_are_shares_of_revolutions(method):
    """A load twice as often is two of it; one without weight is none; neither sum of the weights nor order matter."""
    options = dict(method=method, clearance=1e-6 if method == "slices" else 0.0)
    force = fixed(900.0) + turning(700.0)
    force[-1] = 9e3
    want = lived(force, weight=7 * np.r_[2.0, np.ones(34), 0.0], **options)
    twice = np.r_[0, np.arange(35)][::-1]
    found = lived(force[twice], angle=ANGLES[twice], **options)
    assert float(found.life) == pytest.approx(float(want.life), rel=1e-9)


@pytest.mark.parametrize("method", SLOPES)
def test_derivatives_are_those_of_the_plain_value(method):
    """Every number along a random direction. Steps of 1e-4: differences are good to 1e-7 of the value, slices are
    solved to 1e-13."""
    more = dict(angle=ANGLES, weight=1 + 0.3 * np.sin(ANGLES))
    more |= dict(clearance=2e-6, tilt=5e-4) if method == "slices" else {}
    force = fixed(2000.0) + turning(1500.0, ANGLES + 0.3)
    start = plain((EXAMPLE.replace(contact_angle=0.2), force, more))
    slope, found = at(slopes_of(method, start), 0)

    def value(bearing, force, more):
        return float(both(lived(force, bearing, method=method, **more)))

    random, (leaves, tree) = np.random.default_rng(0), jax.tree.flatten(start)
    assert float(both(found)) == pytest.approx(value(*start), rel=1e-12)
    for number, leaf in enumerate(leaves):
        step = 1e-4 * leaf * random.choice([-1.0, 1.0], np.shape(leaf))
        ends = [value(*tree.unflatten([*leaves[:number], leaf + s * step, *leaves[number + 1 :]])) for s in (-1, 1)]
        due = (ends[1] - ends[0]) / 2
        assert np.vdot(jax.tree.leaves(slope)[number], step) == pytest.approx(due, rel=1e-5, abs=1e-9), number


@pytest.mark.parametrize("method", SLOPES)
def test_no_load_is_an_infinite_life_with_zero_slope(method):
    some = fixed(100.0)
    some[5:9] = 0.0
    slope, found = slopes_of(method, (EXAMPLE, fixed(0.0), {}), (EXAMPLE, some, {}))
    assert float(found.life[0]) == np.inf and float(found.load[0]) == 0
    assert int(found.info.status[0]) == Status.UNLOADED
    assert not any(np.any(leaf[0]) for leaf in jax.tree.leaves(slope))
    assert all(np.isfinite(leaf[1]).all() for leaf in jax.tree.leaves(slope)) and np.any(slope[1][1])


@pytest.mark.parametrize("method", SLOPES)
def test_a_bad_case_leaves_its_neighbours(method):
    force, weight = fixed(1000.0), ALIKE.copy()
    force[3, 0], weight[0] = np.nan, -1.0
    large, negative = (unchecked(EXAMPLE, roller_diameter=size) for size in (40e-3, -1e-3))
    whole = fixed(1000.0)
    cases = ((EXAMPLE, whole, {}), (EXAMPLE, force, {}), (large, whole, {}), (negative, whole, {}))
    slope, found = slopes_of(method, *cases, (EXAMPLE, whole, dict(weight=weight)))
    bad = [Status.NONFINITE] + [Status.INVALID_GEOMETRY] * 3
    assert [int(s) for s in found.info.status] == [Status.CONVERGED, *bad]
    assert np.isnan(found.life[1:]).all() and np.isnan(found.load[1:]).all()
    assert float(found.life[0]) == pytest.approx(float(lived(whole, method=method).life), rel=1e-12)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))
    assert np.isnan(life.dynamic_rating(large))


@pytest.mark.parametrize("method", ["basic", *(pytest.param(m, marks=pytest.mark.long) for m in METHODS[1:])])
def test_single_precision_is_good_to_a_percent(method):
    force = fixed(900.0) + turning(700.0)
    small, small_force, angle = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (EXAMPLE, force, ANGLES))
    single = life.bearing_life(small, small_force, angle=angle, method=method)
    double = lived(force, method=method)
    assert single.life.dtype == jnp.float32
    assert float(single.life) == pytest.approx(float(double.life), rel=0.01)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: RollerBearing(14, 40e-3, 10e-3, 32e-3), "roller_diameter = 0.04 m: must be less than pitch_diameter"),
        (lambda: RollerBearing(30, 5e-3, 10e-3, 32e-3), "roller_diameter = 0.005 m: must be at most 0.0033"),
        (lambda: RollerBearing(14, -5e-3, 10e-3, 32e-3), "roller_diameter = -0.005 m: must be positive"),
        (lambda: RollerBearing(14, 5e-3, 0.0, 32e-3), "roller_length = 0 m: must be positive"),
        (lambda: RollerBearing(14, 5e-3, 1e-2, 32e-3, contact_angle=14), "contact_angle = 14 rad: .*degrees"),
        (lambda: RollerBearing(14, 5e-3, 1e-2, 32e-3, capacity=-1.0), "capacity = -1 N: must be positive"),
        (
            lambda: life.bearing_life(EXAMPLE.replace(capacity=24.0), fixed(1.0)),
            "capacity = 24 N: must be at least 11879.* N, 0.5 of what ISO 281 and ISO 76 give .* C0 = 25987.5 N; check",
        ),
        (
            lambda: life.bearing_life(EXAMPLE.replace(static_capacity=52e3), fixed(1.0)),
            "static_capacity = 52000 N: needs a dynamic rating of at least 23771",
        ),
        (lambda: life.bearing_life(EXAMPLE, fixed(1.0), method="iso"), "method = 'iso': must be one of basic, raceway"),
        (lambda: life.bearing_life(EXAMPLE, fixed(1.0), tilt=1e-3), "tilt = 0.001 rad: must be 0"),
        (lambda: life.bearing_life(EXAMPLE, [1.0, 2.0]), r"force: shape \(2,\), must be \(n, 2\) in N"),
        (lambda: life.bearing_life(EXAMPLE, fixed(1.0), angle=[0.0]), r"angle: shape \(1,\), must be \(36,\) in rad"),
    ],
)
def test_what_cannot_be_is_one_line(call, told):
    with pytest.raises(ValueError, match=told) as raised:
        call()
    assert "\n" not in str(raised.value)
