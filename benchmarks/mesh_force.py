"""Mesh forces of CORR units: all forces, windup and status of every case, next to C, Numba, NumPy and SciPy.

Every case has errors of the cam and 26 roller radii, a torque of 10 to 100 % and an angle of its own (hertz,
float64). All contenders return the cam, cage and gear forces and the windup, compared before anything is timed. The
gradient is that of the mean peak gear force to three shared tolerances. `taskset -c 0` for the ratio on one core.
"""

import ctypes

import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

import jax  # noqa: E402  (after the flags)
import jax.numpy as jnp  # noqa: E402

from benchmarks.mesh_force_others import in_numba, in_numpy, source, with_scipy  # noqa: E402
from rvjax import CamRollerErrors, catalogue, mesh_force  # noqa: E402
from rvjax.published.corr import CALIBRATED_TORQUE  # noqa: E402

CASES, CHUNK, LOOP_CASES = 65_536, 1024, 3
CORR, ROLLERS = catalogue.CORR, 26
DESIGN = ["cam_radius", "roller_radius", "roller_length", "eccentricity", "young_modulus", "poisson_ratio", "cam_share"]


def draw(cases):
    """Errors of cam radius, eccentricity and roller radii, torques and angles."""
    rng = np.random.default_rng(0)
    return (
        rng.normal(size=cases) * 2e-6,
        rng.normal(size=cases) * 2e-6,
        rng.normal(size=(cases, ROLLERS)) * 1e-6,
        rng.uniform(0.1, 1, cases) * CALIBRATED_TORQUE,
        rng.uniform(0, 2 * np.pi, cases),
    )


def one(contact, cam, throw, radii, torque, angle):
    errors = CamRollerErrors(cam, throw, radii)
    return mesh_force.solve(CORR, errors, input_torque=torque, output_angle=angle, contact=contact)


def solve(contact, *columns):
    return jax.vmap(lambda *case: one(contact, *case))(*columns)


def mean_peak(tolerances, cam, throw, radii, torque, angle):
    """Mean over the batch of the largest gear force; each tolerance scales its error."""
    scaled = (tolerances[0] * cam, tolerances[1] * throw, tolerances[2] * radii, torque, angle)
    return jnp.mean(jnp.max(solve("hertz", *scaled).gear, axis=1))


def c_arrays(columns):
    """Inputs and outputs of the C program: a row of cases for each roller."""
    rows = [np.ascontiguousarray(column.T) for column in columns]
    return rows, [np.empty((ROLLERS, len(columns[0]))) for _ in range(3)] + [np.empty(len(columns[0]))]


def main():
    path = arguments(__doc__.splitlines()[0]).json
    columns = draw(CASES)
    on_device = jax.device_put(columns)
    design = np.array(
        [getattr(CORR, name) for name in DESIGN],
    )
    levels = {c: compiled(lambda *x, c=c: solve(c, *x), *on_device) for c in ("hertz", "linear", "palmgren")}
    run, notes = levels["hertz"]
    ones = jnp.ones(3)
    primal, _ = compiled(mean_peak, ones, *on_device)
    gradient, gradient_notes = compiled(jax.grad(mean_peak), ones, *on_device)

    expected = jax.tree.map(np.asarray, run(*on_device))
    size = expected.gear.max(1, keepdims=True)

    def compare(cam, cage, gear, windup, cases=slice(None)):
        for name, found in (("cam", cam), ("cage", cage), ("gear", gear)):
            assert np.abs((getattr(expected, name)[cases] - found) / size[cases]).max() < 1e-10, name
        np.testing.assert_allclose(windup, expected.windup[cases], rtol=1e-9)

    turn = 2 * np.pi * np.arange(ROLLERS) / ROLLERS
    outputs = [np.empty((CASES, ROLLERS)) for _ in range(3)] + [np.empty(CASES)]

    def numba_cases():
        in_numba(design, *columns, np.cos(turn), np.sin(turn), *outputs)

    def numpy_cases():
        return [in_numpy(design, *(c[k : k + CHUNK] for c in columns)) for k in range(0, 8 * CHUNK, CHUNK)]

    def scipy_cases():
        return [with_scipy(design, *(c[k] for c in columns)) for k in range(LOOP_CASES)]

    numba_cases()
    compare(*outputs)
    compare(*numpy_cases()[0], cases=slice(CHUNK))
    for k, (gear, windup) in enumerate(scipy_cases()):
        np.testing.assert_allclose(expected.gear[k], gear, atol=1e-8 * size[k, 0])
        np.testing.assert_allclose(expected.windup[k], windup, rtol=1e-9)
    candidates = {
        "rvjax, hertz": lambda: run(*on_device),
        "rvjax, linear": lambda: levels["linear"][0](*on_device),
        "rvjax, palmgren": lambda: levels["palmgren"][0](*on_device),
        "rvjax, mean peak": lambda: primal(ones, *on_device),
        "rvjax, gradient of the mean peak": lambda: gradient(ones, *on_device),
        "numba": numba_cases,
        "numpy": numpy_cases,
    }
    library = c_library(source(ROLLERS))
    if library is not None:
        peak = np.empty(CASES)
        rows, found = c_arrays(columns)
        *pointers, at_peak = [ctypes.c_void_p(array.ctypes.data) for array in (design, *rows, *found, peak)]

        def c_cases():
            library.solve(ctypes.c_long(CASES), *pointers, None)

        def c_peaks():
            library.solve(ctypes.c_long(CASES), *pointers, at_peak)
            return peak.mean()

        c_cases()
        compare(*(forces.T for forces in found[:3]), found[3])
        np.testing.assert_allclose(c_peaks(), primal(ones, *on_device), rtol=1e-10)
        candidates |= {"C": c_cases, "C, mean peak": c_peaks}
    best = alternate(candidates, seconds=1.0)
    best |= alternate({"scipy": scipy_cases}, rounds=2, seconds=0.1)
    cases = dict.fromkeys(best, CASES) | {"numpy": 8 * CHUNK, "scipy": LOOP_CASES}
    per_case = {name: 1e9 * seconds / cases[name] for name, seconds in best.items()}
    figures = {f"{name}, ns per case": value for name, value in per_case.items()}
    for name in ("C", "numba"):
        if name in best:
            figures[f"rvjax, hertz / {name}"] = per_case["rvjax, hertz"] / per_case[name]
    if library is not None:
        figures["rvjax / C, mean peak"] = per_case["rvjax, mean peak"] / per_case["C, mean peak"]
    for name in ("numpy", "scipy"):
        figures[f"{name} / rvjax, hertz"] = per_case[name] / per_case["rvjax, hertz"]
    figures["gradient / mean peak"] = best["rvjax, gradient of the mean peak"] / best["rvjax, mean peak"]
    figures |= {f"hertz, {name}": value for name, value in notes.items()}
    figures |= {f"gradient, {name}": value for name, value in gradient_notes.items()}
    figures["cases"] = CASES
    figures["not converged"] = int(np.count_nonzero(expected.info.status))
    figures["largest residual"] = float(expected.info.residual.max())
    publish("mesh_force", figures, path)


if __name__ == "__main__":
    main()
