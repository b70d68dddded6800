"""Bearing life of RV-40E units: the damage integral of 8 bearings, a rating next to a revolution, a batch of a study.

The damage of 48 forces by size (`basic`) and by point of both rings (`raceway`, 32 each) runs in the library, in C (gcc
-O3 -march=native -ffast-math, one thread) and in SciPy (a quadrature over the ring for each bearing); all are compared
before anything is timed. `taskset -c 0` for the ratio on one core. The rating is compared with a crank turn of as many
angles, in which every equilibrium starts from those before.
"""

import ctypes
import functools

import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

import jax  # noqa: E402  (after the flags)
import jax.numpy as jnp  # noqa: E402
from scipy.integrate import quad_vec  # noqa: E402

from benchmarks.loaded import draw, fields  # noqa: E402
from benchmarks.whole import ACCURACY  # noqa: E402
from rvjax import RollerBearing, RVErrors, catalogue, life, loaded, study  # noqa: E402
from rvjax._jax.programs import QUICK  # noqa: E402
from rvjax.life.histories import J4, J45  # noqa: E402
from rvjax.life.ratings import ratings  # noqa: E402
from rvjax.loaded.cases import MACHINE  # noqa: E402
from rvjax.records import promote  # noqa: E402
from rvjax.response.response import BLOCK  # noqa: E402
from rvjax.tolerances import monte_carlo  # noqa: E402

HISTORIES, SAMPLES, POINTS, LOOP, UNITS = 512 * 8, 48, 32, 4, 256  # bearings; forces; of a ring; SciPy; rating
BATCH = 4096  # units of a study
BEARING = RollerBearing(14, 6e-3, 11e-3, 32e-3)
DESIGN = MACHINE.replace(bearings=catalogue.RV_40E.bearings)
ANGLE = -2 * np.pi * np.arange(SAMPLES) / SAMPLES

SOURCE = r"""
#include <math.h>
#include <stdlib.h>
void basic(int cases, int n, const double *force, double *load) {
  for (int i = 0; i < cases; i++) {
    double sum = 0;
    for (int j = 0; j < n; j++) {
      const double *f = force + 2 * (i * n + j);
      sum += pow(f[0] * f[0] + f[1] * f[1], 5.0 / 3);
    }
    load[i] = pow(sum / n, 0.3);
  }
}
static double ring(int n, int points, const double *f, const double *u) {
  double total = 0;
  for (int m = 0; m < points; m++) {
    double damage = 0;
    for (int j = 0; j < n; j++) {
      double along = f[2 * j] * u[2 * m] + f[2 * j + 1] * u[2 * m + 1];
      double square = f[2 * j] * f[2 * j] + f[2 * j + 1] * f[2 * j + 1];
      if (along > 0) damage += pow(along, 40.0 / 9) * pow(square, -2.0 / 9);
    }
    total += pow(damage / n, 9.0 / 8);
  }
  return total / points;
}
void raceway(int cases, int n, int points, double x, double j4, double j45, const double *angle, const double *force,
             double *load) {
  double *u = malloc(2 * points * sizeof *u), *turned = malloc(2 * n * sizeof *turned);
  for (int m = 0; m < points; m++) { u[2 * m] = cos(2 * M_PI * m / points); u[2 * m + 1] = sin(2 * M_PI * m / points); }
  for (int i = 0; i < cases; i++) {
    const double *f = force + 2 * i * n;
    for (int j = 0; j < n; j++) {
      double c = cos(angle[j]), s = sin(angle[j]);
      turned[2 * j] = c * f[2 * j] + s * f[2 * j + 1];
      turned[2 * j + 1] = c * f[2 * j + 1] - s * f[2 * j];
    }
    double inner = ring(n, points, turned, u) / pow(j4, 4.5), outer = ring(n, points, f, u) / pow(j45, 4.5);
    load[i] = pow((inner + x * outer) / (1 + x), 2.0 / 9);
  }
  free(u); free(turned);
}
"""


def share():
    """x of Eq. 10."""
    rated = ratings(promote(BEARING))
    return float((J45 * rated.inner / (J4 * rated.outer)) ** 4.5)


def histories(seed=0):
    """Forces (cases, samples, 2) N: a constant part, a part that turns with the inner ring, and noise."""
    rng = np.random.default_rng(seed)
    fixed, turning = rng.uniform(500, 3000, (2, HISTORIES, 1))
    angle = ANGLE[None] + rng.uniform(0, 2 * np.pi, (HISTORIES, 1))
    made = np.stack([fixed + turning * np.cos(angle), turning * np.sin(angle)], axis=-1)
    return np.ascontiguousarray(made + 200 * rng.normal(size=made.shape))


def by_scipy(force):
    """Equivalent load of one history by adaptive quadrature round both rings."""
    size = np.hypot(*force.T)
    turned = np.stack([
        np.cos(ANGLE) * force[:, 0] + np.sin(ANGLE) * force[:, 1],
        np.cos(ANGLE) * force[:, 1] - np.sin(ANGLE) * force[:, 0],
    ])  # fmt: skip

    def point(u):
        along = [f[0] * np.cos(u) + f[1] * np.sin(u) for f in (turned, force.T)]
        damage = [np.mean(np.maximum(a, 0) ** (40 / 9) * size ** (-4 / 9)) for a in along]
        return np.asarray(damage) ** (9 / 8) / (2 * np.pi)

    inner, outer = quad_vec(point, 0, 2 * np.pi, epsrel=1e-8)[0] / np.asarray([J4, J45]) ** 4.5
    x = share()
    return ((inner + x * outer) / (1 + x)) ** (2 / 9)


def in_c(library, method, force):
    """Run of the C program, and where its loads are."""
    load = np.zeros(len(force))
    pointer = lambda a: a.ctypes.data_as(ctypes.POINTER(ctypes.c_double))  # noqa: E731
    number = ctypes.c_double
    if method == "basic":
        return lambda: library.basic(len(force), SAMPLES, pointer(force), pointer(load)), load
    given = (len(force), SAMPLES, POINTS, number(share()), number(J4), number(J45), pointer(ANGLE), pointer(force))
    return lambda: library.raceway(*given, pointer(load)), load


def loads(method, force):
    """Equivalent loads of all histories."""
    return jax.vmap(lambda f: life.bearing_life(BEARING, f, angle=jnp.asarray(ANGLE), method=method).load)(force)


def of_damage(library):
    """Nanoseconds of a force, by method and candidate."""
    force, figures = histories(), {}
    for method in ("basic", "raceway"):
        program, _ = compiled(functools.partial(loads, method), jnp.asarray(force))
        given = jax.device_put(force)
        found = np.asarray(program(given))
        candidates = {"rvjax": lambda program=program, given=given: program(given)}
        if library is not None:
            run, load = in_c(library, method, force)
            run()
            np.testing.assert_allclose(found, load, rtol=1e-9)
            candidates["C"] = run
        best = alternate(candidates, rounds=5, seconds=0.5)
        figures |= {f"{method}: {name}, ns per force": 1e9 * t / force[..., 0].size for name, t in best.items()}
        if "C" in best:
            figures[f"{method}: rvjax / C"] = best["rvjax"] / best["C"]
        if method == "raceway":
            np.testing.assert_allclose([by_scipy(f) for f in force[:LOOP]], found[:LOOP], rtol=1e-6)
            slow = alternate({"scipy": lambda: [by_scipy(f) for f in force[:LOOP]]}, rounds=2, seconds=0.1)["scipy"]
            figures["raceway: scipy / rvjax"] = slow / LOOP / (best["rvjax"] / len(force))
    return figures


def of_rating():
    """Microseconds of a unit: a crank turn of 48 angles, and the ratings."""
    errors = jax.device_put(fields(draw(UNITS)))
    duty = life.Duty([412.0], [np.pi / 2], [1.0])

    def each(of_one):
        return lambda given: jax.vmap(lambda e: of_one(RVErrors.for_design(DESIGN, **e)), -1)(given)

    ways = {"revolution": lambda e: loaded.revolution(DESIGN, e, output_torque=412.0).largest_arm_bearing}
    for method in ("basic", "raceway"):
        ways[f"rating, {method}"] = lambda e, method=method: life.rating(DESIGN, e, duty, method=method).life
    programs = {name: compiled(each(way), errors, options=QUICK)[0] for name, way in ways.items()}
    best = alternate({name: functools.partial(p, errors) for name, p in programs.items()}, rounds=5, seconds=0.5)
    figures = {f"{name}, us per unit": 1e6 * seconds / UNITS for name, seconds in best.items()}
    ratios = {f"{name} / revolution": t / best["revolution"] for name, t in best.items() if name != "revolution"}
    return figures | ratios


def of_batch():
    """Seconds of a batch of rv-40e-whole, and of the same study without limits on life and forces."""
    studies = {name: study.load(name, solve=False) for name in (str(ACCURACY), "rv-40e-whole")}

    def run(asked):
        return lambda: monte_carlo(
            asked.response(), asked.tolerances, samples=BATCH, seed=1, chunk=BLOCK, requirements=asked.requirements
        )

    runs = {asked.name: run(asked) for asked in studies.values()}
    for each in runs.values():
        each()  # compiles
    best = alternate(runs, rounds=3, seconds=0.1)
    figures = {f"{BATCH} units, {name}, s": seconds for name, seconds in best.items()}
    return figures | {"rv-40e-whole / without life and forces": best["rv-40e-whole"] / best[ACCURACY.stem]}


def main():
    path = arguments(__doc__.splitlines()[0]).json
    figures = {"histories": HISTORIES, "forces of a history": SAMPLES, "units of the rating": UNITS}
    publish("life", figures | of_damage(c_library(SOURCE)) | of_rating() | of_batch(), path)


if __name__ == "__main__":
    main()
