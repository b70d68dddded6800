"""The measured reducer of `rvjax.published.rv160`, calibrated: half of its torques in, a band for the others out.

What is unknown is a prior, not a guess: a factor on all springs, the clearance of the crank bearings, the modification
of the flanks, and the scatter of pins, teeth and journals, each known to a factor only.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax import identify, loaded
from rvjax.published.rv160 import ANGLES, FITTED, MACHINE, MEASURED, RATED, TORQUE, pattern
from rvjax.tolerances import Tolerance
from rvjax.units import arcmin, um

PROBE = 1e-3 * RATED


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
        median: of the law, unit of the number.
        log_sd: standard deviation of its logarithm.
    """
    return Tolerance(0.0, median * math.exp(3 * log_sd), distribution="lognormal", log_sd=log_sd)


def prior() -> dict[str, Tolerance]:
    """What is known of the reducer before anything is measured; medians are assumed, as all of `MACHINE` is."""
    return {
        "stiffness": factor_about(0.7, 0.5),  # factor on all springs
        "clearance": factor_about(3 * um, 0.7),  # radial, of the crank bearings
        "modification": factor_about(2 * um, 1.0),  # equidistant: play of the pins
        "scatter": factor_about(2 * um, 0.7),  # standard deviation of the drawn pattern
    }


def windup(torque: np.ndarray, *, seed: int = 0, angles: int = ANGLES) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Half of backward less forward transmission error, as `values -> {"windup": (n,)}`, rad.

    Args:
        torque: N m (n,); none counts as the probe torque, a thousandth of the rated one.
        seed: of the pattern of pins, teeth and journals.
        angles: input angles over an output turn whose mean stands for the turn.
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


@dataclasses.dataclass(frozen=True)
class Calibrated:
    """What half of the torques tell.

    Attributes:
        posterior: of the four numbers.
        angle: predicted at all torques, rad (n,).
        lower: of the 95 % band of the model, rad (n,).
        upper: of the same.
        noise: of a reading, rad.
    """

    posterior: identify.Posterior
    angle: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    noise: float

    @property
    def missed(self) -> np.ndarray:
        """Measured less predicted at the torques that were not fitted, rad (n,)."""
        return (MEASURED - self.angle)[~FITTED]

    @property
    def covered(self) -> int:
        """How many of these lie within the band, widened by the noise of a reading."""
        half = (self.upper - self.lower) / 2
        return int(np.sum(np.abs(self.missed) <= np.hypot(half, 1.96 * self.noise)[~FITTED]))


def noise() -> float:
    """Scatter of the measured points about the smooth curve of `closed_form`, rad: no model without friction is held to
    more than that."""
    return float(np.sqrt(np.sum((MEASURED - closed_form()) ** 2) / (len(TORQUE) - 4)))


def calibrated(*, seed: int = 0, angles: int = ANGLES, draws: int = 512, starts: int = 4) -> Calibrated:
    """Identify the four numbers from every second torque and predict the others.

    Args:
        seed: of the pattern, and of the draws.
        angles: as in `windup`.
        draws: behind the band.
        starts: of the search.
    """
    sd = noise()
    model = windup(TORQUE[FITTED], seed=seed, angles=angles)
    data = {"windup": MEASURED[FITTED]}
    found = identify.solve(model, prior(), data, noise=identify.Noise(sd), starts=starts, seed=seed, max_steps=200)
    everywhere = windup(TORQUE, seed=seed, angles=angles)

    def named(values: Mapping[str, Any]) -> dict[str, Any]:
        angle = everywhere(values)["windup"]
        return {f"{k:02d}": angle[k] for k in range(len(TORQUE))}

    band = identify.predict(found, named, draws=draws, seed=seed)
    assert isinstance(band, dict)
    at = [band[f"{k:02d}"] for k in range(len(TORQUE))]
    angle, lower, upper = (np.array([float(getattr(x, name)) for x in at]) for name in ("value", "lower", "upper"))
    return Calibrated(found, angle, lower, upper, sd)
