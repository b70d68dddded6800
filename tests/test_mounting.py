"""Parts in their slots: which positions keep the toothing, and what a part carries there.

Oracle: rigid motion of points. Bores, tooth spaces and points of the flanks of a disc are placed in the plane, turned
and turned over there, and looked up again among the points of the slot.
"""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import CycloidalErrors, four_bar, loaded, mounting
from rvjax.catalogue import CYCLOIDAL_15, CYCLOIDAL_17, RV_40E
from rvjax.mounting import Mounting, disc_mountings, mounted_disc, unit_errors


def design_of(teeth, discs, cranks, reducer="rv"):
    if reducer == "drive":
        cycloid = CYCLOIDAL_17.cycloid.replace(disc_teeth=teeth, pin_count=teeth + 1, disc_count=discs)
        return CYCLOIDAL_17.replace(cycloid=cycloid, output=CYCLOIDAL_17.output.replace(count=cranks))
    cycloid = RV_40E.cycloid.replace(disc_teeth=teeth, pin_count=teeth + 1, disc_count=discs, eccentricity=5e-4)
    return RV_40E.replace(cycloid=cycloid, cranks=RV_40E.cranks.replace(count=cranks))


def spaces(teeth, discs, slot):
    """Directions of the tooth spaces of the disc of a slot, rad: where the lobe angle of a pin in it is 0."""
    return (np.arange(teeth) - slot / discs) * 2 * math.pi / teeth


def same(angles, others):
    """Whether two sets of directions are one."""
    distance = np.abs(np.exp(1j * angles)[:, None] - np.exp(1j * others)[None])
    return distance.min(axis=1).max() < 1e-9


def moved(points, position, cranks):
    """Complex points turned over about the x axis, then turned."""
    return (points.conj() if position.over else points) * np.exp(2j * math.pi * position.turn / cranks)


COUNTS = [(39, 2, 2, "rv"), (40, 2, 2, "rv"), (39, 2, 3, "rv"), (39, 3, 4, "rv"), (40, 2, 4, "rv"), (59, 1, 3, "rv")]
COUNTS += [(17, 2, 6, "drive"), (15, 2, 6, "drive"), (20, 2, 4, "drive")]


@pytest.mark.parametrize(("teeth", "discs", "cranks", "reducer"), COUNTS)
def test_positions_that_keep_the_toothing(teeth, discs, cranks, reducer):
    design = design_of(teeth, discs, cranks, reducer)
    for slot, made_for in itertools.product(range(discs), repeat=2):
        every = [Mounting(turn, over) for over in (False, True) for turn in range(cranks)]
        old = np.exp(1j * spaces(teeth, discs, made_for))
        fit = [p for p in every if same(np.angle(moved(old, p, cranks)), spaces(teeth, discs, slot))]
        assert list(disc_mountings(design, slot, made_for=made_for)) == fit


def test_the_discs_of_the_catalogue():
    """39 teeth on two cranks: one drawing for both discs, each as it is or turned over; never half a turn alone."""
    assert disc_mountings(RV_40E, 0) == (Mounting(0, False), Mounting(0, True))
    assert disc_mountings(RV_40E, 1) == (Mounting(1, False), Mounting(1, True))
    assert len(disc_mountings(design_of(40, 2, 2), 0)) == 4
    assert disc_mountings(design_of(39, 2, 3), 1) == () and mounting.drawing(design_of(39, 2, 3), 1) == 1


FURTHER = [(40, 2, 2, "rv"), (39, 3, 4, "rv"), (59, 1, 3, "rv"), (17, 2, 6, "drive")]


@pytest.mark.parametrize(
    ("teeth", "discs", "cranks", "reducer"),
    [pytest.param(*counts, marks=[pytest.mark.long] * (counts in FURTHER)) for counts in COUNTS],
)
def test_errors_move_with_the_metal(teeth, discs, cranks, reducer):
    """Bores lie opposite to their crank number, holes of a drive on the x axis on."""
    design, rng = design_of(teeth, discs, cranks, reducer), np.random.default_rng(teeth + cranks)
    at, start = {"rv": ("disc_bore", math.pi), "drive": ("hole_position", 0.0)}[reducer]
    bore, pitch, wave = rng.standard_normal((cranks, 2)), rng.standard_normal(teeth), rng.standard_normal((5, 2))
    errors = {at: bore, "disc_centre": np.array([0.3, -0.7]), "disc_pitch": pitch, "disc_profile": wave}
    axes = np.exp(1j * (start + 2 * math.pi * np.arange(cranks) / cranks))
    lobe = np.array([0.4, 2.9, 5.0])

    def flank(waves):
        return np.cos(np.outer(lobe, np.arange(5))) @ waves[:, 0] + np.sin(np.outer(lobe, np.arange(5))) @ waves[:, 1]

    def tips(slot):  # middle of tooth t: half a pitch before its space
        return spaces(teeth, discs, slot) - math.pi / teeth

    for slot, made_for in itertools.product(range(discs), repeat=2):
        for number, position in enumerate(disc_mountings(design, slot, made_for=made_for)):
            found = mounted_disc(design, errors, slot, number, made_for=made_for)
            seat = moved(axes, position, cranks)
            vectors = moved((bore[:, 0] + 1j * bore[:, 1]) * axes, position, cranks)
            back = np.asarray(found[at])
            for q, axis in enumerate(axes):
                own = np.argmin(np.abs(seat - axis))
                np.testing.assert_allclose((back[q, 0] + 1j * back[q, 1]) * axis, vectors[own], atol=1e-12)
            centre = moved(np.array(0.3 - 0.7j), position, cranks)
            np.testing.assert_allclose(found["disc_centre"], [centre.real, centre.imag], atol=1e-12)
            teeth_now = moved(np.exp(1j * tips(made_for)), position, cranks)
            for t, tip in enumerate(np.exp(1j * tips(slot))):
                own = np.argmin(np.abs(teeth_now - tip))
                assert abs(teeth_now[own] - tip) < 1e-9
                assert found["disc_pitch"][t] == pytest.approx((-1 if position.over else 1) * pitch[own])
            # Lobe angle 0 and 2 pi are spaces; turned over, a tooth is run through from the other side.
            waves = np.asarray(found["disc_profile"])
            mirrored = wave * [1, -1]
            np.testing.assert_allclose(flank(waves), flank(mirrored if position.over else wave), atol=1e-12)


def test_a_traced_index_is_the_plain_one():
    bore = np.arange(4.0).reshape(2, 2)
    plain = [mounted_disc(RV_40E, {"disc_bore": bore}, 1, i)["disc_bore"] for i in range(2)]
    traced = [mounted_disc(RV_40E, {"disc_bore": bore}, 1, jnp.int32(i))["disc_bore"] for i in range(2)]
    np.testing.assert_array_equal(plain, traced)


def test_positions_of_perfect_parts_change_nothing():
    """A disc and a carrier without errors, among cranks with some: the same unit in every position."""
    cranks = {"crank_eccentricity": np.array([3e-6, -2e-6]), "crank_phase": 1e-4}
    parts = {
        "disc_0": {"disc_bore": np.zeros((2, 2))},
        "disc_1": {},
        "carrier": {"carrier_bore": 0.0},
        "crank_1": cranks,
    }
    for at in itertools.product(range(2), repeat=3):
        errors = unit_errors(RV_40E, parts, dict(zip(("disc_0", "disc_1", "carrier"), at)) | {"crank_1": 0})
        np.testing.assert_array_equal(errors.crank_eccentricity, [[0, 3e-6], [0, -2e-6]])
        np.testing.assert_array_equal(errors.crank_phase, [0, 1e-4])
        assert not np.any(errors.disc_bore) and not np.any(errors.carrier_bore)


def test_bores_turned_with_the_carrier_are_one_machine():
    """Discs and carrier half a turn on two cranks without errors: the same misfit."""
    rng = np.random.default_rng(0)
    bores, carrier = 1e-6 * rng.standard_normal((2, 2, 2)), 1e-6 * rng.standard_normal((2, 2))
    given = {"disc_0": {"disc_bore": bores[0]}, "disc_1": {"disc_bore": bores[1]}, "carrier": {"carrier_bore": carrier}}
    there = unit_errors(RV_40E, given, {"disc_0": 0, "disc_1": 0, "carrier": 0})
    alone = unit_errors(RV_40E, given, {"disc_0": 0, "disc_1": 0, "carrier": 1})
    both = alone.replace(disc_bore=there.disc_bore[:, ::-1])
    np.testing.assert_array_equal(there.disc_bore, [bores[0], bores[1][::-1]])  # a disc made for slot 0, half a turn
    np.testing.assert_array_equal(alone.carrier_bore, carrier[::-1])
    given = dict(crank_angle=0.7, closure="closed_form")
    misfits = [np.asarray(four_bar.transmission_error(RV_40E, e, **given).misfit) for e in (there, both)]
    np.testing.assert_allclose(*misfits, rtol=1e-9)
    assert np.abs(misfits[0]).min() > 1e-8


@pytest.mark.parametrize("index", range(6))
def test_a_turned_carrier_takes_its_centre_and_its_pins_along(index):
    """Six output pins: each is the pin `index` places before, and carries its offset along its own axis."""
    parts = {"carrier_centre": np.array([0.3, -0.7]), "output_pin_offset": np.arange(12.0).reshape(6, 2)}
    parts |= {"output_pin_radius": np.arange(6.0)}
    found = unit_errors(CYCLOIDAL_15, {"carrier": parts}, {"carrier": index})
    centre = (0.3 - 0.7j) * np.exp(2j * math.pi * index / 6)
    np.testing.assert_allclose(found.carrier_centre, [centre.real, centre.imag], atol=1e-12)
    for name in ("output_pin_offset", "output_pin_radius"):
        np.testing.assert_array_equal(getattr(found, name), np.roll(parts[name], index, axis=0))


@pytest.mark.long  # errors move with the metal, above, by default
def test_a_drive_moves_its_disc_and_its_carrier_as_one_machine():
    """15 lobes, 6 holes: a turned or exchanged part shifts the curve of a crank turn; turned over, load and time turn.

    Only one part has errors, so the drive with the part in its new position is the old one, seen from elsewhere.
    """
    stiff = {part: getattr(CYCLOIDAL_15, part).replace(pin_stiffness=2e8) for part in ("contact", "output")}
    design, rng = CYCLOIDAL_15.replace(**stiff), np.random.default_rng(2)
    shapes = mounting.carried(design, "disc") | mounting.carried(design, "carrier")
    assert set(shapes) == {
        "disc_centre", "disc_pitch", "disc_profile", "hole_position", "hole_radius",
        "output_pin_offset", "output_pin_radius", "carrier_centre",
    }  # fmt: skip
    parts = {name: 2e-5 * rng.standard_normal(shape) for name, shape in shapes.items()}
    pins = {name: parts.pop(name) for name in mounting.carried(design, "carrier")}

    @functools.partial(jax.jit, static_argnums=0)
    def placed(slot, errors, index):
        return unit_errors(design, {slot: errors}, {slot: index})

    def curve(slot, errors, index, torque=5.0):
        made = jax.tree.map(np.asarray, placed(slot, errors, index))
        whole = CycloidalErrors.for_design(design, **{name: getattr(made, name) for name in shapes})
        return np.asarray(loaded.revolution(design, whole, output_torque=torque, samples=12, contact="linear").error)

    drawn = {torque: curve("disc_0", parts, 0, torque) for torque in (5.0, -5.0)}
    size = np.ptp(drawn[5.0])
    for slot, number in ((0, 1), (0, 4), (1, 0), (1, 3)):
        position = disc_mountings(design, slot)[number]
        seen = np.arange(12) + 2 * position.turn - 6 * slot  # the sixth of a crank turn is two samples
        due = -drawn[-5.0][-seen % 12] if position.over else drawn[5.0][seen % 12]
        np.testing.assert_allclose(curve(f"disc_{slot}", parts, number), due, atol=1e-6 * size)
    still = curve("carrier", pins, 0)
    np.testing.assert_allclose(curve("carrier", pins, 2), still[(np.arange(12) + 4) % 12], atol=1e-6 * np.ptp(still))


def test_what_no_such_part_has_is_refused():
    with pytest.raises(ValueError, match="disc_0: carrier_bore is no error of one disc; there are disc_bore"):
        unit_errors(RV_40E, {"disc_0": {"carrier_bore": 0.0}}, {"disc_0": 0})
    with pytest.raises(ValueError, match="crank_1: disc_bore is no error of one crank"):
        unit_errors(RV_40E, {"crank_1": {"disc_bore": 0.0}}, {"crank_1": 0})
    with pytest.raises(ValueError, match="disc_2: this design has 2 of them, counted from 0"):
        unit_errors(RV_40E, {"disc_2": {}}, {"disc_2": 0})
    with pytest.raises(ValueError, match="pins: pin_radius is in another slot already"):
        unit_errors(RV_40E, {"ring": {"pin_radius": 0.0}, "pins": {"pin_radius": 0.0}}, {"ring": 0, "pins": 0})
    with pytest.raises(ValueError, match="disc_1: a disc made for slot 0 does not fit there"):
        mounted_disc(design_of(39, 2, 3), {}, 1, 0)
