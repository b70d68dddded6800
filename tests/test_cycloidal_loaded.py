"""The loaded model of single-stage drives: reference cases, an independent model, invariants, extremes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cycloidal_cases import CASES, NAMED, design_of, dictionaries, drawn, errors_of

from oracles import cycloidal as oracle
from rvjax import CycloidalErrors, RVErrors, catalogue, loaded
from rvjax.catalogue import RV_40E_WHOLE as rv
from rvjax.status import Status, succeeded

EQUILIBRIA = [case["name"] for case in CASES if case["kind"] == "equilibrium"]
FORCES = ("pins", "output_pins", "disc_bearing", "support_bearing", "output_bearing", "disc_torque")


@functools.cache
def solved(name):
    case = NAMED[name]
    errors = unchecked(CycloidalErrors(), {n: np.asarray(v) if np.ndim(v) else v for n, v in case["errors"].items()})
    return getattr(loaded, case["kind"])(drive_of(case["design"]), errors, **case["options"])


def drive_of(given):
    """The drive of nested dictionaries; numbers that a constructor refuses come from a traced computation."""
    try:
        return design_of(given)
    except ValueError:
        possible = {"eccentricity": 1e-6, "pin_radius": 1e-6}
        drive = design_of(
            given | {"cycloid": given["cycloid"] | possible, "output": given["output"] | {"hole_clearance": 0}}
        )
        return unchecked(drive, {part: unchecked(getattr(drive, part), given[part]) for part in ("cycloid", "output")})


def unchecked(record, numbers):
    copy = jax.tree.map(lambda leaf: leaf, record)
    for name, value in numbers.items():
        object.__setattr__(copy, name, value)
    return copy


@pytest.mark.parametrize("name", EQUILIBRIA)
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


@pytest.mark.parametrize("name", [c["name"] for c in CASES if c["kind"] in ("torsion", "revolution", "clearance")])
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
    design, errors = drive_of(case["design"]), errors_of(case["errors"])
    error = lambda whole: (
        loaded.equilibrium(whole["design"], whole["errors"], **(case["options"] | whole["options"])).error
    )
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


@pytest.mark.parametrize("contact", ["hertz", "linear", "palmgren"])
@pytest.mark.parametrize("member", ["carrier", "ring"])
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


def test_either_member_is_the_same_machine():
    """T_ring = -T_c zp/zc at the same turn of carrier and ring: identical forces, error and stiffness as Eqs. 4, 14."""
    carrier = catalogue.CYCLOIDAL_17
    zc, zp = 17, 18
    ring = carrier.replace(member="ring")
    angle, torque = 0.9, 6.0
    one = loaded.equilibrium(carrier, CycloidalErrors(), input_angle=angle * zc, output_torque=torque)
    other = loaded.equilibrium(ring, CycloidalErrors(), input_angle=angle * zp, output_torque=-torque * zp / zc)
    np.testing.assert_allclose(one.pins, other.pins, atol=1e-9)
    np.testing.assert_allclose(other.error, -zc / zp * one.error, rtol=1e-12)
    np.testing.assert_allclose(other.stiffness, (zp / zc) ** 2 * one.stiffness, rtol=1e-9)
    np.testing.assert_allclose(one.input_torque, torque / -zc, rtol=1e-6)
    np.testing.assert_allclose(other.input_torque, -torque * zp / zc / zp, rtol=1e-6)
    np.testing.assert_allclose(np.sum(one.disc_torque), torque, rtol=1e-6)


def test_conforming_holes_are_beyond_the_theory():
    design = catalogue.CYCLOIDAL_29
    tight = design.replace(output=design.output.replace(pin_radius=60e-3))
    found = loaded.equilibrium(tight, CycloidalErrors(), input_angle=0.3, output_torque=116e3)
    assert int(found.info.status) == Status.CONTACT_OVERLOAD
    assert np.isnan(found.error) and np.isnan(found.output_pins).all()


def test_batches_and_a_floating_sun():
    design = catalogue.CYCLOIDAL_15
    throws = jnp.outer(jnp.linspace(-20e-6, 20e-6, 5), jnp.array([1.0, -1.0]))
    error = lambda t: (
        loaded.equilibrium(  # noqa: E731
            design, CycloidalErrors(throw=t), input_angle=1.0, output_torque=5.0
        ).error
    )
    every, alone = jax.vmap(error)(throws), [error(t) for t in throws]
    np.testing.assert_allclose(every, alone, rtol=1e-12)
    with pytest.raises(ValueError, match="sun = 'floating': a single-stage drive has none"):
        loaded.equilibrium(design, CycloidalErrors(), input_angle=1.0, output_torque=5.0, sun="floating")
    with pytest.raises(ValueError, match="CycloidalErrors"):
        loaded.equilibrium(design, RVErrors(), input_angle=1.0, output_torque=5.0)


def test_pins_of_another_material_in_an_rv_reducer():
    """The same material written out changes nothing; softer pins: p^2/F falls with s1 + s2, and so does the stiffness."""
    design = rv.replace(contact=rv.contact.replace(pin_young_modulus=206e9, pin_poisson_ratio=0.3))
    one, other = (loaded.equilibrium(d, RVErrors(), input_angle=1.0, output_torque=400.0) for d in (rv, design))
    np.testing.assert_allclose(other.pins, one.pins, rtol=1e-10)
    np.testing.assert_allclose(other.pressure, one.pressure, rtol=1e-10)
    soft = rv.replace(contact=rv.contact.replace(pin_young_modulus=206e9 / 3, pin_poisson_ratio=0.3))
    found = loaded.equilibrium(soft, RVErrors(), input_angle=1.0, output_torque=400.0)
    pressed = np.asarray(found.pins) > 1
    ratio = np.asarray(found.pressure)[pressed] ** 2 / np.asarray(found.pins)[pressed]
    same = np.asarray(one.pressure)[pressed] ** 2 / np.asarray(one.pins)[pressed]
    np.testing.assert_allclose(ratio, same / 2, rtol=1e-9)  # s1 + s2: 2 -> 4
    assert found.stiffness < one.stiffness
