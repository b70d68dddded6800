"""Errors as excitation against a march in time, and at standstill against the loaded reducer.

Oracles: `tests.oracles.dynamic_error`, every spring with turning rows, no orders, no means, no symmetry;
`rvjax.loaded`, another model with every pin. Teeth are few, so that a period is short.
"""

import jax
import numpy as np
import pytest
from loaded_cases import errors_of, solve

from rvjax import Contact, Damping, MeshVariation, RVErrors, dynamics
from rvjax.catalogue import RV_320E
from tests.oracles.dynamic_error import Marched

SHOWN = ("output.rotation", "sun.rotation")


def small(cranks, discs):
    """Four pins, a sun of four and planets of eight teeth: the meshes of the sun have 32 periods in a turn."""
    return RV_320E.replace(
        involute=RV_320E.involute.replace(sun_teeth=4, planet_teeth=8),
        cycloid=RV_320E.cycloid.replace(
            disc_teeth=3, pin_count=4, disc_count=discs, eccentricity=0.02, pin_circle_radius=0.114, disc_phase=0.4
        ),
        cranks=RV_320E.cranks.replace(count=cranks),
        mesh_variation=MeshVariation(0.4, 0.5, 0.5, 0.2, 0.5, 0.5),
        damping=Damping(rayleigh_mass=150.0),
    )


def by_order(found):
    return dict(zip(np.round(np.asarray(found.order)).astype(int).tolist(), np.asarray(found.amplitude)))


def marched(design, errors, speed, quarters, steps, **mesh):
    lines = Marched(design, errors, **mesh).lines(speed / design.ratio, quarters * np.pi / 2, steps)
    return {round(order): values for order, values in lines.items()}


@pytest.mark.long  # the reference has every error
def test_every_error_acts_through_its_mean_over_the_members():
    """All fields at once, two cranks and three discs: nothing but the orders told, and those as told.

    The march is of order 4: from 640 to 1280 steps its own difference falls to a sixteenth; 640 leave 2e-4 at order 32.
    """
    draw = np.random.default_rng(11).normal
    shapes = dict(
        sun_runout=(2,), planet_runout=(2, 2), sun_flank=(4, 2), planet_flank=(2, 2, 2), crank_eccentricity=(3, 2),
        crank_phase=(2,), carrier_bore=(2, 2), disc_bore=(3, 2, 2), disc_centre=(3, 2), disc_flank=(3, 2, 2),
        ring_centre=(2,), ring_flank=(4, 2),
    )  # fmt: skip
    errors = {name: 1e-5 * draw(size=shape) for name, shape in shapes.items()}
    design, speed = small(2, 3), 400.0
    due = marched(design, errors, speed, 4, 640)
    found = by_order(dynamics.transmission_error(design, RVErrors(**errors), sun_speed=speed, outputs=SHOWN))
    size = np.max([np.abs(line) for line in due.values()], axis=0)
    assert set(found) == {4, 8, 9, 16, 32}
    for order, line in due.items():
        allowed = 1e-3 if order in found else 1e-8
        assert (np.abs(found.get(order, 0) - line) <= allowed * size).all(), order


def sidebands(alone):
    """Lines of an eccentric sun, alone or with all sun-planet errors under load, marched and balanced."""
    design, speed, harmonics = small(3, 3), -700.0, 6
    draw = np.random.default_rng(12).normal
    runout = 1e-5 * draw(size=2)
    others = dict(planet_runout=1e-5 * draw(size=(3, 2)), sun_flank=1e-5 * draw(size=(4, 2)))
    if alone:
        others = {name: np.zeros_like(value) for name, value in others.items()}
    mesh = dict(stage="planetary", harmonics=2 * harmonics)
    errors, torque = others | {"sun_runout": runout}, 0.0 if alone else -1000.0
    due = marched(design, errors, speed, 1, 300, output_torque=torque, **mesh)
    found = dynamics.transmission_error(
        *(design, RVErrors(**errors)),
        sun_speed=speed,
        outputs=SHOWN,
        method="harmonic_balance",
        harmonics=harmonics,
        output_torque=torque,
    )
    return due, by_order(found)


@pytest.mark.long
def test_a_later_planet_meets_the_tooth_later():
    """The eccentric sun, order 8, reaches the output at 32 - 8 and 64 + 8, never at their mirror images.

    It lies in label 1 of the planets, the variation of order 32 l in -4 l mod 3: with phases of the other sign the
    mirror images would appear.
    """
    due, found = sidebands(alone=True)
    largest = max(np.abs(due[order][0]) for order in due)
    for order in (24, 72):
        assert np.abs(due[order][0]) > 1e-3 * largest
        np.testing.assert_allclose(found[order], due[order], rtol=1e-2, atol=0)
    for order in (8, 40, 56):
        assert np.abs(due[order][0]) < 1e-9 * largest and np.abs(found[order][0]) < 1e-9 * largest


def test_errors_and_mesh_together_are_those_of_a_march():
    """Kept harmonics reach to order 192: what the march sees beyond, and its steps, leave 1e-5 below order 60."""
    due, found = sidebands(alone=False)
    size = np.max([np.abs(line) for line in due.values()], axis=0)
    for order in range(4, 60, 4):
        assert (np.abs(found.get(order, 0) - due[order]) <= 5e-5 * size).all(), order
    assert np.abs(due[36] - due[28])[0] > 1e-3 * size[0]  # the mirror images differ by more than that


@pytest.mark.long  # references of their own hold both models
def test_standstill_is_that_of_the_loaded_reducer():
    """Linear pins under load, forwards: every error that both models know, one at a time, constant part included.

    Runouts, seats and phases of cranks move parts rigidly: equal to the square of the errors over the wind-up,
    1e-7 / 3e-4. What shifts a disc against its pins also loads the bearings, whose yield one spring for all pins does
    not see: equal to the stiffness of the pins over that of the bearings, 8e-3. Its direction is that of soft pins,
    tan be = <nx ny> / <ny^2>. Errors of single pins: harmonics up to 16 of a series that falls with their square.
    """
    nodes, weights = np.polynomial.legendre.leggauss(400)
    chi, k1 = np.pi * (1.5 + nodes / 2), 0.0022 * 40 / 0.114
    square = 1 + k1 * k1 - 2 * k1 * np.cos(chi)
    slope = np.sum(weights * (k1 - np.cos(chi)) * -np.sin(chi) / square) / np.sum(weights * np.sin(chi) ** 2 / square)
    design = RV_320E.replace(
        cranks=RV_320E.cranks.replace(count=2),
        cycloid=RV_320E.cycloid.replace(
            disc_count=2, pin_circle_radius=0.114, force_angle=float(np.arctan(slope)), disc_phase=np.pi
        ),
        stiffness=RV_320E.stiffness.replace(turning_arm_bearing=1e11, support_bearing=1e11, disc_pin_mesh=8e8),
        contact=Contact(2.06e11, 0.3, 0.02),
    )
    bare = design.replace(  # the program of the tests of the loaded reducer
        inertia=None, mesh_variation=None, damping=None, cranks=design.cranks.replace(bearing_stiffness=None)
    )
    draw = np.random.default_rng(3).normal
    shapes = dict(
        crank_eccentricity=(2, 2), crank_phase=(2,), carrier_bore=(2, 2), disc_bore=(2, 2, 2), pin_offset=(40, 2),
        pin_radii=(40,), ring_centre=(2,), disc_centre=(2, 2), sun_runout=(2,), planet_runout=(2, 2),
    )  # fmt: skip
    kinematic, pins = ("crank_phase", "carrier_bore", "planet_runout"), ("pin_offset", "pin_radii")
    errors = {name: 1e-7 * (1e3 if name == "crank_phase" else 1) * draw(size=shape) for name, shape in shapes.items()}
    names = list(errors)
    units = {name: np.stack([value * (name == only) for only in ["", *names]]) for name, value in errors.items()}
    angles = 0.3 + np.array([0.0, 0.03, 0.11])

    @jax.jit
    @jax.vmap
    def excited(unit):
        g = dynamics.error_excitation(design, RVErrors(**unit), pin_harmonics=16)
        t = dynamics.error_transfer(design, frequency=0.0)[0]
        return g.order, g.amplitude @ t, g.mean @ t.real

    error = np.empty((len(names) + 1, len(angles)))
    for place in np.ndindex(*error.shape):
        unit = errors_of({"errors": {name: value[place[0]] for name, value in units.items()}}, design)
        found = solve(bare, unit, angles[place[1]] * design.ratio, 3000.0, contact="linear")
        assert found.info.status == 0
        error[place] = found.error
    order, lines, constant = (np.asarray(x)[1:] for x in excited(units))
    found = (np.exp(1j * angles[:, None] * order[:, None]) @ lines[:, :, None])[:, :, 0].real + constant[:, None]
    error = error[1:] - error[:1]
    for name, due, ours in zip(names, error, found):
        size = np.abs(due).max()
        if name in ("sun_runout", "ring_centre"):
            assert size < 1e-15 and (ours == 0).all()
            continue
        allowed = 1e-3 if name in kinematic else 0.1 if name in pins else 1e-2
        assert size > 1e-9 and np.abs(ours - due).max() < allowed * size, name
