"""The loaded model of single-stage drives: reference cases, an independent model, invariants, extremes."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cycloidal_cases import CASES, NAMED, design_of, dictionaries, drawn, errors_of, placed

from oracles import cycloidal as oracle
from rvjax import CycloidalErrors, RVErrors, catalogue, loaded
from rvjax.catalogue import RV_40E_WHOLE as rv
from rvjax.geometry import squared_pressure
from rvjax.loaded import material, unchecked
from rvjax.records import concrete
from rvjax.status import Status, succeeded

FAST = (
    "c17: no",
    "c17: all errors, rated, hertz",
    "c17: crank turn",
    "c29: no",
    "c29: p",
    "c29: five",
    "v17",
    "ring13: all",
)


def named(*kinds):
    """Reference cases; those with a program of their own, of another size or law, are long."""
    names = [case["name"] for case in CASES if case["kind"] in kinds]
    return [name if name.startswith(FAST) else pytest.param(name, marks=pytest.mark.long) for name in names]


FORCES = ("pins", "output_pins", "disc_bearing", "support_bearing", "output_bearing", "disc_torque")


@functools.cache
def solved(name):
    case = NAMED[name]
    errors = unchecked(CycloidalErrors(), **{n: np.asarray(v) if np.ndim(v) else v for n, v in case["errors"].items()})
    return getattr(loaded, case["kind"])(*placed(drive_of(case["design"]), errors), **case["options"])


def drive_of(given):
    """The drive of nested dictionaries; numbers that a constructor refuses come from a traced computation."""
    try:
        return design_of(given)
    except ValueError:
        possible = {"eccentricity": 1e-6, "pin_radius": 1e-6}
        drive = design_of(
            given | {"cycloid": given["cycloid"] | possible, "output": given["output"] | {"hole_clearance": 0}}
        )
        parts = {part: unchecked(getattr(drive, part), **given[part]) for part in ("cycloid", "output")}
        return unchecked(drive, **parts)


@pytest.mark.parametrize("name", named("equilibrium"))
def test_equilibria_agree_with_the_independent_ones(name):
    expect, found = NAMED[name]["expect"], solved(name)
    assert Status(int(found.info.status)).name == expect["status"]
    if not succeeded(found.info.status):
        assert all(np.isnan(leaf).all() for leaf in jax.tree.leaves(found.replace(info=None)))
        return
    idle = expect["status"] == "UNLOADED"
    np.testing.assert_allclose(found.error, expect["error"], rtol=1e-9, atol=1e-11 if idle else 1e-14)
    if idle:
        return
    largest = max(np.max(expect["pins"]), np.max(expect["output_pins"]))
    for field in FORCES:
        size = 1.0 if field == "disc_torque" else largest
        np.testing.assert_allclose(getattr(found, field), expect[field], rtol=0, atol=1e-8 * size + 1e-8)
    np.testing.assert_allclose(found.input_torque, expect["input_torque"], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.stiffness, expect["stiffness"], rtol=1e-6)
    np.testing.assert_allclose(np.max(found.pressure), expect["largest_pressure"], rtol=1e-7)
    np.testing.assert_allclose(np.max(found.output_pressure), expect["largest_output_pressure"], rtol=1e-7)
    assert found.gear is None


@pytest.mark.parametrize("name", named("torsion", "revolution"))
def test_curves_agree_with_the_independent_ones(name):
    expect, found = dict(NAMED[name]["expect"]), solved(name)
    assert Status(int(found.info.status)).name == expect.pop("status")
    for field, value in expect.items():
        own = np.asarray(getattr(found, field))
        own = np.stack([own.real, own.imag], axis=-1) if field == "harmonics" else own
        size = np.max(np.abs(value))
        np.testing.assert_allclose(own, value, rtol=1e-7, atol=1e-8 * size + 1e-14, err_msg=field)


def at(tree, part):
    if isinstance(tree, dict):
        return tree[part]
    return np.asarray(tree)[int(part)] if part.isdigit() else getattr(tree, part)


def test_derivatives_are_those_of_the_independent_program():
    """Reference: differences of an implementation of its own; scaled by the parameter, as the largest one counts."""
    name = "c17: all errors, rated, hertz"
    case = NAMED[name]
    design, errors = placed(drive_of(case["design"]), errors_of(case["errors"]))

    def error(whole):
        return loaded.equilibrium(whole["design"], whole["errors"], **(case["options"] | whole["options"])).error

    numbers = {name: case["options"][name] for name in ("output_torque", "input_angle")}
    whole = {"design": design, "errors": errors, "options": numbers}
    slopes, pairs = jax.grad(error)(whole), []
    for path, expect in case["gradient"].items():
        own, value = slopes, whole
        for part in path.split("."):
            own, value = (at(x, part) for x in (own, value))
        pairs.append((float(own), expect, abs(float(value) * expect)))
    size = max(scaled for *_, scaled in pairs)
    assert len(pairs) > 10
    for own, expect, scaled in pairs:
        assert abs(own - expect) * (scaled / abs(expect) if expect else 1) < 1e-5 * scaled + 1e-6 * size


@pytest.mark.long
@pytest.mark.parametrize(("member", "contact"), [("carrier", "linear"), ("ring", "hertz"), ("ring", "palmgren")])
def test_agrees_with_the_independent_model(contact, member):
    """Drawn errors, floating carrier, shaft on supports; three discs."""
    rng = np.random.default_rng(len(contact))
    design = catalogue.CYCLOIDAL_29.replace(member=member)
    design = design.replace(
        cycloid=design.cycloid.replace(disc_count=3),
        stiffness=design.stiffness.replace(shaft_support=2e8, output_support=5e8),
        contact=design.contact.replace(pin_stiffness=2e8),
        output=design.output.replace(pin_stiffness=3e8),
    )
    counts = design.counts
    errors = drawn(rng, tuple(counts[name] for name in ("discs", "pins", "teeth", "output_pins")))
    options = {"input_angle": 0.7, "output_torque": -80.0, "contact": contact, "carrier": "floating"}
    found = loaded.equilibrium(design, CycloidalErrors(**errors), **options)
    expect = oracle.equilibrium(dictionaries(design), errors, **options)
    assert succeeded(found.info.status)
    np.testing.assert_allclose(found.error, expect["error"], rtol=1e-9)
    for field in ("pins", "output_pins", "disc_bearing", "output_bearing"):
        own = np.asarray(expect[field])
        np.testing.assert_allclose(getattr(found, field), own, atol=1e-8 * np.abs(own).max())


def c17(member="carrier", **errors):
    """All errors of the reference case but those given."""
    case = NAMED["c17: all errors, rated, hertz"]
    drawn = errors_of(case["errors"]).replace(**errors)
    return placed(design_of(case["design"]).replace(member=member), drawn)


def solve(design, errors, angle=0.7, torque=13.2, **methods):
    """Of arrays, which no constructor makes Python numbers: a changed case has the program of the others."""
    if isinstance(errors, CycloidalErrors) and concrete(*jax.tree.leaves(errors)):
        design, errors = placed(design, errors)
    return loaded.equilibrium(design, errors, input_angle=float(angle), output_torque=float(torque), **methods)


def test_either_member_is_the_same_machine():
    """T_ring = -T_c zp/zc at the same turn of carrier and ring: identical forces, error and stiffness as Eqs. 4, 14."""
    zc, zp, angle, torque = 17, 18, 0.9, 6.0
    fixed = {"shaft_centre": 0.0}  # it belongs to the part at rest
    one = solve(*c17(**fixed), angle * zc, torque)
    other = solve(*c17("ring", **fixed), angle * zp, -torque * zp / zc)
    np.testing.assert_allclose(one.pins, other.pins, atol=1e-9)
    np.testing.assert_allclose(one.output_pins, other.output_pins, atol=1e-9)
    np.testing.assert_allclose(other.error, -zc / zp * one.error, rtol=1e-12)
    np.testing.assert_allclose(other.stiffness, (zp / zc) ** 2 * one.stiffness, rtol=1e-9)
    np.testing.assert_allclose(one.input_torque, torque / -zc, rtol=1e-6)
    np.testing.assert_allclose(other.input_torque, -torque * zp / zc / zp, rtol=1e-6)
    np.testing.assert_allclose(np.sum(one.disc_torque), torque, rtol=1e-6)


@pytest.mark.parametrize(("member", "shift", "ratio"), [("carrier", 1, -17), ("ring", -1, 18)])
def test_a_crank_turn_later_the_next_pin_is_in_place(member, shift, ratio):
    """The crank stands in the carrier as before, the ring one pin on; with its errors moved, forces are the same."""
    design, errors = c17(member, ring_centre=0.0, shaft_centre=0.0)
    moved = {name: np.roll(getattr(errors, name), shift, axis=0) for name in ("pin_offset", "pin_radii")}
    one, other = solve(design, errors), solve(design, errors.replace(**moved), 0.7 + ratio * 2 * np.pi / 18)
    np.testing.assert_allclose(other.error, one.error, rtol=1e-9)
    np.testing.assert_allclose(other.output_pins, one.output_pins, atol=1e-7 * np.max(one.output_pins))
    np.testing.assert_allclose(np.roll(one.pins, shift, axis=1), other.pins, atol=1e-7 * np.max(one.pins))
    still = solve(design, errors, 0.7 + ratio * 2 * np.pi / 18)
    assert abs(still.error - one.error) > 1e-3 * abs(one.error)


def scaled(record, **powers):
    """A copy whose numbers of a unit are 1.7 to a power times as large."""
    factors = {unit: 1.7**power for unit, power in powers.items()}
    changed = {}
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if dataclasses.is_dataclass(value):
            changed[f.name] = scaled(value, **powers)
        elif f.metadata.get("unit") in factors and value is not None:
            changed[f.name] = value * factors[f.metadata["unit"]]
    return unchecked(record, **changed)


def test_stiffer_parts_and_larger_drives():
    """All stiffness and the torque: the same angles. All lengths, stiffness as lengths, T as volumes: likewise."""
    design, errors = c17()
    one = solve(design, errors)
    stiff = solve(scaled(design, **{"Pa": 1, "N/m": 1}), errors, torque=13.2 * 1.7)
    large = solve(scaled(design, **{"m": 1, "N/m": 1}), scaled(errors, m=1), torque=13.2 * 1.7**3)
    for other, power in ((stiff, 1), (large, 2)):
        np.testing.assert_allclose(other.error, one.error, rtol=1e-9)
        for field in ("pins", "output_pins", "disc_bearing"):
            due = 1.7**power * getattr(one, field)
            np.testing.assert_allclose(getattr(other, field), due, atol=1e-8 * np.max(due))
    np.testing.assert_allclose(stiff.pressure, 1.7 * one.pressure, atol=1e-8 * np.max(stiff.pressure))
    np.testing.assert_allclose(large.output_pressure, one.output_pressure, atol=1e-8 * np.max(one.output_pressure))


def test_rotations_of_all_output_pins_and_of_the_shaft():
    design, errors = c17()
    one, step = solve(design, errors), 3e-6
    ahead = errors.output_pin_offset + np.array([0.0, step])
    found = solve(design, errors.replace(output_pin_offset=ahead))
    np.testing.assert_allclose(found.error - one.error, -step / design.output.circle_radius, rtol=1e-6)
    turn = lambda p: solve(design, errors.replace(eccentric_phase=errors.eccentric_phase + p)).error  # noqa: E731
    moved = (turn(1e-5) - turn(-1e-5)) / 2e-5
    due = (solve(design, errors, 0.7 + 1e-5).error - solve(design, errors, 0.7 - 1e-5).error) / 2e-5 - 1 / 17
    np.testing.assert_allclose(moved, due, rtol=5e-3)


def test_closed_forms_of_stiff_eccentrics():
    """Eqs. 16 to 18 without clearance, linear law: forces in proportion to their arms."""
    design, errors = placed(design_of(NAMED["v17: no errors, crank angle 0.1, linear"]["design"]))
    design = design.replace(stiffness=design.stiffness.replace(eccentric_bearing=np.array(1e11)))
    e, zc, zp, radius, count, torque = 1.3e-3, 17, 18, 32.9e-3, 6, -5.85
    angles = np.arange(25) * 2 * np.pi * 17 / 18 / 25
    found = [solve(design, errors, angle, torque, contact="linear") for angle in angles]
    across = [each.input_torque / e for each in found]
    np.testing.assert_allclose(across, -torque / (e * zc), rtol=1e-4)
    bearing = [np.hypot(*each.disc_bearing[0, 0]) for each in found]
    np.testing.assert_allclose(np.mean(bearing), 52.890 * abs(torque), rtol=2e-3)
    along = [np.sum(each.output_pins) for each in found]
    np.testing.assert_allclose(np.mean(along), 4 * abs(torque) / (np.pi * radius), rtol=2e-2)
    np.testing.assert_allclose(max(np.max(each.pins) for each in found), 4 * abs(torque) / (e * zc * zp), rtol=3e-2)
    np.testing.assert_allclose(
        max(np.max(each.output_pins) for each in found), 4 * abs(torque) / (count * radius), rtol=3e-2
    )
    pins, holes, eccentric = 4 / (40e6 * zp * (e * zc) ** 2), 4 / (60e6 * count * radius**2), 1 / (1e11 * (e * zc) ** 2)
    np.testing.assert_allclose(np.mean([each.error for each in found]), -torque * (pins + holes + eccentric), rtol=1e-2)
    back = solve(design, errors, 0.0, -torque, contact="linear")
    np.testing.assert_allclose(back.error, -found[0].error, rtol=1e-9)
    half = solve(design, errors, 0.0, torque / 2, contact="linear")
    np.testing.assert_allclose(half.pins, found[0].pins / 2, atol=1e-7 * np.max(half.pins))


@pytest.mark.long
@pytest.mark.parametrize(("eccentric_bearing", "size"), [(2e6, 5e-6), (1e11, 0.0)])
def test_extreme_drives_converge(eccentric_bearing, size):
    """59 lobes, three output pins, 1e-3 of the rated torque in 50 um of clearance; soft and rigid bearings."""
    given = NAMED["many59: no errors, rated, hertz"]["design"]
    design = design_of(given | {"output": given["output"] | {"count": 3, "hole_clearance": 100e-6}})
    design = design.replace(
        cycloid=design.cycloid.replace(equidistant_modification=50e-6),
        stiffness=design.stiffness.replace(eccentric_bearing=eccentric_bearing),
    )
    draw = np.random.default_rng(59)
    for angle in (0.0, 1.0, 40.0, 333.0):
        errors = drawn(draw, (2, 60, 59, 3), size)
        for torque in (2.93e-3, -2.93e-3, 0.0):
            found = solve(*placed(design, CycloidalErrors(**errors)), angle, torque)
            assert Status(int(found.info.status)) == (Status.CONVERGED if torque else Status.UNLOADED)
            if torque:
                expect = oracle.equilibrium(dictionaries(design), errors, input_angle=angle, output_torque=torque)
                np.testing.assert_allclose(found.error, expect["error"], rtol=1e-7)
                due = np.asarray(expect["output_pins"])
                np.testing.assert_allclose(found.output_pins, due, atol=1e-6 * np.max(due))


@pytest.mark.long
def test_float32_gives_the_same_to_its_rounding():
    given = c17()
    double = solve(*given)
    single = loaded.equilibrium(
        *jax.tree.map(np.float32, given), input_angle=np.float32(0.7), output_torque=np.float32(13.2)
    )
    assert single.error.dtype == np.float32 and succeeded(single.info.status)
    assert abs(float(single.error) - float(double.error)) < 1e-4 * abs(double.error) + 1e-8
    for field in ("pins", "output_pins", "disc_bearing"):
        due = np.asarray(getattr(double, field))
        np.testing.assert_allclose(getattr(single, field), due, atol=2e-3 * np.max(due))


def test_a_torque_that_the_ring_does_not_carry_is_unloaded():
    """Springs of 1e-8 of the rigid bearings hold the discs, 0.1 mm off the ring, while output pins press."""
    design, errors = placed(c17()[0])
    design = design.replace(
        stiffness=design.stiffness.replace(eccentric_bearing=np.asarray(1e11)),
        cycloid=design.cycloid.replace(equidistant_modification=np.asarray(1e-4)),
        output=design.output.replace(hole_clearance=np.asarray(0.0)),
    )
    for torque, due in ((1e-4, Status.UNLOADED), (1.0, Status.CONVERGED)):
        found = solve(design, errors, torque=torque)
        assert Status(int(found.info.status)) == due and np.max(found.output_pins) > 0
        assert np.any(found.pins) == (due == Status.CONVERGED)


def test_a_throw_longer_than_the_holes_allow_is_no_failure():
    """Every hole in its path presses; the fit without load says that the drive jams."""
    design, errors = c17(throw=np.array([150e-6, -150e-6]))
    found = solve(design, errors, torque=0.0)
    assert found.info.status == Status.CONVERGED and np.max(found.output_pins) > 100
    assert loaded.clearance(design, errors, samples=1).least < -20e-6


def test_conforming_holes_are_beyond_the_theory():
    """Half width of the contact above 0.3 of the radius of the pin, Eq. 11, and not before."""
    design, errors = placed(design_of(NAMED["c29: no errors, rated, hertz"]["design"]))
    room, pin, width = 1.25e-3 + 10e-6, 60e-3, 13.5e-3
    radius, plane = pin * (pin + room) / room, 2 * (1 - 0.3**2) / 206e9 / np.pi
    tight = design.replace(output=design.output.replace(pin_radius=np.array(pin)))

    def share(torque):
        found = solve(tight, errors, 0.3, torque)
        return Status(int(found.info.status)), np.sqrt(4 * np.max(found.output_pins) * radius * plane / width) / pin

    status, half = share(8e3)
    assert status == Status.CONVERGED and 0.27 < half < 0.3
    limit = 8e3 * (0.3 / half) ** 2  # force in proportion to the torque, nearly
    status, half = share(0.99 * limit)
    assert status == Status.CONVERGED and 0.295 < half < 0.3
    status, half = share(1.01 * limit)
    assert status == Status.CONTACT_OVERLOAD and np.isnan(half)


def test_batches_and_what_is_refused():
    design, errors = c17()
    throws = jnp.outer(jnp.linspace(-20e-6, 20e-6, 3), jnp.array([1.0, -1.0]))

    def error(throw):
        return solve(design, errors.replace(throw=throw)).error

    every, alone = jax.vmap(error)(throws), [error(np.asarray(t)) for t in throws]
    np.testing.assert_allclose(every, alone, rtol=1e-12)
    with pytest.raises(ValueError, match="sun = 'floating': a single-stage drive has none"):
        solve(design, CycloidalErrors(), sun="floating")
    with pytest.raises(ValueError, match="CycloidalErrors"):
        solve(design, RVErrors())


def test_pins_of_another_material_in_an_rv_reducer():
    """The same material written out changes nothing; softer pins: p^2/F falls with s1 + s2, as does the stiffness."""
    same = rv.contact.replace(pin_young_modulus=206e9, pin_poisson_ratio=0.3)
    for number in (material.plane, squared_pressure, lambda contact: material.level(contact, 0.02)):
        np.testing.assert_allclose(number(same), number(rv.contact), rtol=1e-14)
    soft = same.replace(pin_young_modulus=206e9 / 3)
    one, found = (solve(rv.replace(contact=contact), RVErrors(), 1.0, 400.0) for contact in (same, soft))
    pressed = np.asarray(found.pins) > 1
    ratio = np.asarray(found.pressure)[pressed] ** 2 / np.asarray(found.pins)[pressed]
    before = np.asarray(one.pressure)[pressed] ** 2 / np.asarray(one.pins)[pressed]
    np.testing.assert_allclose(ratio, before / 2, rtol=1e-9)  # s1 + s2: 2 -> 4
    assert found.stiffness < one.stiffness
