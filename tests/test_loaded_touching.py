"""Where the equilibrium of a drive starts, how far a step goes, and how many points that takes.

Oracle: properties of the start and of the shortened step, from the contacts at them; the equilibrium itself is checked
elsewhere.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import study
from rvjax.loaded import laws
from rvjax.loaded.equilibrium import admit, check_input, prepare
from rvjax.loaded.line_search import shortened, touching
from rvjax.loaded.newton import minimise, take
from rvjax.loaded.observation import ways
from rvjax.loaded.system import contacts, depths, displaced, held
from rvjax.population import Population, root_key
from rvjax.response import numbers_of

UNITS, ANGLES = 32, 12
DRIVE = study.load("cycloidal-17", solve=False)
POPULATION = Population.of(DRIVE.tolerances)
NUMBERS = numbers_of(POPULATION, root_key(0), np.arange(UNITS))
LAYOUT = check_input(DRIVE.design, POPULATION.errors(NUMBERS[:, 0]), *ways(DRIVE.conditions).values())
LAYOUT = LAYOUT._replace(interior=False)  # which no case here needs


@jax.jit
def systems(torque):
    """Units at angles of a turn of the shaft, cases first."""

    def one(z, angle):
        read = admit(LAYOUT, DRIVE.design, POPULATION.errors(z), torque, angle)
        return prepare(LAYOUT, read, read.angle).loaded(read.torque).system

    turn = jnp.asarray(2 * np.pi * np.arange(ANGLES) / ANGLES)
    every = jax.vmap(jax.vmap(one, (None, 0)), (-1, None))(NUMBERS, turn)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), every)


def batch(torque):
    """The same, batch axis last."""
    return jax.tree.map(np.asarray, take(systems(torque), jnp.arange(UNITS * ANGLES)))


@jax.jit
def started(s):
    """Depths of pins and of holes where every disc starts, there and under the load of a disc; forces of bearings."""
    q = touching(LAYOUT, s)
    carried, (holes, w) = jnp.abs(s.load) / LAYOUT.discs, displaced(s, q)
    contact = (
        (depths(LAYOUT, s, q), LAYOUT.law, s.pins.compliance[None], s.pins.level),
        (holes, "hertz", s.joints.compliance, s.joints.level),
    )
    load = lambda depth: jnp.broadcast_to(carried, depth.shape)  # noqa: E731
    return [(depth, laws.depth(law, load(depth), *given)) for depth, law, *given in contact], held(w, s.bearings).force


@pytest.mark.parametrize("share", [1.0, -1.0, 0.03])
def test_every_disc_starts_where_its_first_pin_touches(share):
    s = batch(share * DRIVE.conditions.rated_torque)
    (of_pins, of_holes), pressed = jax.tree.map(np.asarray, started(s))
    sign = np.sign(s.load)

    def missing(depth, deep, lever):
        """Rotation up to the depth of the load of a disc; where a contact carries no such load -inf."""
        with np.errstate(divide="ignore"):
            return np.where(lever * sign < 0, (depth - deep) / np.abs(lever), -np.inf)

    pins = missing(*of_pins, s.pins.rows[2])
    np.testing.assert_allclose(pins.max(1), 0, atol=1e-15)
    holes = missing(*of_holes, s.joints.rows[:, LAYOUT.carried])
    np.testing.assert_allclose(holes.max(0), 0, atol=1e-15)
    # The bearings are pressed, and with the force of the other two contacts in balance.
    assert (np.linalg.norm(pressed, axis=1) > 0).all()
    pin, (x, y) = pins.argmax(1), np.moveaxis(pressed, 1, 0)
    normal = np.take_along_axis(np.asarray(s.pins.rows), pin[None, :, None], 2)[:2, :, 0]
    assert (x * normal[0] + y * normal[1] < 0).mean() > 0.95  # the pin pushes the disc onto its bearing


@jax.jit
def stepped(s, step):
    """Shares of a step from the start, how much deeper than its load presses each contact is then, and a tiny step."""
    q = touching(LAYOUT, s)
    at = contacts(LAYOUT, s, q)
    forces = at.pins.force.max((0, 1)), at.joints.force.max(0), jnp.abs(at.bearings.force).max((0, 1))
    size = functools.reduce(jnp.maximum, forces)
    short = shortened(LAYOUT, s, q, at, size, step)
    force = jnp.maximum(size, jnp.abs(s.load))
    (_, start), (holes, w) = displaced(s, q), displaced(s, q + short)
    excess = []
    for depth, before, law, compliance, level in (
        (depths(LAYOUT, s, q + short), at.pins.depth, LAYOUT.law, s.pins.compliance[None], s.pins.level),
        (holes, at.joints.depth, "hertz", s.joints.compliance, s.joints.level),
    ):
        deep = jnp.maximum(laws.depth(law, jnp.broadcast_to(force, depth.shape), compliance, level), 2 * before)
        excess.append(((depth - deep) / deep).reshape(-1, force.size))
    own = s.bearings.clearance + jnp.broadcast_to(force, (len(w), force.size)) / s.bearings.stiffness
    reach = jnp.maximum(own, 2 * jnp.linalg.norm(start, axis=1))
    excess.append(jnp.linalg.norm(w, axis=1) / reach - 1)
    return short / step, jnp.concatenate(excess), shortened(LAYOUT, s, q, at, size, 1e-9 * step)


def test_no_contact_is_deeper_after_a_step_than_its_load_presses():
    s = batch(DRIVE.conditions.rated_torque)
    step = 1e-3 * np.random.default_rng(1).standard_normal((LAYOUT.unknowns, UNITS * ANGLES))
    share, excess, tiny = jax.device_get(stepped(s, step))
    np.testing.assert_allclose(share, np.broadcast_to(share[0], share.shape), rtol=1e-12)
    assert (share > 0).all() and (share < 1).all()
    np.testing.assert_allclose(np.max(excess, axis=0), 0, atol=1e-9)  # exactly one ends the step
    np.testing.assert_array_equal(tiny, 1e-9 * step)


@pytest.mark.parametrize(("share", "mean", "nearly_all"), [(1.0, 8.0, 17), (0.03, 18.0, 35)])
def test_points_of_an_equilibrium(share, mean, nearly_all):
    """With a linear start and whole steps: 8.7 and 24.7 on average, 95 % within 18 and 45."""
    start = np.full((UNITS * ANGLES, LAYOUT.unknowns), np.nan)
    found = solved(systems(share * DRIVE.conditions.rated_torque), start)
    assert found.converged.all()
    assert np.mean(found.steps) < mean
    assert np.quantile(found.steps, 0.95) < nearly_all


@jax.jit
def solved(s, start):
    return minimise(LAYOUT, s, start)
