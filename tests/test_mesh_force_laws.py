"""The line contact: its power series against the exact law, and Hertz's pressure with the radii of both bodies."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.catalogue import CORR
from rvjax.mesh_force import MeshForces, contact_pressure, laws, tooth_profile
from rvjax.status import at_once


def rollers(rng, count):
    cage = 10 ** rng.uniform(-3, 1, count)
    return laws.Compliance(
        cage=cage,
        gear=np.sqrt(1 + cage**2),
        cam_radius=rng.uniform(0.5, 1, count),
        gear_radius=10 ** rng.uniform(-1, np.log10(5), count),
        palmgren=1.0,
    )


def test_the_approach_at_small_loads_needs_no_roots():
    """Oracle: the exact law. Left out are 0.018 NEAR^9 < 7e-17 of a sum; tolerance: 8 roundings of the sums' parts,
    of which the hollow ones (m > 1) take away at most as much as (m - 1) / m of what the others give, m <= 5."""
    rng = np.random.default_rng(6)
    roller = rollers(rng, 4000)
    load = laws.load_limit("hertz", roller) * 10 ** rng.uniform(-6, -0.5, 4000)
    hollow = laws.line_contact.hollow(roller.gear_radius)
    found = np.asarray(jax.jit(laws.approach_near)(load, roller, hollow))
    exact = np.asarray(jax.jit(laws.approach, static_argnums=0)("hertz", load, roller))
    near = load * np.asarray(laws.square(roller, hollow)) <= laws.line_contact.NEAR
    assert 0.5 < near.mean() < 0.99
    miss = np.abs(found - exact) / exact
    assert miss[near].max() < 8 * 5 * np.finfo(float).eps
    assert miss[~near].max() > 1e-12  # beyond, the verdict matters


def test_the_stiffness_of_the_series_is_as_good_as_it_says():
    """Oracle: the exact law, whose approach at a load needs no series; tolerance: 32 roundings beside the bound."""
    rng = np.random.default_rng(5)
    roller, count = rollers(rng, 4000), 4000
    load = laws.load_limit("hertz", roller) * 10 ** rng.uniform(-6, -1, count)
    small = 2 / roller.weight

    @jax.jit
    def both(load, roller, small):
        bends = laws.bends(small, roller, laws.line_contact.hollow(roller.gear_radius))
        _, ratio = laws.series(small * laws.approach("hertz", load, roller), *bends)
        return ratio, laws.slope("hertz", load, roller)

    ratio, slope = map(np.asarray, both(load, roller, small))
    bend, rate, exact = np.abs(ratio - 1), small * ratio, 1 / slope
    miss = np.abs(rate - exact) / exact
    assert (miss <= laws.series_error(bend) + 32 * np.finfo(float).eps).all()
    large = np.asarray(bend) > 1e-3  # where the bound is above rounding it is not idle either: within a factor 1000
    assert (miss[large] > laws.series_error(bend)[large] / 1000).mean() > 0.5


def test_the_pressure_at_the_gear_is_that_of_a_cylinder_in_the_hollow_of_the_profile():
    """Hertz: p^2 = F / (pi l rho C), 1 / rho = 1 / r - curvature of the flank, which the profile gives."""
    design, theta, gear = CORR, 0.0013, np.linspace(100.0, 900.0, CORR.gear_teeth + 1)
    none = jnp.zeros(CORR.gear_teeth + 1)
    forces = MeshForces(none, none, jnp.asarray(gear), jnp.zeros(()), at_once(jnp.zeros(())))
    found = contact_pressure(design, forces, output_angle=theta).gear
    lead = design.gear_teeth * theta - 2 * np.pi * np.arange(len(gear)) / len(gear)
    profile = jax.vmap(lambda angle: tooth_profile(design, angle))(jnp.asarray(lead / design.gear_teeth))
    radius = 1 / (1 / design.roller_radius - np.asarray(profile.flank_curvature))
    compliance = 2 * (1 - design.poisson_ratio**2) / design.young_modulus
    np.testing.assert_allclose(found, np.sqrt(gear / (np.pi * design.roller_length * radius * compliance)), rtol=1e-11)
