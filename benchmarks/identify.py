"""`rvjax.identify.solve_many` and SciPy: 1000 units of 40 errors, each from 500 observations, compilation included.

SciPy's `least_squares` gets the residuals and the Jacobian from JAX, compiled, and the prior as rows of its own; it
runs unit after unit on --reference units and its time is scaled. Optimistix joins where it can be imported.
"""

import argparse
import time
from pathlib import Path

from benchmarks.timing import publish, settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

from rvjax import identify  # noqa: E402  (after the flags)
from rvjax.tolerances import Tolerance  # noqa: E402

ELEMENTS, ROWS, NOISE = 40, 500, 0.5


def problem(units, seed):
    """A mildly curved model and the data of units.

    Args:
        units: how many.
        seed: of all numbers.
    """
    rng = np.random.default_rng(seed)
    slopes, bent = (jnp.asarray(rng.standard_normal((ROWS, ELEMENTS))) for _ in range(2))

    def model(values):
        return slopes @ values["x"] + 0.05 * (bent @ values["x"]) ** 2

    truth = rng.standard_normal((units, ELEMENTS))
    clean = jax.vmap(lambda x: model({"x": x}))(jnp.asarray(truth))
    return model, np.asarray(clean) + NOISE * rng.standard_normal((units, ROWS))


def reference(model, data):
    """Modes by SciPy's trust region, unit by unit; u (units, 40) and seconds, compilation included."""

    def residual(u, y):
        return jnp.concatenate([(model({"x": u}) - y) / NOISE, u])

    start = time.perf_counter()
    value, jacobian = jax.jit(residual), jax.jit(jax.jacfwd(residual))
    found = [
        least_squares(
            lambda u, y=y: np.asarray(value(u, y)),
            np.zeros(ELEMENTS),
            jac=lambda u, y=y: np.asarray(jacobian(u, y)),
            xtol=1e-10,
            ftol=1e-14,
            gtol=1e-10,
        ).x
        for y in data
    ]
    return np.array(found), time.perf_counter() - start


def optimistix_reference(model, data):
    """The same by Levenberg and Marquardt of Optimistix, all units in one program; None where it is missing."""
    try:
        import optimistix
    except ImportError:
        return None

    def residual(u, y):
        return jnp.concatenate([(model({"x": u}) - y) / NOISE, u])

    solver = optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10)

    def one(y):
        return optimistix.least_squares(residual, solver, jnp.zeros(ELEMENTS), y, max_steps=50, throw=False).value

    start = time.perf_counter()
    found = np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(data)))
    return found, time.perf_counter() - start


def main():
    """Print and publish the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--reference", type=int, default=50, help="units that SciPy solves")
    options = parser.parse_args()
    model, data = problem(options.units, seed=1)
    prior = {"x": Tolerance.symmetric(3.0, shape=(ELEMENTS,))}
    start = time.perf_counter()
    batch = identify.solve_many(model, prior, data, noise=identify.Noise(NOISE))
    first = time.perf_counter() - start
    start = time.perf_counter()
    identify.solve_many(model, prior, data, noise=identify.Noise(NOISE))
    second = time.perf_counter() - start
    some = data[: options.reference]
    u, seconds = reference(model, some)
    figures = {
        "units": options.units,
        "seconds, compilation included": first,
        "seconds again": second,
        "SciPy least_squares, seconds for as many": seconds * options.units / len(some),
        "largest difference from SciPy, sd": float(np.max(np.abs(u - batch.u[: len(some)]) / batch.u_sd[: len(some)])),
        "share solved": float(np.mean(np.asarray(batch.info.status) == 0)),
    }
    other = optimistix_reference(model, some)
    if other is not None:
        figures["Optimistix, seconds for as many"] = other[1] * options.units / len(some)
        distance = np.abs(other[0] - batch.u[: len(some)]) / batch.u_sd[: len(some)]
        figures["largest difference from Optimistix, sd"] = float(np.nanmax(distance))
    publish("identify", figures, options.json)


if __name__ == "__main__":
    main()
