"""Why a bearing fails, and the section of the page.

Oracles: closed forms of the plane model without errors, the makers' duty formula, and lives made by hand.
"""

import dataclasses
import sys
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from life_cases import BASIC, NAMED, unit_of

from rvjax import RVErrors, Status, catalogue, life, study
from rvjax._jax.exported import SUFFIX
from rvjax.commands.report import bearings
from rvjax.commands.report.bearings import TORQUES, Lives, bearing_section, lives_if_any
from rvjax.life.rating import Orders
from rvjax.loaded import BearingForces
from rvjax.render import Figure, Note, Table
from rvjax.response import per_response
from rvjax.status import SolveInfo, at_once
from rvjax.tolerances import sample
from rvjax.units import rpm

HOUR = 3600.0


def rated(arm, support=None):
    """A rating whose system life follows from its bearings."""
    parts = [np.ravel(part) for part in (arm, support) if part is not None]
    rates = np.concatenate([1 / part for part in parts])
    whole = 1 / np.sum(rates**1.125) ** (1 / 1.125) if rates.any() else np.inf
    none = jnp.zeros(())
    return life.Rating(jnp.asarray(whole), jnp.asarray(arm), support, none, none, none, at_once(none))


first_failures = jax.jit(life.first_failures)  # in one program


def test_shares_of_the_failures_are_those_of_a_weibull_system():
    found = first_failures(rated(np.full((2, 3), 7.0)))
    np.testing.assert_allclose(found.arm, np.full((2, 3), 1 / 6), rtol=1e-12)
    mixed = first_failures(rated(np.array([[1.0, 2.0]]), np.array([[4.0, np.inf], [3.0, 3.0]])))
    assert float(np.sum(mixed.arm) + np.sum(mixed.support)) == pytest.approx(1, rel=1e-12)
    assert float(mixed.arm[0, 0] / mixed.arm[0, 1]) == pytest.approx(2**1.125, rel=1e-12)
    assert float(mixed.support[0, 1]) == 0
    assert not np.any(first_failures(rated(np.full((1, 2), np.inf))).arm)


def test_a_phase_has_its_share_of_the_damage():
    """By the makers' formula: |n| t T^(10/3); a phase at rest does no damage; two units have separate shares."""
    duty = life.Duty(np.array([412.0, 200.0, 800.0]), np.array([1.5, -3.0, 0.0]), np.array([1.0, 2.0, 5.0]))
    size = np.array([[1.0], [1.2]])  # of the loads of two units, with another exponent for the second
    exponent = np.array([10 / 3, 4.0])

    def of(duty):
        return 1 / np.sum(np.abs(duty.output_speed) * duty.time * (size * duty.output_torque) ** exponent[:, None], 1)

    due = np.abs(duty.output_speed) * duty.time * duty.output_torque ** exponent[:, None]
    np.testing.assert_allclose(life.phase_shares(of, duty).T, due / due.sum(1, keepdims=True), rtol=1e-6, atol=0)


def test_the_orders_of_forces_that_are_told(monkeypatch):
    """One force fixed in the carrier, one that turns with the crank, and one the other way; others are none."""
    design, errors = unit_of(NAMED[BASIC])
    waves = {0: 3.0 - 1.0j, -40: 2.0j, 3: 0.5}

    def told(layout, read, torques, angles):
        turned = {order: order * angles / design.ratio for order in waves}
        size = sum(size * jax.lax.complex(jnp.cos(turned[k]), jnp.sin(turned[k])) for k, size in waves.items())
        force = jnp.stack([size.real, size.imag], -1)[:, None, None, None]
        shape = len(angles), 1
        info = SolveInfo(jnp.zeros(shape, jnp.int32), jnp.ones(shape, jnp.int32), jnp.zeros(shape))
        return BearingForces(
            jnp.broadcast_to(force, (*shape, layout.discs, layout.links, 2)), force[:, :, 0], info, None
        )

    monkeypatch.setattr(sys.modules["rvjax.life.rating"], "bearing_forces", told)
    found = jax.jit(partial(life.force_orders, samples=100))(design, errors, output_torque=412.0)
    due = [waves.get(int(order), 0.0) for order in found.order]
    assert found.amplitude.shape == (2, design.cranks.count, 100)
    np.testing.assert_allclose(found.amplitude, np.broadcast_to(due, found.amplitude.shape), atol=1e-12)


@pytest.mark.long  # a program of its own
def test_the_orders_of_the_force_without_errors():
    """M/(c R) is fixed in the carrier, M/(c e zc) across the eccentric turns with the crank; the rest is ripple."""
    design, _ = unit_of(NAMED[BASIC])
    pins, cranks = design.cycloid.pin_count, design.cranks.count
    orders = jax.jit(partial(life.force_orders, samples=4 * pins, contact="linear"))
    found = orders(design, RVErrors(), output_torque=412.0)
    assert int(found.info.status) == Status.CONVERGED and found.amplitude.shape == (2, cranks, 4 * pins)
    teeth = design.cycloid.disc_teeth
    moment = 412.0 * teeth / (2 * (pins + design.involute.sun_teeth / design.involute.planet_teeth))
    size = dict(zip(found.order.tolist(), np.abs(found.amplitude[0, 0])))
    assert size[0] == pytest.approx(moment / (cranks * float(design.cranks.circle_radius)), rel=2e-2)
    across = moment / (cranks * float(design.cycloid.eccentricity) * teeth)
    assert across < size[-pins] < 1.1 * across
    assert max(value for order, value in size.items() if order % pins) < 1e-6 * size[0]


def made(phases=3, **changes):
    """Lives of four units with two arm bearings and a support."""
    each = HOUR * np.array([[9e3, 8e3, 9e4], [8e3, 7e3, 9e4], [9e3, 9e3, 9e4], [7e3, 6e3, 9e4]])
    names = ("disc 0, crank 0", "disc 1, crank 0", "support 0, crank 0")
    duty = np.array([[412.0, 15 * rpm, 2.0], [-100.0, -30 * rpm, 5.0], [50.0, 0.0, 1.0]])[:phases]
    orders = np.array([0, 1, 40, -40, -1])
    force = np.array([[2e3, 2e3], [0, 300.0], [0, 10.0], [1e3, 1e3], [0, 200.0]])
    lives = Lives(
        method="raceway", samples=12, reliability=0.95, life=np.array([4e3, 3e3, 5e3, 2e3]) * HOUR, failed=3,
        bearings=names, centre=each[0], each=each, load=each / HOUR, first=np.array([0.3, 0.6, 0.1]),
        held={"pin_ring": (10 * HOUR, 5 * HOUR), "disc_bore": (90 * HOUR, 70 * HOUR)}, duty=duty,
        phases=np.array([0.9, 0.1, 0.0])[:phases], torque=np.array([200.0, 400.0]), speed=15 * rpm,
        of_torque=np.array([[9.0, 5, 7, 8], [0.9, 0.5, 0.7, 0.8]]) * 1e3 * HOUR, orders=orders, force=force, pins=40,
        crank=-40,
    )  # fmt: skip
    return dataclasses.replace(lives, **changes)


@pytest.fixture(scope="module")
def question():
    return study.load("rv-40e-whole", solve=False)


def test_the_page_says_which_bearing_fails_first_and_why(question):
    found = bearing_section(made(), question)
    assert found.title == "Bearing life"
    tables = {part.name: part.texts("page")[1] for part in found.content if isinstance(part, Table)}
    assert [row[1] for row in tables["bearing_lives"]] == ["30.0 %", "60.0 %", "10.0 %"]
    assert tables["bearing_lives"][1][2] == "8,000"  # h
    orders = {row[0]: row[1] for row in tables["bearing_orders"]}
    assert list(orders) == ["0", "-40", "1", "-1", "40"]
    assert orders["0"] == "fixed in the carrier" and orders["-40"] == "turns with the crank"
    assert orders["40"] == "pins and teeth" and orders["1"] == "errors of the parts"
    captions = {part.name: part.caption for part in found.content if isinstance(part, Table)}
    assert captions["bearing_orders"] == (
        "Force on the bearing of disc 1, crank 0 under 412 N m, by order of the output revolution"
    )
    assert [row[0] for row in tables["bearing_errors"]] == ["disc bore", "pin ring"]
    assert tables["duty_phases"] == [
        ["0: 412 N m, 15 r/min", "25.0 %", "90.0 %"],
        ["1: -100 N m, -30 r/min", "62.5 %", "10.0 %"],
        ["2: 50 N m, at rest", "12.5 %", "0.0 %"],
    ]
    figures = [part for part in found.content if isinstance(part, Figure)]
    assert len(figures) == 3 and all(figure.content("png").startswith(b"\x89PNG") for figure in figures)
    assert "disc 1, crank 0 with 60 %" in figures[0].caption
    drive = SimpleNamespace(requirements=question.requirements, design=catalogue.CYCLOIDAL_17)
    of_ring = bearing_section(made(crank=40), drive).content
    rows = next(part for part in of_ring if getattr(part, "name", "") == "bearing_orders").texts("page")[1]
    assert "cycloidal drives is not measured" in of_ring[-1].text and "at most 1.5 %" in found.content[-1].text
    assert dict(row[:2] for row in rows)["40"] == "turns with the crank"  # of a drive whose ring turns


def test_a_share_of_bearings_is_no_share_of_units(question):
    """The reliability counts bearings of one unit, a quantile counts units; one phase needs no shares."""
    found = bearing_section(made(1), question)
    first, last = (part.text for part in found.content if isinstance(part, Note))
    assert "95 % of the bearings reach the rated life" in first
    assert "4 sample units" in first and "half have a rated life above 3,500 h" in first and "3 further units" in first
    assert "no tilt" in last and "differ in level" in last
    assert not any(isinstance(part, (Table, Figure)) and part.name == "duty_phases" for part in found.content)


def test_lives_are_those_of_the_units_and_their_programs_are_kept(question, kept_programs, monkeypatch):
    """Oracle: a law of one error and the duty in the place of the model, and the units by their numbers."""

    def life_of(radius, duty):
        return HOUR * 1e9 * (1 - 2e4 * radius) / sum(time * abs(torque) ** 3 for torque, _, time in duty)

    def rating(design, errors, duty, *, samples, method, reliability, contact, carrier, sun):
        rows = [[column[k] for column in (duty.output_torque, duty.output_speed, duty.time)] for k in range(phases)]
        whole, (discs, cranks) = life_of(errors.pin_radius, rows), errors.crank_eccentricity.shape
        arm = whole * jnp.arange(2.0, 2.0 + discs * cranks).reshape(discs, cranks)
        return life.Rating(whole, arm, None, arm / HOUR, None, whole, at_once(whole))

    def orders(design, errors, *, output_torque, samples, contact, carrier, sun):
        size = output_torque * (1 + 1e5 * errors.pin_radius) * jnp.ones((*errors.crank_eccentricity.shape, samples))
        return Orders(np.arange(samples), jax.lax.complex(size, 0 * size), None)

    monkeypatch.setattr(life, "rating", rating)
    monkeypatch.setattr(life, "force_orders", orders)
    monkeypatch.setattr(bearings, "_of_units", per_response()(bearings._of_units.__wrapped__))
    duty, given, units = np.asarray(question.conditions.duty), question.tolerances, 6
    phases, torque = len(duty), np.abs(duty[:, 0]).max()
    found = lives_if_any(question, given, units=units)
    radius = [float(sample(given, k, seed=question.seed + 3).pin_radius) for k in range(1, units + 1)]
    due = np.array([life_of(x, duty) for x in radius])
    np.testing.assert_allclose(found.life, due, rtol=1e-12)
    middle = float(given.pin_radius.middle)
    np.testing.assert_allclose(found.centre, life_of(middle, duty) * np.arange(2, 2 + len(found.centre)), rtol=1e-12)
    assert found.held["pin_radius"][0] == pytest.approx(life_of(middle, duty) - due.mean(), rel=1e-9)
    assert found.held["disc_bore"] == (0.0, 0.0) and found.failed == 0
    one = [life_of(middle, [(factor * torque, 0, phases)]) for factor in TORQUES]
    np.testing.assert_allclose(found.of_torque[:, 0], one, rtol=1e-12)
    np.testing.assert_allclose(found.force[:, 0], torque * (1 + 1e5 * middle), rtol=1e-12)
    rms = np.sqrt(np.mean([(1 + 1e5 * x) ** 2 for x in radius]))
    np.testing.assert_allclose(found.force[:, 1], torque * rms, rtol=1e-12)
    assert len([path for path in kept_programs.iterdir() if path.suffix == SUFFIX]) == 2


def test_a_study_without_a_life_has_no_section():
    other = study.load("rv-40e", solve=False)
    assert lives_if_any(other, other.tolerances) is None
