"""Mesh forces over random designs: census of statuses, equilibrium, invariants, derivatives.

Oracle: NumPy with the paper's own angles (tests/cam_roller.py): statics and approaches are evaluated from
the returned forces, not from anything the solver computed. Moments close to 1e-12 of their sum; the angle
z theta (up to 400 rad) is rounded differently, which leaves 1e-9. Derivatives are compared with central
differences of the solver, whose own accuracy limits them to 1e-6.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Status
from tests.oracles import cam_roller
from tests.oracles.cam_roller import approach, corr, geometry, half_widths, random_units, solve

TEETH = (2, 8, 25)  # the census of benchmarks/census/extremes.py draws a million, up to 200 teeth
UNITS = 3000  # of each


@pytest.mark.parametrize("teeth", [pytest.param(n, marks=[] if n == 8 else [pytest.mark.long]) for n in TEETH])
def test_census_of_random_designs(teeth):
    """Every lane converges, or is overloaded and only then; equilibrium and compatibility hold for the rest."""
    cases = random_units(teeth, UNITS, np.random.default_rng(teeth))
    result = solve(teeth, cases)
    status = result.info.status
    good, over = status == Status.CONVERGED, status == Status.CONTACT_OVERLOAD
    assert (good | over).all(), {Status(int(s)).name: int((status == s).sum()) for s in np.unique(status)}
    assert good.mean() > 0.9 and np.isnan(result.windup[over]).all()
    assert result.info.residual[good].max() <= 1e-12

    cases = {name: v[good] for name, v in cases.items()}
    result = jax.tree.map(lambda leaf: leaf[good], result)
    place, torque = geometry(teeth, cases), (cases["cam_share"] * cases["torque"])
    moments = place["arm"] * result.cam
    size = np.maximum(np.abs(torque), np.abs(moments).sum(1))
    assert (np.abs(moments.sum(1) - torque) / size).max() < 1e-9
    # sum s Fs = (z + 1) T for any load sharing, preloaded or not
    assert (np.abs((place["s"] * result.cage).sum(1) - (teeth + 1) * torque) / size).max() < (teeth + 1) * 1e-9
    # triangle of forces on every roller
    largest = result.gear.max(1, keepdims=True)
    triangle = (
        result.cam * np.cos(place["gamma"]) - result.gear * np.cos(place["beta"]),
        result.cam * np.sin(place["gamma"]) + result.gear * np.sin(place["beta"]) - result.cage,
    )
    assert max(np.abs(leg / largest).max() for leg in triangle) < 1e-9
    assert (half_widths(teeth, cases, result) < 1).all()
    # loaded rollers: approach = windup a + g; unloaded ones keep a gap
    depth = result.windup[:, None] * place["arm"] + place["gap"]
    size = np.abs(depth).max(1, keepdims=True)
    loaded = result.cam > 0
    assert np.abs(np.where(loaded, approach(teeth, cases, result, "hertz") - depth, 0) / size).max() < 1e-9
    assert np.where(loaded, 0, depth / size).max() < 1e-9


@pytest.mark.parametrize("contact", ["palmgren", pytest.param("linear", marks=pytest.mark.long)])
def test_census_of_the_other_contacts(contact):
    teeth = 8
    cases = random_units(teeth, UNITS, np.random.default_rng(1))
    result, place = solve(teeth, cases, contact), geometry(teeth, cases)
    assert (result.info.status == Status.CONVERGED).all() and result.info.residual.max() <= 1e-12
    depth = result.windup[:, None] * place["arm"] + place["gap"]
    size, loaded = np.abs(depth).max(1, keepdims=True), result.cam > 0
    assert np.abs(np.where(loaded, approach(teeth, cases, result, contact) - depth, 0) / size).max() < 1e-9
    assert np.where(loaded, 0, depth / size).max() < 1e-9


def test_overload_begins_where_a_half_width_reaches_a_radius():
    """Bisect the torque between CONVERGED and CONTACT_OVERLOAD: the last solvable load stands at the limit."""
    rng, teeth = np.random.default_rng(2), 8
    cases = random_units(teeth, 512, rng, torque=(0, 1), error=(-7, -5))
    low, high = np.log10(cases["torque"] ** 2) / 2 - 8, np.full(512, 14.0)
    for _ in range(20):  # 2e-5 decades of torque, 3e-5 of a half-width
        middle = (low + high) / 2
        result = solve(teeth, cases | {"torque": 10**middle})
        assert np.isin(result.info.status, [Status.CONVERGED, Status.CONTACT_OVERLOAD]).all()
        fine = result.info.status == Status.CONVERGED
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    cases |= {"torque": 10**low}
    result = solve(teeth, cases)
    widest = half_widths(teeth, cases, result).max((1, 2))
    assert (widest < 1).all() and widest.min() > 0.999


@pytest.mark.parametrize("contact", ["hertz", pytest.param("palmgren", marks=pytest.mark.long)])
def test_symmetries(contact):
    """Cyclic shifts, mirror image, similarity, and what the torque and the modulus scale."""
    teeth, n = 8, 9
    rng = np.random.default_rng(4)
    cases = random_units(teeth, 400, rng, torque=(-1, 2), error=(-7, -5)) | {"angle": rng.uniform(-1, 1, 400)}
    base = solve(teeth, cases, contact)
    ok = base.info.status == Status.CONVERGED
    assert ok.mean() > 0.95
    place = geometry(teeth, cases)
    near = np.abs(base.windup[:, None] * place["arm"] + place["gap"]).max(1)

    def same(changes, roll=lambda force: force, force=1.0, windup=1.0, cage=1.0):
        result = solve(teeth, cases | changes, contact)
        np.testing.assert_array_equal(result.info.status, base.info.status)
        stiff = base.gear.max(1, keepdims=True)
        # micrometre gaps over nanometre approaches amplify the rounding of z theta
        gap = 1e-14 * np.abs(place["gap"]).max(1) / np.maximum(near, 1e-300)
        for name, sign in (("cam", 1.0), ("cage", cage), ("gear", 1.0)):
            error = np.abs(getattr(result, name) - sign * force * roll(getattr(base, name))) / (force * stiff)
            assert (error[ok].max(1) <= 1e-7 + gap[ok]).all(), name
        np.testing.assert_allclose(result.windup[ok], windup * base.windup[ok], rtol=1e-8)

    radii = "errors.roller_radius"
    same(
        {"angle": cases["angle"] + 2 * np.pi / (teeth * n), radii: np.roll(cases[radii], 1, 1)},
        lambda f: np.roll(f, 1, 1),
    )
    same({"angle": cases["angle"] + 2 * np.pi / n, radii: np.roll(cases[radii], -1, 1)}, lambda f: np.roll(f, -1, 1))

    def mirrored(force):
        return np.roll(force[:, ::-1], 1, 1)

    mirror = {"angle": -cases["angle"], "torque": -cases["torque"], radii: mirrored(cases[radii])}
    same(mirror, mirrored, cage=-1.0, windup=-1.0)
    lengths = (
        "cam_radius",
        "roller_radius",
        "roller_length",
        "eccentricity",
        *("errors." + n for n in cam_roller.ERRORS),
    )
    same({name: 3 * cases[name] for name in lengths} | {"torque": 27 * cases["torque"]}, force=9.0)
    same({"cam_share": 2 * cases["cam_share"], "torque": cases["torque"] / 2})
    if contact == "hertz":
        same({"young_modulus": 2 * cases["young_modulus"], "torque": 2 * cases["torque"]}, force=2.0)


LANES, EIGHT = 64, 8
ROWS = 3 * (EIGHT + 1) + 1  # cam, cage, gear, wind-up


def outputs(contact, case):
    """Forces and wind-up of a unit of eight teeth in one row: cam, cage, gear, wind-up."""
    result = cam_roller.single(EIGHT, contact, case)
    return jnp.concatenate([result.cam, result.cage, result.gear, result.windup[None]])


@functools.cache
def program(contact):
    """That row, and by reverse mode the derivatives of a weighted sum of it."""

    def pulled(case, weights):
        row, pull = jax.vjp(functools.partial(outputs, contact), case)
        return row, pull(weights)[0]

    return jax.jit(jax.vmap(pulled))


def pull(contact, cases, weights):
    """Derivatives of the weighted rows of a batch, and the rows; the last unit fills it, so that one program serves."""
    count = len(cases["torque"])
    index = np.minimum(np.arange(LANES), count - 1)
    rows, found = program(contact)(
        {name: v[index] for name, v in cases.items()}, np.broadcast_to(weights, (count, ROWS)).astype(float)[index]
    )
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], (found, rows))


def slopes(contact, cases, read=range(ROWS)):
    """Derivatives of some numbers of each row, (units, numbers, ...), and the rows."""
    each = [pull(contact, cases, np.eye(ROWS)[k]) for k in read]
    return {name: np.stack([found[name] for found, _ in each], axis=1) for name in cases}, each[0][1]


def test_reciprocity_and_the_balance_of_derivatives():
    """dF_i/dg_j is symmetric, and an interference changes no moment: sum_i a_i dF_i/dg_j = 0."""
    cases = random_units(EIGHT, LANES, np.random.default_rng(6), torque=(0, 2), error=(-7, -6))
    jacobian = slopes("hertz", cases, range(EIGHT + 1))[0]["errors.roller_radius"]  # of the cam
    place = geometry(EIGHT, cases)
    jacobian = jacobian / (1 + np.abs(place["cage_ratio"]) + place["gear_ratio"])[:, None, :]  # by g_j
    size = np.abs(jacobian).max((1, 2), keepdims=True)
    ok = np.isfinite(size[:, 0, 0])
    assert ok.mean() > 0.95
    assert np.abs((jacobian - np.swapaxes(jacobian, 1, 2)) / size)[ok].max() < 1e-12
    balance = np.einsum("ui,uij->uj", place["arm"], jacobian) / (size[:, 0] * place["arm"].max(1, keepdims=True))
    assert np.abs(balance)[ok].max() < 1e-11


@pytest.mark.parametrize(
    "contact", ["hertz", *(pytest.param(law, marks=pytest.mark.long) for law in ("linear", "palmgren"))]
)
def test_derivatives_equal_central_differences(contact, thorough):
    """Every input of 32 random units, where no roller gains or loses contact within the step.

    Reverse mode, which is forward mode transposed; in the long profile forward mode itself too.
    """
    count = 32
    cases = random_units(EIGHT, count, np.random.default_rng(7), torque=(0, 2), error=(-7, -6)) | {
        "angle": np.linspace(-1, 1, count)
    }
    scale = {name: np.abs(v) for name, v in cases.items()} | {"angle": np.full(count, 0.02)}
    scale |= {n: np.full_like(cases[n], 1e-6) for n in cases if n.startswith("errors.")}
    direction = {
        name: np.random.default_rng(k).normal(size=v.shape) * scale[name] for k, (name, v) in enumerate(cases.items())
    }
    forward = jax.jit(jax.vmap(lambda c, d: jax.jvp(functools.partial(outputs, contact), (c,), (d,))[1]))
    reverse, _ = slopes(contact, cases)
    middle = solve(EIGHT, cases, contact)
    unit = np.column_stack([np.tile(middle.gear.max(1, keepdims=True), 3 * (EIGHT + 1)), np.abs(middle.windup)])
    ok = np.isfinite(middle.windup)
    assert ok.mean() > 0.9
    compared = 0
    for name in cases:
        step = {n: np.where(n == name, direction[n], 0.0) for n in cases}
        h = 1e-5
        ends = [solve(EIGHT, {n: cases[n] + sign * h * step[n] for n in cases}, contact) for sign in (-1, 1)]
        low, high = (np.column_stack([end.cam, end.cage, end.gear, end.windup]) for end in ends)
        difference = (high - low) / unit / (2 * h)
        along = reverse[name] * step[name].reshape(count, 1, *step[name].shape[1:])
        analytic = along.reshape(*unit.shape, -1).sum(axis=-1) / unit
        steady = ok & ((ends[0].cam > 0) == (ends[1].cam > 0)).all(1)
        size = np.maximum(np.abs(analytic).max(1, keepdims=True), 1e-2)
        assert (np.abs(analytic - difference) / size)[steady].max() < 1e-6, name
        compared += steady.sum()
        if thorough:
            ahead = np.asarray(forward(cases, step)) / unit
            np.testing.assert_allclose(analytic[ok], ahead[ok], rtol=1e-9, atol=1e-9 * np.abs(analytic[ok]).max())
    assert compared > 0.8 * len(cases) * count


@pytest.mark.parametrize("contact", ["hertz", pytest.param("palmgren", marks=pytest.mark.long)])
def test_derivatives_at_a_contact_change_are_one_sided(contact):
    """A roller set exactly to the point of touching: the derivative lies between those of the two sides."""
    teeth, roller = 8, 7
    cases = corr(1, errors_roller_radius=np.linspace(-2e-6, 2e-6, 9), teeth=teeth)
    place = geometry(teeth, cases)
    away = {n: v.copy() for n, v in cases.items()}
    away["errors.roller_radius"][0, roller] = -1e-4
    windup = solve(teeth, away, contact).windup[0]
    weight = 1 + abs(place["cage_ratio"][0, roller]) + place["gear_ratio"][0, roller]
    touch = -windup * place["arm"][0, roller] / weight

    h = 1e-12
    close = {n: np.repeat(v, 3, axis=0) for n, v in cases.items()}
    close["errors.roller_radius"][:, roller] = touch + h * np.array([0, -1, 1])
    read = [ROWS - 1, *range(teeth + 1)]  # wind-up and cam
    found, rows = slopes(contact, close, read)
    size = np.array([1e6, *[1.0] * (teeth + 1)])
    value, below, above = rows[:, read] * size
    slope = found["errors.roller_radius"][0, :, roller] * size
    sides = [(value - below) / h, (above - value) / h]
    assert np.isfinite(slope).all()
    size = np.abs(sides[1]).max()  # difference quotients: 12 digits over 1 pm
    assert (slope > np.minimum(*sides) - 1e-2 * size).all() and (slope < np.maximum(*sides) + 1e-2 * size).all()
    assert np.abs(sides[0]).max() < 1e-2 * size  # a roller without contact changes nothing


@pytest.mark.long
@pytest.mark.parametrize("contact", ["hertz", pytest.param("palmgren", marks=pytest.mark.long)])
def test_second_derivatives(contact):
    cases = corr(1, errors_roller_radius=np.linspace(-2e-6, 2e-6, 9), teeth=8)
    case = {n: jnp.asarray(v[0]) for n, v in cases.items()}

    def output(x):
        moved = {"eccentricity": 3.5e-3 * (1 + x[0]), "errors.cam_radius": 1e-6 * x[1]}
        result = cam_roller.single(8, contact, case | moved | {"torque": 100 * (1 + x[2]), "angle": 0.6 + x[3]})
        return result.windup * 1e3 + jnp.max(result.cam) / 1e3

    both = jax.jit(lambda x, along: jax.jvp(jax.grad(output), (x,), (along,)))
    x, h, axes = np.array([0.0, 0.5, 0.0, 0.0]), 1e-6, np.eye(4)
    hessian = np.stack([both(x, axis)[1] for axis in axes])
    ends = [[both(x + sign * h * axis, axis)[0] for axis in axes] for sign in (1, -1)]
    differences = np.subtract(*map(np.asarray, ends)) / (2 * h)
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-10 * np.abs(hessian).max())
    np.testing.assert_allclose(hessian, differences, atol=5e-5 * np.abs(hessian).max())


@pytest.mark.parametrize("contact", ["hertz", pytest.param("palmgren", marks=pytest.mark.long)])
def test_zero_errors_have_finite_derivatives_without_torque(contact):
    angles = np.where(np.arange(32) % 4 < 2, 0.0, 0.0013)
    cases = corr(32, torque=np.where(np.arange(32) % 2, 0.0, 100.0), angle=angles, teeth=8)

    weights = np.random.default_rng(9).normal(size=(32, ROWS))
    for slope in pull(contact, cases, weights)[0].values():
        assert np.isfinite(slope).all()


BAD = {
    "eccentricity": 0.05,  # undercut
    "poisson_ratio": 1.5,
    "cam_radius": -0.1,
    "young_modulus": 0.0,
    "torque": np.nan,
    "angle": np.inf,
    "errors.cam_radius": np.nan,
    "errors.roller_radius": np.inf,
    "roller_length": 1e-9,  # overloaded, where the law has a limit
}


@pytest.mark.parametrize("contact", ["hertz", pytest.param("palmgren", marks=pytest.mark.long)])
def test_gradients_next_to_bad_lanes(contact):
    """A sum over the good units: bad ones between them get no derivative and change none."""
    good = np.arange(2 * len(BAD)) % 2 == 1
    radii = np.random.default_rng(3).normal(size=(len(good), EIGHT + 1)) * 3e-6
    clean = corr(len(good), EIGHT, errors_roller_radius=radii)
    dirty = {name: v.copy() for name, v in clean.items()}
    for k, (name, value) in enumerate(BAD.items()):
        dirty[name][2 * k] = value
    weights = good[:, None] * np.random.default_rng(4).normal(size=(len(good), ROWS))
    (expected, _), (found, rows) = (pull(contact, cases, weights) for cases in (clean, dirty))
    assert np.isfinite(rows[good]).all() and np.isnan(rows[~good][:-1]).any(axis=1).all()
    for name, slope in found.items():
        assert np.isfinite(slope).all(), name
        np.testing.assert_array_equal(slope[good], expected[name][good])
