"""Reading of an encoder and stiffness of each pin's support: closed forms and symmetries."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loaded_cases import NAMED, at, design_of, errors_of, plain, solve, supported
from loaded_turns import (
    ALL,
    ENCODER,
    PINS,
    SUPPORT,
    TURN,
    found_over_a_turn,
    harmonics,
    loaded_turn,
    orders_read,
    read_over_a_turn,
    slopes_over_a_turn,
    sprung,
)

import rvjax
from rvjax import Status, loaded
from rvjax.loaded.equilibrium import admit, check_input, prepare
from rvjax.loaded.rv import pin_compliance
from rvjax.published.rv160 import MACHINE, NONE
from rvjax.units import arcsec, mm


def in_the_housing(found, reading, angle, torque):
    """Equations of the page, each vector in the frame of the housing; nothing shared with the model."""
    th, cycloid = angle / MACHINE.ratio, MACHINE.cycloid
    unit = lambda x: np.stack([np.cos(x), np.sin(x)], axis=-1)  # noqa: E731
    quarter = lambda v: np.stack([-v[..., 1], v[..., 0]], axis=-1)  # noqa: E731
    a = b = 0.0
    couple = np.zeros(2)
    for k in range(2):
        pitch = cycloid.eccentricity * 40 * unit(-39 * th + np.pi * k)
        push = cycloid.pin_circle_radius * unit(PINS) - pitch
        force = np.asarray(found.pins)[k][:, None] * push / np.linalg.norm(push, axis=1, keepdims=True)
        radial = np.sum(force * unit(PINS), axis=1)
        tangential = np.sum(force * quarter(unit(PINS)), axis=1)
        # virtual work of w = a cos 2 phi + b sin 2 phi, v = -(a sin 2 phi - b cos 2 phi) / 2
        a += np.sum(radial * np.cos(2 * PINS) - tangential * np.sin(2 * PINS) / 2)
        b += np.sum(radial * np.sin(2 * PINS) + tangential * np.cos(2 * PINS) / 2)
        couple += np.asarray(reading.disc_position)[k] * force.sum(axis=0)
    turned = np.array([[np.cos(th), -np.sin(th)], [np.sin(th), np.cos(th)]])
    shift = -reading.tilt_gain * couple * reading.height + turned @ np.asarray(reading.scale_eccentricity)
    read = []
    for head in np.atleast_1d(reading.heads):
        back = -reading.ring_gain * (a * np.sin(2 * head) - b * np.cos(2 * head)) / 2
        seen = shift @ quarter(unit(head)) - back
        read.append(seen / reading.radius - reading.dent * torque * np.cos(3 * (head - th)))
    return float(found.error) + np.mean(read)


def test_the_reading_is_that_of_vectors_in_the_housing():
    reading = ALL.replace(heads=(0.4, 2.9), ring_gain=1e-9)
    for number, torque in ((17, 800.0), (411, -500.0)):
        found, angle = at(found_over_a_turn(sprung(), torque), number), TURN[number] * MACHINE.ratio
        read = loaded.reading(found, MACHINE, reading, input_angle=angle, output_torque=torque)
        due = in_the_housing(found, reading, angle, torque) - found.error
        assert abs(due) > 0.2 * arcsec
        np.testing.assert_allclose(read - found.error, due, rtol=1e-9)


def test_without_gains_the_reading_is_the_error():
    found = loaded_turn()
    np.testing.assert_array_equal(read_over_a_turn(found, plain(ENCODER), 1000.0), found.error)


def test_no_torque_leaves_the_eccentricity_of_the_scale():
    """Order 1 of amplitude s / r; no pin is pressed."""
    found = found_over_a_turn(sprung(), 0.0)
    reading = ALL.replace(heads=(0.4,))
    x, y = reading.scale_eccentricity
    due = (y * np.cos(0.4 - TURN) - x * np.sin(0.4 - TURN)) / reading.radius
    np.testing.assert_allclose(read_over_a_turn(found, plain(reading), 0.0), due, atol=1e-20)


# --- orders


def test_orders_of_the_table():
    """Written out by hand: P = m (mod 3) in |40 P - m|."""
    orders = partial(loaded.housing_orders, MACHINE, most=165)
    assert orders(0) == (0, 120) and orders(1) == (39, 81, 159) and orders(2) == (42, 78, 162)
    assert orders(3) == (3, 117, 123) and orders(4) == (36, 84, 156)
    twice = loaded.housing_orders(rvjax.catalogue.RV_40E, 1, most=130)  # two cranks: P odd
    assert twice == (39, 41, 119, 121)


def wave(harmonic, stiffness=MACHINE.stiffness):
    """Spectrum of d alpha / d eps for a wave 1 + eps cos(m phi) of the support's compliance, arcsec."""
    _, slopes = slopes_over_a_turn(sprung(stiffness=stiffness), 1000.0, np.cos(harmonic * PINS))
    return np.abs(harmonics(slopes.error)) / arcsec


UNLIKE = MACHINE.stiffness.replace(turning_arm_bearing=np.array([[7e8] * 3, [8e8] * 3]))


# The program of slopes over a turn is long; by default a wave of the support, below, has its closed form.


@pytest.mark.long
@pytest.mark.parametrize("harmonic", [1, 2, 3])
def test_a_wave_of_the_housing_appears_at_its_orders_only(harmonic):
    """Unequal discs, that odd P is seen; all of 1e-5 of the largest and more, those below 1e-10 are rounding."""
    found, allowed = wave(harmonic, UNLIKE), list(loaded.housing_orders(MACHINE, harmonic))
    top = found.max()
    assert top > 0.1
    assert np.delete(found, allowed).max() < 1e-9 * top
    low = [order for order in allowed if order <= 100]
    assert found[low].min() > 1e-5 * top


@pytest.mark.long
def test_equal_opposed_discs_cancel_odd_multiples():
    """The sum of both discs has P = 0, 2, 4 ..; with unequal ones the same wave gives 0.9 arcsec of order 39."""
    assert wave(1).max() < 1e-12 and wave(1, UNLIKE)[39] > 0.5


@pytest.mark.long
def test_an_unequal_crank_breaks_the_rule():
    """What the tests above are to see."""
    seats = MACHINE.stiffness.replace(support_bearing=np.array([8e8, 7e8, 7e8]))
    found, allowed = wave(2, seats), list(loaded.housing_orders(MACHINE, 2))
    assert np.delete(found, allowed).max() > 1e-4 * found.max()


# --- pins on supports of their own


def in_the_turn(support, torque):
    """Error and pins at one angle, by the program of a turn."""
    found = at(found_over_a_turn(sprung(support), torque), 17)
    return float(found.error), found.pins


def of_linear_pins(support, torque):
    """The same of an RV-40E."""
    design = supported(design_of(NAMED["rv40: all errors, rated, linear"]), support)
    found = solve(design, errors_of({"errors": {}}, design), 3.7, torque, contact="linear")
    return float(found.error), found.pins


@pytest.mark.parametrize("solved", [in_the_turn, of_linear_pins])
def test_yielding_of_a_pin_turns_the_output_by_its_work(solved):
    """d alpha = -sum dC_j F_j dF_j/dT, for any added compliance dC_j of the pins, against differences.

    The mesh stiffness of linear pins includes the mean support: an added compliance of mean 0."""
    added = np.random.default_rng(0).uniform(-1, 1, 40) / 1e8
    added -= np.mean(added)
    error = lambda eps: solved(1 / (1e-8 + eps * added), 1000.0)[0]  # noqa: E731
    near, far = (error(step) - error(-step) for step in (1e-3, 2e-3))
    pins = lambda torque: np.asarray(solved(np.full(40, 1e8), torque)[1])  # noqa: E731
    low, high = (pins(1000.0 + step) - pins(1000.0 - step) for step in (0.5, 1.0))
    due = -np.sum(added * pins(1000.0) * (8 * low - high) / 6)
    assert abs(due) > 0.05 * arcsec
    np.testing.assert_allclose((8 * near - far) / 12e-3, due, rtol=2e-8)


def rigid_bearings(support, torque):
    """(Stiffness factor, equilibria over a turn): bearings yield as 1/factor, and the centring springs grow with it.

    Pins and discs are a hundred thousand times as stiff as steel, so that their supports alone yield, in proportion."""
    for factor in (500.0, 1000.0, 2000.0):
        springs = jax.tree.map(lambda k: factor * k, MACHINE.stiffness)  # noqa: B023
        yield factor, found_over_a_turn(sprung(support, springs, young_modulus=2e16), torque)


def at_rigid(factors, values):
    """Of values a + b / factor + c factor the number a."""
    rows = np.array([[1.0, 1 / factor, factor] for factor in factors])
    return np.linalg.solve(rows * [1, 1e3, 1e-3], np.array(values))[0]


K1 = MACHINE.cycloid.eccentricity * 40 / MACHINE.cycloid.pin_circle_radius
Q = (1 + K1**2) / (2 * K1)
LOG = np.log((Q + 1) / (Q - 1))


def test_a_wave_of_the_support_has_its_closed_form():
    """Linear pins with 1/k_j = (1 + eps cos 2 phi_j)/k0: order 78 is -eps a0 W, and eps a0 W* backward."""
    k0, eps, torque, throw = 5e7, 1e-3, 1000.0, MACHINE.cycloid.eccentricity
    tau = 39 / (40 + 22 / 44)
    a0 = torque * tau**2 / (2 * k0 * (throw * 39) ** 2 * 40 / 4)
    w = -(1 - K1**2) / 2 + 2j / (np.pi * K1) * (2 / 3 + 2 * (Q**2 - 1) - Q * (Q**2 - 1) * LOG)
    for signed, due in ((torque, -eps * a0 * w), (-torque, eps * a0 * np.conj(w))):
        support = k0 / (1 + eps * np.cos(2 * PINS))
        factors, turns = zip(*rigid_bearings(support, signed))
        found = at_rigid(factors, [harmonics(turn.error)[78] for turn in turns])
        assert abs(due) > 1e-2 * arcsec
        assert abs(found / due - 1) < 2e-5  # eps^2, and 40 pins in place of an integral


def test_the_couple_of_the_discs_tilts_the_scale_by_its_closed_form():
    """Order 39 is h |z1 - z2| |F| / (r K_t); |F| of rigid bearings and linear pins from integrals over the lobe."""
    torque, throw = 1000.0, MACHINE.cycloid.eccentricity
    reading = ENCODER.replace(tilt_gain=1e-9, height=0.75 * 75 * mm)
    factors, turns = zip(*rigid_bearings(np.full(40, 5e7), torque))
    found = at_rigid(factors, [abs(orders_read(turn, reading, torque)[39]) for turn in turns])
    across = torque / (2 * throw * (40 + 22 / 44))  # the moment of a disc over its throw
    force = across * np.hypot(1, (2 + (K1 - Q) * LOG) / (np.pi * K1))
    np.testing.assert_allclose(found, 0.75 * 22 * mm * force * 1e-9, rtol=2e-4)  # 40 pins in place of an integral


def design_on(pin_support=None, pin_stiffness=None):
    return plain(MACHINE.replace(contact=MACHINE.contact.replace(pin_support=pin_support, pin_stiffness=pin_stiffness)))


@jax.jit
def levels(design, errors):
    """Coefficient and levels of the hertz contact law, (1,) and (2, 40)."""
    layout = check_input(design, errors, "hertz", "fixed", "fixed")
    system = prepare(layout, admit(layout, design, errors, 900.0, 3.7), jnp.asarray(3.7)).system
    return system.pins.compliance, system.pins.level


def test_equal_supports_are_one_support():
    """To rounding; and a very stiff support is none."""
    one, many, stiff, rigid = (levels(design_on(k), plain(NONE)) for k in (2e8, SUPPORT * 2, np.full(40, 1e30), None))
    np.testing.assert_allclose(many[1], one[1], rtol=1e-14)
    np.testing.assert_allclose(stiff[1], rigid[1], rtol=1e-14)
    (approach,) = rigid[0]
    assert {float(coefficient) for (coefficient,), _ in (one, many, stiff)} == {float(approach)}
    np.testing.assert_allclose(one[1] - rigid[1], 1 / (2e8 * float(approach)), rtol=1e-12)  # d = F/k + that of a pin


def test_linear_pins_stand_on_their_supports():
    """In series where their own stiffness is given; the mesh stiffness includes the mean support, so that only
    differences count beside it."""
    supports = 1e8 * np.random.default_rng(1).uniform(0.5, 2, 40)
    stiffness = jax.jit(partial(pin_compliance, check_input(MACHINE, NONE, "linear", "fixed", "fixed")))
    rigid = float(stiffness(design_on()))
    for equal in (2e8, SUPPORT * 2):
        np.testing.assert_allclose(stiffness(design_on(equal)), rigid, rtol=1e-14)
        np.testing.assert_allclose(stiffness(design_on(equal, 5e7)), 4e7, rtol=1e-14)
    found = 1 / np.asarray(stiffness(design_on(supports)))
    np.testing.assert_allclose(found - np.mean(found), 1 / supports - np.mean(1 / supports), rtol=1e-12, atol=1e-22)
    np.testing.assert_allclose(np.mean(found), 1 / rigid, rtol=1e-13)


def test_softer_than_the_mesh_has_no_answer():
    """A pin whose support alone yields less than the mean of all by more than the whole mesh."""
    support = np.full(40, 1e6)
    support[0] = 1e9
    design = supported(design_of(NAMED["rv40: all errors, rated, linear"]), support)
    found = solve(design, errors_of({"errors": {}}, design), 3.7, 900.0, contact="linear")
    assert Status(int(found.info.status)) == Status.INVALID_GEOMETRY and np.isnan(found.error)


# --- the place of the heads


def test_a_turned_head_turns_the_phase_of_an_order_by_its_harmonic():
    """Amplitudes stay; order 39 has m = 1, 78 and 42 have 2 and -2, 120 and 240 come from the error itself."""
    by, found = 0.3, loaded_turn()
    first, second = (orders_read(found, ALL.replace(heads=(head,)), 1000.0) for head in (0.0, by))
    assert (abs(first[[1, 3, 39, 42, 78, 120]]) > 0.02 * arcsec).all()
    for order, harmonic in ((39, 1), (78, 2), (42, -2), (3, -3), (1, -1), (120, 0), (240, 0)):
        np.testing.assert_allclose(
            second[order], first[order] * np.exp(1j * harmonic * by), rtol=1e-9, err_msg=str(order)
        )


def test_two_heads_cancel_orders():
    found, place = loaded_turn(), 0.1
    one, opposed, crossed = (
        abs(orders_read(found, ALL.replace(heads=heads), 1000.0))
        for heads in ((place,), (place, place + np.pi), (place, place + np.pi / 2))
    )
    assert max(opposed[[1, 3, 39]]) < 1e-12 * one[39] and crossed[78] < 1e-12 * one[78]
    np.testing.assert_allclose(opposed[78], one[78], rtol=1e-12)
    np.testing.assert_allclose(crossed[39], one[39] / np.sqrt(2), rtol=1e-9)


def test_order_78_grows_with_torque_and_the_error_does_not_have_it():
    """Published curve: 4.09 arcsec per kN m of order 78 and 2.23 of 39; the gains are of that size."""
    reading = ALL.replace(heads=(0.3,), ring_gain=6e-10)
    read = {torque: orders_read(loaded_turn(torque), reading, torque) for torque in (500.0, 1000.0)}
    for order, slope in ((78, 4.09), (39, 2.23), (3, 1.11)):
        low, high = (abs(read[torque][order]) / arcsec for torque in read)
        assert abs(high - slope) < 0.1 * slope and abs(high / low - 2) < 0.02
    assert abs(harmonics(loaded_turn().error)[[3, 39, 78]]).max() < 1e-9 * arcsec


def test_the_mirror_image_reads_the_opposite():
    """A_n(-T, mirrored housing) = -conj A_n(T): pins, head and scale mirrored at the x axis."""
    support, mirror = 1e8 / (1 + 0.2 * np.cos(2 * PINS - 1) + 0.1 * np.sin(PINS)), -np.arange(40) % 40
    ahead = orders_read(found_over_a_turn(sprung(support), 700.0), ALL.replace(heads=(0.3,)), 700.0)
    image = ALL.replace(heads=(-0.3,), scale_eccentricity=(3e-6, 2e-6))
    back = orders_read(found_over_a_turn(sprung(support[mirror]), -700.0), image, -700.0)
    assert np.sum(abs(ahead) > 1e-3 * arcsec) > 8
    np.testing.assert_allclose(back, -np.conj(ahead), atol=1e-8 * abs(ahead).max())
