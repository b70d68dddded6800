"""The measured reducer of `rvjax.published.rv160`, calibrated: half of its torques in, a band for the others out.

What is unknown is a prior, not a guess: a factor on all springs, the clearance of the crank bearings, the modification
of the flanks, and the scatter of pins, teeth and journals, each known to a factor only. `python -m
benchmarks.calibration` recomputes the surface, `--keep` stores it.
"""

import argparse
import dataclasses
import itertools
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

import rvjax
from rvjax import identify, loaded
from rvjax.published.rv160 import ANGLES, FITTED, MACHINE, MEASURED, RATED, TORQUE, pattern
from rvjax.records import Record, field, record
from rvjax.tolerances import Tolerance
from rvjax.units import arcmin, um

KEPT = Path(__file__).with_suffix(".json")
PROBE = 1e-3 * RATED
MEDIAN = {
    "clearance": (3 * um, 0.7),  # radial, of the crank bearings
    "modification": (2 * um, 1.0),  # equidistant: play of the pins
    "scatter": (2 * um, 0.7),  # standard deviation of the sampled pattern of pins, teeth and journals
    "stiffness": (0.7, 0.5),  # factor on all springs
}
"""Median of each number, and standard deviation of its logarithm; assumed, as all of `MACHINE` is."""
CENTRE, SCALE = np.array([0.8, 0.1, 0.1, -0.65]), np.array([0.7, 0.9, 0.6, 0.12])
"""Points of the surface, in standard numbers; in the order of `MEDIAN`."""
DEGREE = 4
BLOCK = 50


def closed_form() -> np.ndarray:
    """x0 + c T + s (1 - exp(-T / T0)) fitted to every second torque, at all torques, rad (n,).

    A play that closes, a spring, and a soft start: what any smooth model can do with four numbers.
    """
    torque = TORQUE / 1e3

    def curve(p: np.ndarray) -> np.ndarray:
        return p[0] + p[1] * torque + p[2] * -np.expm1(-torque / p[3])

    found = optimize.least_squares(lambda p: (curve(p) - MEASURED / arcmin)[FITTED], [0.2, 2.0, 1.0, 0.2], xtol=1e-14)
    return curve(found.x) * arcmin


def factor_about(median: float, log_sd: float) -> Tolerance:
    """A positive number that is known to a factor only: lognormal.

    Args:
        median: of the distribution, unit of the number.
        log_sd: standard deviation of its logarithm.
    """
    return Tolerance(0.0, median * math.exp(3 * log_sd), distribution="lognormal", log_sd=log_sd)


def prior() -> dict[str, Tolerance]:
    """Prior of the reducer before any measurement."""
    return {name: factor_about(*about) for name, about in MEDIAN.items()}


def windup(torque: np.ndarray, *, seed: int = 0, angles: int = ANGLES) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Half of backward less forward transmission error, as `values -> {"windup": (n,)}`, rad.

    Args:
        torque: N m (n,); none counts as the probe torque, a thousandth of the rated one.
        seed: of the pattern of pins, teeth and journals.
        angles: input angles over an output revolution, averaged.
    """
    load = jnp.asarray(np.maximum(torque, PROBE))
    turns = jnp.asarray(2 * np.pi * MACHINE.ratio * np.arange(angles) / angles)
    drawn = jax.tree.map(lambda x: x / um, pattern(seed))

    def observe(values: Mapping[str, Any]) -> dict[str, Any]:
        design = MACHINE.replace(stiffness=jax.tree.map(lambda k: k * values["stiffness"], MACHINE.stiffness))
        errors = jax.tree.map(lambda x: x * values["scatter"], drawn)
        errors = errors.replace(bearing_clearance=values["clearance"], equidistant_modification=values["modification"])

        def error(load: jax.Array, angle: jax.Array) -> jax.Array:
            return loaded.equilibrium(design, errors, input_angle=angle, output_torque=load).error

        both = jax.vmap(jax.vmap(error, (None, 0)), (0, None))(jnp.concatenate([-load, load]), turns)
        backward, forward = jnp.mean(both, axis=1).reshape(2, -1)
        return {"windup": (backward - forward) / 2}

    return observe


def noise() -> float:
    """Scatter of the measured points about the smooth curve of `closed_form`, rad: no model without friction is held to
    more than that."""
    return float(np.sqrt(np.sum((MEASURED - closed_form()) ** 2) / (len(TORQUE) - 4)))


@record
class Surface(Record):
    """A polynomial in the standard numbers of the prior through equilibria: `values -> {"windup": (n,)}`.

    The equilibrium has a kink wherever a pin or a bearing just touches; a solver that steps by slopes stops at each.
    Smooth, it is `windup` within a hundredth of an arcmin, a third of the noise, which `main` prints.
    """

    coefficients: Any = field("rad", "of every term, at each torque", shape=("terms", "torques"))
    centre: Any = field("-", "of the sampled u", shape=("numbers",))
    scale: Any = field("-", "of the same", shape=("numbers",))

    def __call__(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Wind-up of one reducer.

        Args:
            values: of `prior`.
        """
        fields = prior()
        # A lognormal distribution: its logarithm is linear in u.
        u = jnp.stack([jnp.log(values[n] / MEDIAN[n][0]) / MEDIAN[n][1] for n in sorted(fields)])
        return {"windup": self.at(u)}

    def at(self, u: Any) -> jax.Array:
        """Wind-up (n,) at standard numbers.

        Args:
            u: (4,).
        """
        return terms((u - jnp.asarray(self.centre)) / jnp.asarray(self.scale)) @ jnp.asarray(self.coefficients)


POWERS = [p for p in itertools.product(range(DEGREE + 1), repeat=len(MEDIAN)) if sum(p) <= DEGREE]


def terms(x: Any) -> jax.Array:
    """All products of powers (..., terms) of numbers x (..., 4).

    Args:
        x: about 1 in size.
    """
    table = jnp.stack([jnp.ones_like(x), x, x * x, x * x * x, x * x * x * x], axis=-1)
    return jnp.prod(table[..., np.arange(len(MEDIAN)), np.array(POWERS)], axis=-1)


def drawn(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Standard numbers u (count, 4) about where the measurement leads, and the wind-up there (count, 12), rad.

    Args:
        count: how many.
        seed: of the draw.
    """
    fields = prior()
    model = windup(TORQUE)

    def one(u: jax.Array) -> jax.Array:
        return model({name: fields[name].deviate(u[k]) for k, name in enumerate(sorted(fields))})["windup"]

    u = CENTRE + SCALE * np.random.default_rng(seed).normal(size=(count, len(CENTRE)))
    many = jax.jit(jax.vmap(one))
    return u, np.concatenate([np.asarray(many(part)) for part in np.split(u, count // BLOCK)])


def fitted(u: np.ndarray, angle: np.ndarray) -> tuple[Surface, float]:
    """A surface through all points but the last fifth, and the root mean square of what it misses there, rad.

    Args:
        u: standard numbers (n, 4).
        angle: wind-up (n, 12), rad.
    """
    rows = np.asarray(terms((u - CENTRE) / SCALE))
    known = len(u) * 4 // 5
    found, *_ = np.linalg.lstsq(rows[:known], angle[:known], rcond=None)
    missed = (rows @ found - angle)[known:]
    near = np.all(np.abs((u - CENTRE) / SCALE)[known:] < 2, axis=1)
    return Surface(found, CENTRE, SCALE), float(np.sqrt(np.mean(missed[near] ** 2)))


@dataclasses.dataclass(frozen=True)
class Calibrated:
    """Results from half of the torques.

    Attributes:
        posterior: of the four numbers.
        angle: predicted at all torques, rad (n,).
        half: half-width of the 95 % band of a reading there: of model and noise, rad (n,).
    """

    posterior: identify.Posterior
    angle: np.ndarray
    half: np.ndarray

    @property
    def missed(self) -> np.ndarray:
        """Measured less predicted at the torques that were not fitted, rad (n,)."""
        return (MEASURED - self.angle)[~FITTED]

    @property
    def covered(self) -> int:
        """Number of these values within the band."""
        return int(np.sum(np.abs(self.missed) <= self.half[~FITTED]))


def calibrated(surface: Surface) -> Calibrated:
    """Identify the four numbers from every second torque and predict the others, linear about the mode.

    Args:
        surface: of the wind-up.
    """
    sd = noise()
    half = surface.replace(coefficients=np.asarray(surface.coefficients)[:, FITTED])
    found = identify.solve(half, prior(), {"windup": MEASURED[FITTED]}, noise=identify.Noise(sd), starts=4)
    slopes = np.asarray(jax.jacfwd(surface.at)(jnp.asarray(found.u)))
    spread = np.einsum("ti,ij,tj->t", slopes, found.u_covariance, slopes)
    return Calibrated(found, np.asarray(surface.at(jnp.asarray(found.u))), 1.96 * np.sqrt(spread + sd**2))


def main() -> None:
    """Sample equilibria, fit the surface, identify, predict; store the result with --keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", action="store_true", help=f"write {KEPT.name}")
    parser.add_argument("--count", type=int, default=600)
    options = parser.parse_args()
    rvjax.enable_x64()
    surface, missed = fitted(*drawn(options.count))
    found = calibrated(surface)
    print(f"surface misses {missed / arcmin:.4f} arcmin, noise {noise() / arcmin:.4f} arcmin")
    print(found.posterior.status, found.posterior.resolution, found.missed / arcmin, found.covered)
    if options.keep:
        coefficients = [[float(f"{c / arcmin:.6g}") for c in row] for row in np.asarray(surface.coefficients)]
        KEPT.write_text(json.dumps(dict(surface_arcmin=missed / arcmin, coefficients_arcmin=coefficients)) + "\n")


def kept() -> Surface:
    """The surface that was kept."""
    return Surface(np.array(json.loads(KEPT.read_text())["coefficients_arcmin"]) * arcmin, CENTRE, SCALE)


if __name__ == "__main__":
    main()
