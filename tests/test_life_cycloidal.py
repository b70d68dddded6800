"""Lives of the eccentric bearings of a single-stage drive: reference case, both members, torque for a life."""

import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cycloidal_cases import CASES, design_of, dictionaries, errors_of
from loaded_cases import newton_alone

import rvjax
from rvjax import Bearings, CycloidalErrors, RollerBearing, RVErrors, Status, catalogue, life, models
from rvjax.loaded import BearingForces
from rvjax.status import SolveInfo
from rvjax.units import rpm
from tests.oracles import cycloidal as oracle

(CASE,) = (case for case in CASES if case["kind"] == "rating")
ARM = RollerBearing(**CASE["design"]["bearings"]["arm"])
DRIVE = design_of(CASE["design"]).replace(bearings=Bearings(arm=ARM))
ERRORS, DUTY, PLAN = errors_of(CASE["errors"]), life.Duty(**CASE["duty"]), CASE["options"]
RING = DRIVE.replace(member="ring")
RATING, TOLD = sys.modules["rvjax.life.rating"], 11  # angles: programs that no other test has


@functools.cache
def turn_of(design, torque):
    """Forces of the discs' bearings over a crank turn by the independent model, without errors: every turn is alike."""
    angles = design.ratio * 2 * np.pi / 30 * np.arange(TOLD) / TOLD
    options = dict(output_torque=torque, contact="linear")
    turn = [oracle.equilibrium(dictionaries(design), {}, input_angle=angle, **options) for angle in angles]
    return np.stack([each["disc_bearing"] for each in turn])


def told_by_oracle(design, torque):
    """These forces in the place of equilibria, in the frame of `loaded.equilibrium`, see test_cycloidal_loaded.py."""

    def forces(layout, read, torques, angles, *, near):
        turns = angles / (design.ratio * 2 * np.pi / 30) - np.arange(TOLD) / TOLD
        there = (jnp.abs(turns - jnp.round(turns)) < 1e-9)[:, None, None, None, None]
        arm = jnp.where(there, turn_of(design, torque)[:, None], jnp.nan)
        info = SolveInfo(*(jnp.full((TOLD, 1), value) for value in (jnp.int32(0), jnp.int32(1), 0.0)))
        return BearingForces(arm, 0 * arm[:, :, 0], info, None)

    return forces


def rate(design, duty, **changes):
    return rvjax.check(life.rating(design, CycloidalErrors(), duty, **(PLAN | dict(contact="linear") | changes)))


def test_a_drive_agrees_with_the_independent_one():
    with newton_alone():
        found, expect = life.rating(DRIVE, ERRORS, DUTY, **PLAN), dict(CASE["expect"])
    assert Status(int(found.info.status)).name == expect.pop("status")
    assert found.support is None and found.support_load is None
    assert np.shape(found.arm) == np.shape(found.arm_load) == (2, 1)
    for field, value in expect.items():
        np.testing.assert_allclose(getattr(found, field), value, rtol=1e-7, err_msg=field)
    share = np.sum((found.life / found.arm) ** 1.125)
    assert float(share) == pytest.approx(1, rel=1e-12)  # Eq. 24, over the discs
    crank = np.abs(DUTY.output_speed) @ DUTY.time / np.sum(DUTY.time) * 29 * (1 + 1 / 29) / (2 * np.pi)
    due = 1e6 * (34500 / np.asarray(found.arm_load)) ** (10 / 3) / crank  # the disc turns against the shaft
    np.testing.assert_allclose(found.arm, due, rtol=1e-12)


@functools.cache
def by_member(member):
    """Points of both rings, without errors, at equal torque and speed of the carrier against the ring; forces told."""
    share = 30 / 29 if member == "ring" else 1.0
    duty = life.Duty([-116.0 * share], [20 * rpm], [1.0])
    design, duty = (RING, duty) if member == "ring" else (DRIVE, duty.replace(output_torque=np.array([116.0])))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RATING, "bearing_forces", told_by_oracle(design, float(duty.output_torque[0])))
        return rate(design, duty, method="raceway", samples=TOLD)


def test_both_members_have_the_same_lives():
    """The inner ring turns against the disc in the sense of the output, or the other one.

    Equilibria of both members in test_cycloidal_loaded.py and, under a raceway, in the long profile below."""
    one, other = by_member("carrier"), by_member("ring")
    assert 1e6 < float(one.life) < 1e9
    for field in ("life", "arm", "arm_load", "static_safety"):
        np.testing.assert_allclose(getattr(other, field), getattr(one, field), rtol=1e-7, err_msg=field)


def test_without_errors_the_force_stands_in_the_inner_ring():
    """Its points are loaded all the time, those of the disc in turn: a load that stands in one ring, by Eq. 10."""
    one = by_member("carrier")
    size = np.full((48, 1), 1000.0)
    angle = -2 * np.pi * np.arange(48) / 48
    turning = size * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    standing = life.bearing_life(ARM, turning, angle=angle, method="raceway").load / 1000
    against = life.bearing_life(ARM, turning, angle=-angle, method="raceway").load / 1000
    size = np.linalg.norm(turn_of(DRIVE, 116.0), axis=-1)
    ratio = np.asarray(one.arm_load) / np.mean(size ** (10 / 3), axis=0) ** 0.3  # Eq. 21
    assert standing > against + 0.01
    np.testing.assert_allclose(ratio, standing, atol=0.2 * float(standing - against))


def test_outputs_of_a_study_are_those_of_the_rating(monkeypatch):
    monkeypatch.setattr(RATING, "bearing_forces", told_by_oracle(DRIVE, 116.0))
    kind = models.kind(DRIVE)
    how = dict(life_samples=TOLD, pin_contact="linear", life_method="raceway", duty=((116.0, 20 * rpm, 1.0),))
    given, found = kind.conditions(**how), by_member("carrier")
    due = {"life": found.life, "arm_bearing_life": found.arm[0, 0], "static_safety": found.static_safety}
    for name, value in due.items():
        assert float(kind.outputs[name].evaluate(DRIVE, CycloidalErrors(), given)[0]) == pytest.approx(float(value))
    assert "eccentric bearing" in kind.outputs["arm_bearing_life"].meaning


def test_the_force_of_a_ring_as_output_turns_with_the_shaft():
    """Seen from the carrier the shaft turns zp times with the ring, as often against the output that is a carrier."""
    orders = jax.jit(newton_alone()(functools.partial(life.force_orders, samples=240, contact="linear")))
    found = orders(RING, CycloidalErrors(), output_torque=-116.0)
    size = np.abs(np.asarray(found.amplitude)[0, 0])
    assert found.info.status == 0
    assert found.order[int(np.argmax(size))] == life.crank_order(RING) == 30 == -life.crank_order(DRIVE)
    assert size[found.order == -30] < 0.01 * size.max() and size[found.order == 0] < 0.01 * size.max()


@pytest.mark.long  # programs of their own; by default under forces by a closed form, and of an RV reducer
@pytest.mark.parametrize("design", [DRIVE, RING], ids=["carrier", "ring"])
def test_a_torque_for_a_life_gives_it_back(design):
    options = PLAN | dict(contact="linear", method="raceway")
    found = rvjax.check(life.rated_torque(design, CycloidalErrors(), life=2e7, output_speed=20 * rpm, **options))
    assert float(found.torque) > 0
    duty = life.Duty([float(found.torque)], [-20 * rpm], [1.0])
    assert float(rate(design, duty, method="raceway").life) == pytest.approx(2e7, rel=1e-8)


def told(layout, read, torques, angles, start, *, near):
    """The force of the discs across their eccentrics alone, at every angle, in the place of equilibria."""
    size = torques / (layout.discs * read.eccentricity * abs(read.design.ratio))
    many = len(angles), len(torques), layout.discs, 1, 2
    arm = jnp.broadcast_to(jnp.stack([size, 0 * size], axis=-1)[None, :, None, None, :], many)
    info = SolveInfo(*(jnp.full(many[:2], value) for value in (jnp.int32(0), jnp.int32(1), 0.0)))
    return BearingForces(arm, 0 * arm[:, :, 0], info, start)


@pytest.mark.parametrize("design", [DRIVE, RING], ids=["carrier", "ring"])
def test_the_search_for_a_torque_under_forces_of_a_closed_form(monkeypatch, design):
    """Of both discs' bearings, Eqs. 21 and 24; the shaft makes zp turns against a disc in one of the output."""
    monkeypatch.setattr(sys.modules["rvjax.life.rated"], "bearing_forces", told)
    options = PLAN | dict(samples=5, output_speed=-20 * rpm)  # a program that no other test has
    found = rvjax.check(life.rated_torque(design, CycloidalErrors(), life=2e7, **options))
    budget = 2e7 * 20 * rpm * 30 / (2 * np.pi)
    force = 34500 * (1e6 / budget) ** 0.3 / 2 ** (0.3 / 1.125)
    lever = 2 * design.cycloid.eccentricity * (29 if design.member == "carrier" else 30)
    assert float(found.torque) == pytest.approx(force * lever, rel=1e-9)


PLACES = dict(disc_position=0.01, planet_position=0.0, support_span=0.03)


@pytest.mark.parametrize(
    ("bearings", "told"),
    [
        (None, "CycloidalReducer.bearings = None"),
        (Bearings(arm=ARM, support=ARM), "Bearings.support: must be None for a CycloidalReducer"),
        (Bearings(arm=ARM, **PLACES), r"Bearings.disc_position: must be None .*\(Bearings.support\) are not rated"),
        (Bearings(arm=ARM, support=ARM.replace(contact_angle=0.2), preload=9.0), "Bearings.support: must be None"),
        (Bearings(arm=ARM.replace(capacity=31.0)), "Bearings.arm.capacity = 31 N: must be"),
    ],
)
def test_bearings_that_are_not_rated(bearings, told):
    design = DRIVE.replace(bearings=bearings)
    for call in (
        lambda: life.rating(design, ERRORS, DUTY, **PLAN),
        lambda: life.rated_torque(design, ERRORS, life=1e7, output_speed=1.0),
    ):
        with pytest.raises(ValueError, match=told):
            call()


def test_errors_and_arguments_of_the_other_kind():
    with pytest.raises(ValueError, match="a CycloidalReducer takes CycloidalErrors, got RVErrors"):
        life.rating(DRIVE, RVErrors(), DUTY)
    with pytest.raises(ValueError, match="sun = 'floating'"):
        life.rating(DRIVE, ERRORS, DUTY, sun="floating")
    with pytest.raises(ValueError, match="kind RVReducer or CycloidalReducer, got"):
        life.rating(catalogue.RV_40E.cycloid, ERRORS, DUTY)
