"""Reference cases of friction as designs, errors and frictions of one shape and type each: few programs compile."""

import functools
import json
from pathlib import Path

import cycloidal_cases
import jax
import jax.numpy as jnp
import loaded_cases
import numpy as np

import rvjax
from rvjax import Bearings, CycloidalErrors, Friction, Inertia, RollerBearing, running
from rvjax.loaded import unchecked

CASES = json.loads((Path(__file__).parent / "reference" / "running.json").read_text())["cases"]
NAMED = {case["name"]: case for case in CASES}
TOGETHER = (
    *("rv40: no errors, forward", "rv40: no errors, the output drives", "rv40: all errors and shares"),
    *("rv40: no torque, no errors", "rv40: tight pins, no torque", "rv40: bad number in the errors"),
)  # losses of one layout
FUNCTIONS = {
    "losses": running.losses,
    "single": running.losses,
    "back_driving": running.back_driving,
    "hysteresis": running.hysteresis,
    "joint": running.joint,
}


def unit_of(case):
    """Design and errors of a case."""
    given, single = case["design"], case["kind"] == "single"
    parts = {}
    if "bearings" in given:
        numbers = dict(given["bearings"])
        rollers = {name: RollerBearing(**numbers.pop(name)) for name in ("arm", "support") if numbers.get(name)}
        rest = {name: loaded_cases.number(value) for name, value in numbers.items() if value is not None}
        parts["bearings"] = Bearings(**rollers, **rest)
    if "inertia" in given:
        parts["inertia"] = Inertia(**{name: loaded_cases.number(value) for name, value in given["inertia"].items()})
    if single:
        design = cycloidal_cases.design_of(given).replace(**parts)
        errors = CycloidalErrors(
            **{name: np.asarray(v, float) if np.ndim(v) else v for name, v in case["errors"].items()}
        )
        return loaded_cases.plain((design, CycloidalErrors.for_design(design, **vars(errors))))
    design = loaded_cases.design_of({"design": given}, **parts)
    return loaded_cases.plain((design, loaded_cases.errors_of(case, design)))


def friction_of(case):
    return loaded_cases.plain(Friction(**case["friction"]))


def solved(case, **changes):
    """The function of a case with its options, or others."""
    design, errors = unit_of(case)
    options = {name: float(v) if type(v) is int and name != "samples" else v for name, v in case["options"].items()}
    if case["name"] in TOGETHER:
        options |= changes
        return losses(options["samples"], (design, errors, friction_of(case), options))[0]
    with loaded_cases.newton_alone():
        return FUNCTIONS[case["kind"]](design, errors, friction_of(case), **(options | changes))


def assert_agrees(found, expect, rtol):
    """Every field of a case; NaN where it failed."""
    status = rvjax.Status(int(found.info.status)).name
    assert status == expect["status"], status
    if len(expect) == 1:
        values = {name: x for name, x in vars(found).items() if name not in ("info", "self_locking", "ratio")}
        assert all(np.isnan(x) for x in jax.tree.leaves(values))
    for name, value in expect.items():
        if name == "status":
            continue
        if value is None:
            assert getattr(found, name) is None, name
        else:
            size = max(abs(expect.get("loss_torque", 0.0)), abs(value)) if np.isfinite(value) else 0.0
            np.testing.assert_allclose(getattr(found, name), value, rtol=rtol, atol=1e-9 * size, err_msg=name)


def moved(amount, design, errors, friction, options):
    """Unit and options with many of their numbers moved by shares of an amount."""
    cycloid, springs, bearings = design.cycloid, design.stiffness, design.bearings
    design = design.replace(
        cycloid=unchecked(
            cycloid,
            eccentricity=cycloid.eccentricity * (1 + 1e-3 * amount),
            pin_radius=cycloid.pin_radius * (1 - amount),
        ),
        stiffness=springs.replace(turning_arm_bearing=springs.turning_arm_bearing * (1 + 0.7 * amount)),
        contact=design.contact.replace(young_modulus=design.contact.young_modulus * (1 + 0.4 * amount)),
        bearings=unchecked(
            bearings,
            arm=unchecked(bearings.arm, pitch_diameter=bearings.arm.pitch_diameter * (1 + 0.3 * amount)),
            support_span=bearings.support_span * (1 + amount),
        ),
    )
    errors = unchecked(
        errors,
        pin_radius=errors.pin_radius + 1e-6 * amount,
        disc_bore=errors.disc_bore * (1 - amount),
        ring_pin_friction=errors.ring_pin_friction + 0.2 * amount,
        drag_friction=errors.drag_friction - amount,
    )
    friction = unchecked(
        friction,
        gear_meshes=friction.gear_meshes * (1 + 2 * amount),
        output_drag=friction.output_drag * (1 + amount),
        static_factor=friction.static_factor * (1 + 0.5 * amount),
        support_bearings=friction.support_bearings * (1 - 2 * amount),
    )
    shares = dict(output_torque=0.3, output_speed=-1.0, rated_torque=0.3, input_angle=1e-3)
    options = options | {
        name: options[name] * (1 + share * amount) for name, share in shares.items() if name in options
    }
    return design, errors, friction, options


def floating(found):
    """Its numbers as one array."""
    kept = {name: x for name, x in vars(found).items() if name not in ("info", "self_locking") and x is not None}
    return jnp.stack([jnp.asarray(x) for x in kept.values()])


def shifted(kind, samples, amount, *unit):
    """Results of a function for a moved unit."""
    *parts, options = moved(amount, *unit)
    with loaded_cases.newton_alone():
        return FUNCTIONS[kind](*parts, **({} if samples is None else dict(samples=samples)), **options)


def along(kind, samples, amount, *unit):
    """The same, and the slopes of its numbers by the amount."""

    def at(amount):
        found = shifted(kind, samples, amount, *unit)
        return floating(found), found

    _, slope, found = jax.jvp(at, (amount,), (jnp.ones_like(amount),), has_aux=True)
    return found, slope


ALONG = jax.jit(along, static_argnums=(0, 1))


def numbers(options):
    return loaded_cases.plain({name: float(value) for name, value in options.items() if name != "samples"})


def arguments(case, amount):
    """Of `along`."""
    options = case["options"]
    unit = (*unit_of(case), friction_of(case), numbers(options))
    return case["kind"], options.get("samples"), np.float64(amount), *unit


LANES = 11


@functools.cache
def _lanes(samples):
    return jax.jit(jax.vmap(functools.partial(along, "losses", samples)))


def losses_and_slopes(samples, cases, amounts=0.0):
    """Losses of up to eleven cases (design, errors, friction, options) of one layout, and slopes, by one program."""
    alike = loaded_cases.plain([(*unit, numbers(options)) for *unit, options in cases])
    alike += alike[-1:] * (LANES - len(cases))
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *alike)
    return jax.device_get(_lanes(samples)(np.broadcast_to(amounts, LANES), *stacked))


def losses(samples, *cases):
    """Losses of each of up to eleven cases."""
    found, _ = losses_and_slopes(samples, cases)
    return [loaded_cases.at(found, k) for k in range(len(cases))]
