"""Loaded equilibrium of RV-40E units, 2 x 40 pins, Hertz and linear: error and all pin forces of every unit and angle.

A batch of units with errors of every part at one angle under rated torque, at 3 % of it with all clearances, and over
a crank turn of 48 angles, each from those before. Next to the library run C (gcc -O3 -march=native -ffast-math, vectors
of units), Numba, NumPy over all units and SciPy's trust region unit by unit. All are compared with the oracle of
80-bit numbers before anything is timed. The gradient is that of the mean error to one shared tolerance a field.
Stiffnesses and face width are assumed. `taskset -c 0` for the ratio on one core.

Tried for the solver, and what it gave (steps per angle or unit, means; 2 x 40 pins):

    a turn on the line through two angles        linear 3.56 -> 3.14, hertz 4.20 -> 3.96: kept
    on the parabola through three                hertz 4.12: no better than the line
    load falling by stages from 30 or 1000 times cycles as before
    forces of journals as unknowns               3 % torque: more units than before need more than 12 steps
    dense elimination of the interior steps      18 of 437 kernels less, compiles no faster
    results of a step stored, sums in halves     linear 6 -> 3.8 times C, hertz 3 -> 2.1 with idle pins left out: kept
    blocks of 128 and 256 cases, refilled later  no difference beyond noise
    blurred contacts, not the interior method    kernels 399 -> 289, compiles in 9.5 of 14.1 s (busy computer); at 0.1 %
                                                 torque 2 of 65,536 units need more than 300 steps: not kept
    turn / cold turn of the C program, linear    0.70 (last angle as start); 0.58 here
    XLA's older generator of code                compiles in half to two thirds; hertz 2.0 -> 1.8 times C: kept
"""

import ctypes
import functools

import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

import jax  # noqa: E402  (after the flags)
import jax.numpy as jnp  # noqa: E402

from benchmarks.loaded_numba import in_numba  # noqa: E402
from benchmarks.loaded_others import COLUMNS, FIELDS, OFFSETS, in_numpy, numbers, source  # noqa: E402
from oracles import loaded as oracle  # noqa: E402
from oracles.loaded_machine import STAGES  # noqa: E402
from rvjax import RVErrors, catalogue, loaded  # noqa: E402
from rvjax._jax.programs import QUICK  # noqa: E402
from rvjax.loaded.cases import MACHINE  # noqa: E402

UNITS, TURNED, CHECKED, LOOP_UNITS = 4096, 512, 8, 2  # at one angle; along a turn; by the oracle; by SciPy
RATED, ANGLE, SAMPLES = 412.0, 102.856, 48
TURN = 2 * np.pi * 105 / 40 * np.arange(SAMPLES) / SAMPLES  # of the sun: one crank turn
DESIGN = catalogue.RV_40E.replace(
    stiffness=MACHINE.stiffness.replace(output_support=2e9),
    contact=MACHINE.contact,
)


def draw(units, seed=0):
    """Columns (rows, units): errors of 2 um, play everywhere."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(COLUMNS, units)) * 2e-6
    rows = {name: slice(first, first + int(np.prod(FIELDS[name]))) for name, first in OFFSETS.items()}
    x[rows["crank_phase"]] *= 25
    x[rows["pin_radii"]] *= 0.25
    for name, value in (("bearing_clearance", 2e-6), ("support_clearance", 0.5e-6), ("base_tangent_upper", -8e-6),
                        ("equidistant_modification", 3e-6)):  # fmt: skip
        x[rows[name]] = value * rng.uniform(0.5, 1.5, units)
    return x


def fields(x):
    """Columns by field, the units last."""
    return {n: x[first : first + int(np.prod(FIELDS[n]))].reshape(*FIELDS[n], -1) for n, first in OFFSETS.items()}


def one(contact, torque, errors, angle=ANGLE):
    """Error, pin forces and status of one unit."""
    found = loaded.equilibrium(
        DESIGN, RVErrors.for_design(DESIGN, **errors), input_angle=angle, output_torque=torque, contact=contact
    )
    return found.error, found.pins, found.info.status


def units_at(contact, torque, errors):
    """Error, pin forces and status of all units under one torque."""
    return jax.vmap(functools.partial(one, contact, torque), in_axes=-1)(errors)


def mean(contact, tolerances, errors):
    """Mean error over the batch; each tolerance scales the errors of its field."""
    return jnp.mean(units_at(contact, RATED, {name: tolerances[name] * errors[name] for name in errors})[0])


def turn(contact, errors):
    """Every unit over a crank turn, each angle from the one before."""

    def unit(errors):
        found = loaded.revolution(
            DESIGN, RVErrors.for_design(DESIGN, **errors), output_torque=RATED, samples=SAMPLES, contact=contact
        )
        return found.error, found.info.status

    return jax.vmap(unit, in_axes=-1)(errors)


def turn_cold(contact, errors):
    """The same, every angle for itself."""

    def unit(errors):
        found = jax.vmap(lambda angle: one(contact, RATED, errors, angle))(jnp.asarray(TURN))
        return found[0], found[2]

    return jax.vmap(unit, in_axes=-1)(errors)


def in_c(library, x, angles, torque, contact, warm=False):
    """A function that runs the C program, and its outputs: error (angles, units), pins, steps."""
    x, units, design = np.ascontiguousarray(x), x.shape[1], numbers(plain(), torque, contact)
    angles = np.ascontiguousarray(angles, float)
    outputs = (
        np.empty((len(angles), units)),
        np.empty((len(angles), 80, units)),
        np.empty((len(angles), units), np.int64),
    )
    at = [ctypes.c_void_p(array.ctypes.data) for array in (angles, x, design, *outputs)]
    flags = [ctypes.c_long(int(flag)) for flag in (contact == "hertz", warm, 12)]

    def run(held=(angles, x, design)):  # whose addresses are given
        library.solve(ctypes.c_long(units), ctypes.c_long(len(angles)), *at[:3], *flags, *at[3:])

    return run, outputs


def plain():
    """The design as numbers, for the others."""
    return {stage: {n: getattr(getattr(DESIGN, stage), n) for n in names} for stage, names in STAGES.items()}


def judged(x, contact, torque, error, pins):
    """Compare the first units with the oracle: what its rule to stop leaves of each, times ten."""
    part = {name: np.moveaxis(value, -1, 0) for name, value in fields(x[:, :CHECKED]).items()}
    due = oracle.equilibria(DESIGN, part, CHECKED, input_angle=ANGLE, output_torque=torque, contact=contact)
    assert (due["residual"] < 1e-14).all()
    off = np.abs(error[:CHECKED] - due["error"]) - 10 * due["error_allowed"]
    assert (off < 1e-11 * np.abs(due["error"])).all(), off
    force = np.abs(np.asarray(pins)[:CHECKED].reshape(CHECKED, 80) - due["pins"].reshape(CHECKED, 80)).max(1)
    assert (force < 10 * due["force_allowed"] + 1e-9 * due["largest"]).all(), force


def figures_of(contact, library):
    """All statistics of one contact law."""
    x = draw(UNITS)
    errors = jax.device_put(fields(x))
    light, design = 0.03 * RATED, numbers(plain(), RATED, contact)
    built = functools.partial(compiled, options=QUICK)  # as studies do
    program, notes = built(functools.partial(units_at, contact), jnp.asarray(RATED), errors)
    torques = {torque: jnp.asarray(torque) for torque in (RATED, light)}  # one program for both
    few = jax.device_put(fields(x[:, :TURNED]))
    around, around_notes = built(functools.partial(turn, contact), few)
    cold, _ = built(functools.partial(turn_cold, contact), few)
    ones = {name: jnp.ones(()) for name in FIELDS}
    primal, _ = built(functools.partial(mean, contact), ones, errors)
    gradient, gradient_notes = built(jax.value_and_grad(functools.partial(mean, contact)), ones, errors)

    failed = {}
    for torque, given in torques.items():
        error, pins, status = program(given, errors)
        failed[f"not converged at {torque:.4g} N m"] = int(np.count_nonzero(status))
        judged(x, contact, torque, np.asarray(error), pins)
    for other in (in_numpy, in_numba):
        judged(x, contact, RATED, *other(design, ANGLE, x, contact))
    along, each = around(few)[0], cold(few)[0]
    np.testing.assert_allclose(along, each, rtol=0, atol=1e-9 * float(jnp.abs(each).max()))
    candidates = {
        "rvjax": lambda: program(torques[RATED], errors),
        "rvjax, 3 %": lambda: program(torques[light], errors),
        "mean": lambda: primal(ones, errors),
        "gradient": lambda: gradient(ones, errors),
        "numba": lambda: in_numba(design, ANGLE, x, contact),
    }
    slow = {
        "rvjax, turn": lambda: around(few),
        "rvjax, turn cold": lambda: cold(few),
        "numpy": lambda: in_numpy(design, ANGLE, x, contact),
    }
    if library is not None:
        runs = {
            "C": in_c(library, x, [ANGLE], RATED, contact),
            "C, 3 %": in_c(library, x, [ANGLE], light, contact),
            "C, turn": in_c(library, x[:, :TURNED], TURN, RATED, contact, warm=True),
            "C, turn cold": in_c(library, x[:, :TURNED], TURN, RATED, contact),
        }
        for name, (run, outputs) in runs.items():
            run()
            if "turn" in name:
                np.testing.assert_allclose(outputs[0].T, each, rtol=0, atol=1e-9 * float(jnp.abs(each).max()))
            else:
                judged(x, contact, light if "%" in name else RATED, outputs[0][0], outputs[1][0].T)
                failed[f"{name}: not converged"] = int(np.isnan(outputs[0]).sum())
            failed[f"{name}: steps, mean"] = float(outputs[2].mean())
            (slow if "turn" in name else candidates)[name] = run
    best = alternate(candidates, seconds=0.5) | alternate(slow, rounds=3, seconds=0.5)

    part = {name: value[..., 0] for name, value in fields(x).items()}
    machine = oracle.Machine(
        oracle.read(DESIGN, part, input_angle=ANGLE, output_torque=RATED, contact=contact)
    )  # fmt: skip
    best |= alternate(
        {"scipy": lambda: [oracle.trust_exact(machine) for _ in range(LOOP_UNITS)]}, rounds=2, seconds=0.1
    )
    many = (
        dict.fromkeys(best, UNITS) | {name: TURNED * SAMPLES for name in best if "turn" in name} | {"scipy": LOOP_UNITS}
    )
    each_us = {name: 1e6 * seconds / many[name] for name, seconds in best.items()}
    figures = {f"{name}, us per unit and angle": value for name, value in each_us.items()}
    for name in ("", ", 3 %", ", turn", ", turn cold"):
        if f"C{name}" in best:
            figures[f"rvjax{name} / C{name}"] = best[f"rvjax{name}"] / best[f"C{name}"]
    figures["rvjax / numba"] = each_us["rvjax"] / each_us["numba"]
    figures |= {f"{name} / rvjax": each_us[name] / each_us["rvjax"] for name in ("numpy", "scipy")}
    figures["3 % / rated"] = best["rvjax, 3 %"] / best["rvjax"]
    figures["turn / cold turn"] = best["rvjax, turn"] / best["rvjax, turn cold"]
    figures["gradient / mean"] = best["gradient"] / best["mean"]
    parts = {"": notes, "gradient, ": gradient_notes, "turn, ": around_notes}
    figures |= {f"{name}{key}": value for name, own in parts.items() for key, value in own.items()}
    return {f"{contact}: {name}": value for name, value in (figures | failed).items()}


def main():
    path = arguments(__doc__.splitlines()[0]).json
    library = c_library(source())
    figures = {"units": UNITS, "units along a turn": TURNED, "angles of a turn": SAMPLES}
    for contact in ("hertz", "linear"):
        figures |= figures_of(contact, library)
    publish("loaded", figures, path)


if __name__ == "__main__":
    main()
