"""The solver of the loaded model on bodies and contacts that are no RV reducer, built by hand.

A shaft with an eccentric for each disc, ring pins outside, output pins in holes of the discs: joints that touch discs
and a common body, a border without links. Oracles: SciPy on the same energy, written here in NumPy, and rounded
figures of an independent program for linear contacts.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from rvjax._jax.sizes import Size
from rvjax.loaded import newton
from rvjax.loaded.balance import balance, compliance, forces, with_implicit_derivative
from rvjax.loaded.interior import STEPS, approach
from rvjax.loaded.system import Bearings, Group, Joints, Layout, Pins, System
from rvjax.units import arcmin, mm, um

TEETH, HOLES = 17, 6
CIRCLE, THROW, ARM = 42.5 * mm, 1.3 * mm, 32.9 * mm  # ring pins, eccentric, output pins
LEVEL = 40.0  # A of the hertz contact law
SPRINGS = {"linear": (40e6, 60e6), "hertz": (2e-9, 1.4e-9)}  # ring pins and holes: N/m, or m/N
BEARING = 30e6


def unit(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def layout_of(discs, pins, holes, floating):
    """Laws of pins and holes; `floating`: the carrier's centre and the shaft move, else the eccentrics are fixed."""
    joints = Group(discs=True, links=False, common=True, each=HOLES, law=holes)
    eccentrics = Group(discs=True, links=False, common=floating)
    supports = [Group(discs=False, links=False, common=True)] if floating else []
    layout = Layout(discs, TEETH + 1, pins, 0, (3, 2) if floating else (1,), (joints,), (eccentrics, *supports))
    return layout._replace(interior=False)  # which has its own test


def system_of(layout, torque, angle=0.1, flank=0.0, hole=0.0, play=0.0, spread=None):
    """Equal clearances: of the flank, radial of the holes and of the bearings; `spread` moves every gap."""
    discs, n, c = layout.discs, layout.unknowns, layout.carried
    spread = np.random.default_rng(0 if spread is None else spread).normal(size=400) * 2 * um * (spread is not None)
    th = -angle / TEETH
    eccentric = -(TEETH + 1) * th + 2 * np.pi * np.arange(discs) / discs
    pin, k1 = 2 * np.pi * np.arange(TEETH + 1) / (TEETH + 1) - th, THROW * (TEETH + 1) / CIRCLE
    psi = pin[None] - eccentric[:, None]
    size = np.sqrt(1 + k1**2 - 2 * k1 * np.cos(psi))
    normal = (k1 * unit(eccentric)[:, None] - unit(pin)[None]) / size[..., None]
    lever = THROW * TEETH * np.sin(psi) / size
    push = np.sin(eccentric[:, None] - 2 * np.pi * np.arange(HOLES) / HOLES)  # (discs, holes)
    joints, bearings = np.zeros((discs, HOLES, n)), np.zeros((discs + 1, 2, n))
    for k in range(discs):
        joints[k, :, 3 * k : 3 * k + 2], joints[k, :, 3 * k + 2] = unit(eccentric[k]), push[k]
        joints[k, :, c] = -push[k]
        bearings[k, :, 3 * k : 3 * k + 2] = np.eye(2)
        if len(layout.common) > 1:
            joints[k, :, c + 1 : c + 3] = -unit(eccentric[k])
            bearings[k, :, c + 3 :] = -np.eye(2)
    bearings[-1, :, n - 2 :] = np.eye(2)
    supports = len(layout.common) > 1
    count = discs + supports
    centring = 1e-8 * BEARING
    support = np.zeros(n)
    if supports:
        support[c + 1 : c + 3] += 5e8  # of the floating carrier
    of_pins, of_holes = SPRINGS[layout.law][0], SPRINGS[layout.joints[0].law][1]
    jitter = iter(np.split(spread, [100, 200]))
    return System(
        pins=Pins(
            rows=np.stack([-normal[..., 0], -normal[..., 1], lever / ARM]),
            gap=-flank + next(jitter)[: discs * (TEETH + 1)].reshape(discs, -1),
            compliance=np.full(1, of_pins),
            level=np.full((discs, TEETH + 1), LEVEL) if layout.law == "hertz" else None,
        ),
        joints=Joints(
            rows=joints.reshape(-1, n),
            gap=-hole + next(jitter)[: discs * HOLES],
            compliance=np.full(discs * HOLES, of_holes),
            level=np.full(discs * HOLES, LEVEL) if layout.joints[0].law == "hertz" else None,
            lever=-push.ravel(),
        ),
        bearings=Bearings(
            rows=bearings[:count],
            gap=next(jitter)[: 2 * count].reshape(count, 2),
            stiffness=np.array([BEARING] * discs + [2e8])[:count],
            clearance=np.full(count, float(play)),
        ),
        centring=np.float64(centring),
        support=support,
        load=np.float64(torque / ARM),
    )


@functools.partial(jax.jit, static_argnums=0)
def solved(layout, system):
    """Displacements with derivatives, forces, how they were found, and the rotation per torque."""
    found = balance(layout, system, jnp.full(layout.unknowns, jnp.nan))
    q = with_implicit_derivative(layout, system, found.q)
    first = jnp.eye(layout.unknowns)[layout.carried]
    return q, forces(layout, system, q), found, compliance(layout, system, q, first)[layout.carried]


def hertz_force(depth, c):
    """F of d = c F (A - ln F), by bisection of ln F."""
    low, high = np.full(depth.shape, -80.0), np.full(depth.shape, LEVEL - 1)
    for _ in range(80):
        middle = (low + high) / 2
        below = c * np.exp(middle) * (LEVEL - middle) < depth
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.where(depth > 0, np.exp((low + high) / 2), 0)


def law(name, depth, k):
    """Force and energy of some contacts."""
    if name == "linear":
        return k * np.maximum(depth, 0), k * np.maximum(depth, 0) ** 2 / 2
    force = hertz_force(depth, k)
    return force, np.where(depth > 0, force * (2 * depth - k * force) / 4, 0)


def energy_and_slope(layout, s, q):
    """Both of a whole system, from its rows."""
    discs = q[: 3 * layout.discs].reshape(-1, 3)
    pins, of_pins = law(layout.law, s.pins.gap + np.einsum("akp,ka->kp", s.pins.rows, discs), s.pins.compliance[0])
    holes, of_holes = law(layout.joints[0].law, s.joints.gap + s.joints.rows @ q, s.joints.compliance[0])
    w = s.bearings.gap + s.bearings.rows @ q
    length = np.linalg.norm(w, axis=1)
    over = np.maximum(length - s.bearings.clearance, 0)
    pull = (s.bearings.stiffness * over / np.where(length > 0, length, 1))[:, None] * w
    held = s.support + s.centring
    energy = of_pins.sum() + of_holes.sum() + (s.bearings.stiffness * over**2).sum() / 2 + held @ q**2 / 2
    slope = held * q + s.joints.rows.T @ holes + np.einsum("bxn,bx->n", s.bearings.rows, pull)
    slope[: 3 * layout.discs] += np.einsum("akp,kp->ka", s.pins.rows, pins).ravel()
    slope[layout.carried] += s.load
    return energy + s.load * q[layout.carried], slope


def minimum(layout, s, start=None):
    """By BFGS in micrometres, then a root of the slope; with a start near it, by the root alone."""

    def scaled(x):
        energy, slope = energy_and_slope(layout, s, x * um)
        return energy / um, slope

    if start is None:
        x = np.zeros(layout.unknowns)
        start = scipy.optimize.minimize(scaled, x, jac=True, method="BFGS", options={"gtol": 1e-6}).x * um
    found = scipy.optimize.root(lambda x: scaled(x)[1], start / um, tol=1e-14, options={"maxfev": 4000})
    assert np.max(np.abs(found.fun)) < 1e-7
    return found.x * um


LAYOUTS = {
    "one disc, a carrier": layout_of(1, "linear", "hertz", False),
    "two discs, all floating": layout_of(2, "hertz", "hertz", True),
}
CASES = [  # torque, angle, clearances of flank, holes and bearings
    (-5.85, 0.1, 0.0, 0.0, 0.0),
    (5.85, 40.3, 0.0, 0.0, 0.0),
    (-5.85, 11.0, 8 * um, 6 * um, 3 * um),
    (1.0, 2.0, 8 * um, 0.0, 3 * um),
    (-0.3, 5.0, -4 * um, -5 * um, 0.0),
]


@functools.cache
def cases_of(layout):
    """Systems, their batch and their minima by SciPy."""
    cases = [system_of(layout, *case, seed) for seed, case in enumerate(CASES)]
    return cases, jax.tree.map(lambda *x: np.stack(x), *cases), [minimum(layout, case) for case in cases]


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_the_minimum_is_that_of_scipy(layout):
    """Both signs of the torque, with clearance and with preload. 1e-8 of the displacements: the root leaves 1e-7 N of
    some 100 N. The secant of the compliance is that of a small step, because contacts close on the way: 1e-3."""
    cases, batch, minima = cases_of(layout)
    q, _, how, softness = jax.vmap(functools.partial(solved, layout))(batch)
    assert np.all(how.converged)
    for number, (case, due) in enumerate(zip(cases, minima)):
        np.testing.assert_allclose(q[number], due, rtol=0, atol=1e-8 * np.max(np.abs(due)))
        energy = [energy_and_slope(layout, case, np.asarray(x))[0] for x in (q[number], due)]
        assert energy[0] <= energy[1] + 1e-15
        step = 1e-4 * case.load
        more, less = (minimum(layout, case._replace(load=case.load + sign * step), due) for sign in (1, -1))
        np.testing.assert_allclose(softness[number], -(more - less)[layout.carried] / (2 * step), rtol=1e-3)


def test_the_interior_point_method_ends_near_the_minimum():
    """Products of gaps and forces are 1e-11 of the first ones. A contact that barely touches is off by the root of it,
    3e-6 of the first gap; with a margin of three."""
    layout = LAYOUTS["two discs, all floating"]
    _, batch, minima = cases_of(layout)
    last = jax.tree.map(lambda leaf: np.moveaxis(leaf, 0, -1), batch)
    q, steps = approach(layout, last, jnp.ones(len(minima), bool))
    assert np.all(steps < STEPS)
    for found, due in zip(q.T, minima):
        np.testing.assert_allclose(found, due, rtol=0, atol=1e-5 * np.max(np.abs(due)))


ONE = layout_of(1, "linear", "linear", False)
B = dict(torque=-5.85, due=(1.862193, 1.580241), pin=(58.2535, 11), hole=(111.2679, 2), bearing=(18.3559, 264.7059))
C = dict(torque=-5.85, due=(8.458174, 4.651961), pin=(95.6662, 5), hole=(194.5384, 1), bearing=(72.4065, 264.7058))
FORWARD = dict(
    torque=5.85, due=(-1.861251, -1.578970), pin=(58.4955, 10), hole=(111.2773, 2), bearing=(18.4376, -264.7059)
)


@pytest.mark.parametrize(
    ("clearance", "case"),
    [({}, B), ({}, FORWARD), (dict(flank=10 * um, hole=25 * um, play=10 * um), C)],
    ids=["tight", "forward", "loose"],
)
def test_a_drive_of_seventeen_lobes(clearance, case):
    """Rotation of carrier and disc in arcmin, largest forces and how many contacts carry: printed with six figures."""
    q, found, how, _ = jax.tree.map(np.asarray, solved(ONE, system_of(ONE, case["torque"], **clearance)))
    assert how.converged
    assert abs(float(how.largest) - max(case["pin"][0], case["hole"][0])) < 1e-4
    np.testing.assert_allclose(q[[3, 2]] / ARM / arcmin, case["due"], rtol=0, atol=2e-6)
    for force, (largest, many) in ((found.pins, case["pin"]), (found.joints, case["hole"])):
        assert (abs(float(np.max(force)) - largest) < 1e-4, int(np.sum(force > 1e-6))) == (True, many)
    along = unit(0.1 * (TEETH + 1) / TEETH)
    pull = -np.asarray(found.bearings[0])
    np.testing.assert_allclose([pull @ along, along[0] * pull[1] - along[1] * pull[0]], case["bearing"], atol=1e-4)


def test_the_minimum_has_the_slope_of_the_law_of_a_hole():
    """d q / d compliance of all holes, against differences of SciPy's minimum."""
    layout = LAYOUTS["one disc, a carrier"]
    case = system_of(layout, -5.85, spread=3)

    def turned(share):
        joints = case.joints._replace(compliance=share * case.joints.compliance)
        return solved(layout, case._replace(joints=joints))[0][layout.carried]

    near = minimum(layout, case)

    def plain(share):
        joints = case.joints._replace(compliance=share * case.joints.compliance)
        return minimum(layout, case._replace(joints=joints), near)[layout.carried]

    slope = jax.jit(jax.jacfwd(turned))(1.0)  # without the compliance
    np.testing.assert_allclose(slope, (plain(1 + 1e-4) - plain(1 - 1e-4)) / 2e-4, rtol=1e-4)


def test_the_last_cases_of_a_wide_block_go_on_in_a_narrow_one(monkeypatch):
    """One block of all 100 cases, as on a GPU, and one of them that is not solved: the others as each alone, in as many
    steps; a second loop has a sixteenth of the lanes. Some of the last are left by Newton's method, here after nine
    steps, and go on by the interior point method in a second round."""
    layout, many = ONE, 100
    draw = np.random.default_rng(0)
    torques, angles = 5 * draw.uniform(0.01, 1, many) * draw.choice([-1, 1], many), draw.uniform(0, 100, many)
    cases = [system_of(layout, *case, 8 * um, 6 * um, 3 * um, seed) for seed, case in enumerate(zip(torques, angles))]
    s, start = jax.tree.map(lambda *x: np.stack(x), *cases), np.full((many, layout.unknowns), np.nan)
    start[0] = np.inf
    alone = [solved(layout, case)[2] for case in cases[1:]]
    monkeypatch.setattr(newton, "EQUILIBRIA", Size(1000, 1000))
    monkeypatch.setattr(newton, "_WIDE", many - 1)
    monkeypatch.setattr(newton, "DIRECT", 9)
    whole = layout._replace(interior=True)
    lowered = jax.jit(lambda *given: newton.minimise(whole, *given)).lower(s, start)
    text = lowered.as_text()
    assert all(f"tensor<{layout.unknowns}x{lanes}xf64>" in text for lanes in (many, many // 16))
    found = jax.device_get(lowered.compile()(s, start))
    assert not found.converged[0]
    found, due = jax.tree.map(lambda x: x[1:], found), jax.tree.map(lambda *x: np.stack(x), *alone)
    assert np.all(due.converged) and np.all(found.converged)
    largest = np.max(np.abs(due.q), axis=1, keepdims=True)
    np.testing.assert_allclose(found.q / largest, due.q / largest, rtol=0, atol=1e-8)
    by_newton = found.steps <= 9
    assert np.max(due.steps) > 2 * np.median(due.steps) and 1 <= np.sum(~by_newton) <= many // 16  # of the last ones
    assert np.mean(found.steps != due.steps) < 0.15  # the last ones forget how long they stalled
    np.testing.assert_allclose(np.mean(found.steps[by_newton]), np.mean(due.steps[by_newton]), rtol=0.1)
