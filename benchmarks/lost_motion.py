"""Lost motion: ten million units of the consistent sum next to NumPy and C, and the cost of the three levels.

Every contender reads twelve errors of every unit and returns one angle; the mean over all units represents the use
in statistics. Results are compared before anything is timed. One core: `taskset -c 0 python -m benchmarks.lost_motion`.
"""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

from rvjax import RVErrors  # noqa: E402  (after the flags)
from rvjax.catalogue import RV_20E  # noqa: E402
from rvjax.errors import read_by  # noqa: E402
from rvjax.lost_motion import geometric  # noqa: E402
from rvjax.units import arcmin, um  # noqa: E402

READ = read_by(RVErrors, "lost_motion")
UNITS, CHUNK = 10_000_000, 50_000
LEVELS = ("first_order", "closed_form", "contact")
DESIGN = RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=None))

# Table 9 of Liu et al. 2022: errors of either sign, and those that are never negative.
SIGNED = dict(pin_circle_radius=10, pin_radius=4, eccentricity=5, equidistant_modification=1, shift_modification=3)
POSITIVE = dict(disc_runout=15, disc_cumulative_pitch=19, pin_hole_clearance=5, bearing_clearance=1, pin_position=0)

SOURCE = r"""
#include <stddef.h>
/* e: twelve rows of n errors; c: one design. As the Python below, coefficients once, then one sum per unit. */
void totals(const double *restrict e, double *restrict total, size_t n, const double *restrict c) {
    #pragma omp parallel for simd schedule(static)
    for (size_t k = 0; k < n; k++) {
        double t = c[12];
        for (int i = 0; i < 12; i++) t += c[i] * e[(size_t)i * n + k];
        total[k] = t;
    }
}
"""


def draw(units, seed):
    """(12, units) errors, uniform in the bands, in the order of READ."""
    rng = np.random.default_rng(seed)
    rows = {name: rng.uniform(-band * um, band * um, units) for name, band in SIGNED.items()}
    rows |= {name: rng.uniform(0, band * um, units) for name, band in POSITIVE.items()}
    rows |= dict.fromkeys(("base_tangent_upper", "base_tangent_lower"), rng.uniform(-30.9 * um, 3.5 * um, units))
    return np.stack([rows[name] for name in READ])


def columns(errors):
    """The rows by name: a row taken out inside the program would cost a padded copy in its derivative."""
    return {name: jax.device_put(row) for name, row in zip(READ, errors)}


def lost_motion(errors, profile="first_order"):
    return geometric(DESIGN, RVErrors(**errors), profile=profile)


def coefficients():
    """The sum as C and NumPy need it: it is linear in the errors."""
    constant, slope = jax.value_and_grad(lambda e: lost_motion(e).total)(dict.fromkeys(READ, 0.0))
    return np.array([*(slope[name] for name in READ), constant])


def totals(errors):
    return jax.vmap(lambda e: lost_motion(e).total)(errors)


def measure_sum():
    """Ten million units in chunks: C, NumPy, the library, and the gradient of the mean to twelve shared widths."""
    chunks = [draw(CHUNK, seed) for seed in range(4)]  # in turn; all sampled before the clock starts
    repeats = UNITS // CHUNK
    on_device = [columns(chunk) for chunk in chunks]
    linear = coefficients()

    def plain_mean(errors, widths):
        return jnp.mean(totals({name: errors[name] * widths[name] for name in errors}))

    widths = dict.fromkeys(READ, jnp.ones(()))
    each, facts = compiled(totals, on_device[0])
    mean, _ = compiled(plain_mean, on_device[0], widths)
    gradient, _ = compiled(jax.grad(plain_mean, argnums=1), on_device[0], widths)
    library = c_library(SOURCE)

    def numpy_totals(errors):
        return linear[:12] @ errors + linear[12]

    space = np.empty(CHUNK)
    if library is not None:
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (*chunks, space, linear)]

        def c_totals(k):
            return library.totals(pointers[k], pointers[-2], ctypes.c_size_t(CHUNK), pointers[-1])

    reference = numpy_totals(chunks[0])
    np.testing.assert_allclose(each(on_device[0]), reference, rtol=1e-12, atol=1e-16)
    if library is not None:
        c_totals(0)
        np.testing.assert_allclose(space, reference, rtol=1e-12, atol=1e-16)

    def run(step):
        return lambda: [step(k % len(chunks)) for k in range(repeats)][-1]

    candidates = {
        "rvjax, every unit": run(lambda k: each(on_device[k])),
        "rvjax, mean": run(lambda k: mean(on_device[k], widths)),
        "rvjax, gradient of the mean": run(lambda k: gradient(on_device[k], widths)),
        "numpy": run(lambda k: numpy_totals(chunks[k])),
    }
    if library is not None:
        candidates["C"] = run(c_totals)
    best = alternate(candidates, rounds=5, seconds=1.0)
    figures = {f"{name}, ns per unit": seconds / UNITS * 1e9 for name, seconds in best.items()}
    figures["gradient / mean"] = best["rvjax, gradient of the mean"] / best["rvjax, mean"]
    figures["numpy / rvjax"] = best["numpy"] / best["rvjax, every unit"]
    if library is not None:
        figures["rvjax / C"] = best["rvjax, every unit"] / best["C"]
    return figures | {f"sum, {name}": value for name, value in facts.items()}


def measure_levels():
    """Difference of the three levels from exact contact, and their cost, on one chunk with K1 derived."""
    errors = columns(draw(CHUNK, 9))
    figures, runs, results = {}, {}, {}
    for level in LEVELS:

        def batch(e, level=level):
            result = jax.vmap(lambda x: lost_motion(x, level))(e)
            return result.total, result.valid

        program, facts = compiled(batch, errors)
        runs[level] = lambda program=program: program(errors)
        results[level] = [np.asarray(leaf) for leaf in program(errors)]
        figures[f"{level}, compile_s"] = facts["compile_s"]
    exact, valid = results["contact"]
    figures["share not assemblable"] = float(1 - valid.mean())
    for level in LEVELS[:2]:
        error = (results[level][0] - exact)[valid] / arcmin
        figures[f"{level}, rms error, arcmin"] = float(np.sqrt(np.mean(error**2)))
        figures[f"{level}, largest error, arcmin"] = float(np.abs(error).max())
    for level, seconds in alternate(runs, rounds=10, seconds=0.5).items():
        figures[f"{level}, ns per unit"] = seconds / CHUNK * 1e9
    return figures


if __name__ == "__main__":
    options = arguments(__doc__)
    publish("lost_motion", measure_sum() | measure_levels(), options.json)
