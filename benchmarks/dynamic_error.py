"""Dynamic transmission error of a batch: peak of every line over 40 speeds, units x 40 speeds x 3 orders.

The joint of the embedded study, 36 errors a unit, orders 40, 78 and 80 per output turn. rvjax uses the public
function, `jax.vmap(speed_sweep)` over errors, in chunks, with its transfer. NumPy and C (gcc -O3 -march=native
-ffast-math, on one thread and on all) are given the sensitivities and the transfer and do what is left, the same
algorithm: excitation of every order from the errors, lines at every speed from the excitation, the largest of each.
"""

import argparse
import ctypes
import functools
import os
from pathlib import Path

from benchmarks import timing

timing.settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from rvjax import RVErrors, dynamics, study  # noqa: E402

CHUNK, SPEEDS, SPRINGS, ORDERS = 4096, 40, 8, (40.0, 78.0, 80.0)
SHAPES = {
    "crank_eccentricity": (2, 2), "disc_bore": (2, 2, 2), "disc_centre": (2, 2), "planet_runout": (2, 2),
    "disc_flank": (2, 2, 2), "ring_flank": (2, 2), "sun_runout": (2,), "ring_centre": (2,),
}  # fmt: skip

C_SOURCE = r"""
#include <math.h>
/* x (units, errors); xr, xi (orders, 8, errors); tr, ti (orders, 8, speeds); peak (units, orders) */
void peaks(long units, int errors, int orders, int speeds, int threads, const double *x, const double *xr,
           const double *xi, const double *tr, const double *ti, double *peak) {
  #pragma omp parallel for schedule(static) num_threads(threads)
  for (long u = 0; u < units; u++) for (int k = 0; k < orders; k++) {
    double br[64] = {0}, bi[64] = {0}, largest = 0;
    for (int s = 0; s < 8; s++) {
      const double *a = xr + (k * 8 + s) * errors, *b = xi + (k * 8 + s) * errors, *own = x + u * errors;
      double gr = 0, gi = 0;
      for (int e = 0; e < errors; e++) { gr += a[e] * own[e]; gi += b[e] * own[e]; }
      const double *c = tr + (k * 8 + s) * speeds, *d = ti + (k * 8 + s) * speeds;
      for (int q = 0; q < speeds; q++) { br[q] += c[q] * gr - d[q] * gi; bi[q] += c[q] * gi + d[q] * gr; }
    }
    for (int q = 0; q < speeds; q++) {
      double size = br[q] * br[q] + bi[q] * bi[q];
      largest = size > largest ? size : largest;
    }
    peak[u * orders + k] = sqrt(largest);
  }
}
"""


def unpacked(x):
    """Errors of one unit from its row of numbers."""
    ends = np.cumsum([int(np.prod(shape)) for shape in SHAPES.values()])[:-1]
    return RVErrors(**{name: part.reshape(s) for (name, s), part in zip(SHAPES.items(), jnp.split(x, ends))})


@functools.cache
def asked():
    """Design, conditions and speeds of the sun; first called outside a trace, where a study can be read."""
    question = study.load("rv-40e-joint")
    given = question.conditions
    return question.design, given, np.linspace(given.slowest_sun_speed, given.fastest_sun_speed, SPEEDS)


def peaks(design, chunks):
    """Peaks (chunks, units, orders) of the errors of units (chunks, units, errors), chunk by chunk."""
    _, given, speeds = asked()

    def one(design, x):
        return dynamics.speed_sweep(design, unpacked(x), sun_speeds=speeds, load_inertia=given.load_inertia).peak[:, 0]

    return jax.lax.map(lambda chunk: jax.vmap(one, (None, 0))(design, chunk), chunks)


def contenders(units: int) -> tuple[dict, tuple]:
    """Contenders by name: each returns the peaks (units, orders) of the same random errors. Also the compiled program
    of the library, and the arguments of `peaks`."""
    design, given, speeds = asked()
    errors = int(sum(np.prod(shape) for shape in SHAPES.values()))
    x = 1e-6 * np.random.default_rng(0).normal(size=(units, errors))

    arguments = (jax.tree.map(jnp.asarray, design), jnp.asarray(x).reshape(-1, CHUNK, errors))
    program, compiled = timing.compiled(peaks, *arguments)

    zero = jnp.zeros(errors)
    assert tuple(dynamics.error_excitation(design, unpacked(zero)).order.tolist()) == ORDERS
    slopes = np.asarray(jax.jacfwd(lambda x: dynamics.error_excitation(design, unpacked(x)).amplitude)(zero))
    hertz = np.outer(ORDERS, speeds) / design.ratio / (2 * np.pi)
    carried = jax.vmap(lambda f: dynamics.error_transfer(design, frequency=f, load_inertia=given.load_inertia)[0])
    transfer = np.asarray(carried(hertz.ravel())).reshape(*hertz.shape, SPRINGS)

    def plain():
        peak = np.empty((units, len(ORDERS)))
        for start in range(0, units, CHUNK):
            rows = x[start : start + CHUNK]
            for k in range(len(ORDERS)):
                lines = (rows @ slopes[k].T) @ transfer[k].T
                peak[start : start + CHUNK, k] = np.sqrt(np.max(lines.real**2 + lines.imag**2, axis=1))
        return peak

    found = {"rvjax": lambda: program(*arguments).reshape(units, -1), "NumPy": plain}
    library = timing.c_library(C_SOURCE)
    if library is not None:
        along = np.swapaxes(transfer, 1, 2)
        tables = [np.ascontiguousarray(part) for part in (slopes.real, slopes.imag, along.real, along.imag)]

        def c_run(threads):
            peak = np.empty((units, len(ORDERS)))
            pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (x, *tables, peak)]
            library.peaks(ctypes.c_long(units), errors, len(ORDERS), SPEEDS, threads, *pointers)
            return peak

        found |= {"C, one thread": lambda: c_run(1), "C, all threads": lambda: c_run(len(os.sched_getaffinity(0)))}
    return found | {"compiled": compiled}, arguments


def main() -> None:
    """Measure, after all agree."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--units", type=float, default=1e6)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    options = parser.parse_args()
    units = max(1, round(options.units / CHUNK)) * CHUNK
    candidates, _ = contenders(units)
    compiled = candidates.pop("compiled")
    expected = candidates["NumPy"]()
    for name, run in candidates.items():
        worst = np.max(np.abs(np.asarray(run()) / expected - 1))
        assert worst < 1e-9, (name, worst)
    seconds = timing.alternate(candidates, seconds=2.0, rounds=3)
    figures = {f"{name} (ns per unit)": 1e9 * value / units for name, value in seconds.items()}
    figures |= {f"{name} / rvjax": value / seconds["rvjax"] for name, value in seconds.items() if name != "rvjax"}
    timing.publish("dynamic_error", figures | {"units": units} | compiled, options.json)


if __name__ == "__main__":
    main()
