"""Do the intervals of `rvjax.identify` hold the truth, and are its p-values uniform? 1000 virtual units.

`python -m benchmarks.identify_coverage --keep` re-makes `identify_coverage.json`, a minute on one core. Eleven errors,
two of them with equal slopes, one bounded, one under a wide offset; the observation is mildly curved.
"""

import argparse
import json
from pathlib import Path

from benchmarks.timing import settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy import stats  # noqa: E402

from rvjax import identify  # noqa: E402  (after the flags)
from rvjax.tolerances import Tolerance  # noqa: E402

KEPT = Path(__file__).with_suffix(".json")
NOISE, ROWS, CURVATURE = 0.5, 30, 0.03

PRIOR = {
    "ecc": Tolerance.symmetric(3.0, shape=(6,)),
    "bore": Tolerance.symmetric(3.0, shape=(2,)),
    "offset": Tolerance.symmetric(3e4),
    "play": Tolerance(0.0, 6.0, distribution="uniform"),
    "pin": Tolerance(-3.0, 3.0, cp=1.0),
}


def model(values):
    """Thirty rows, linear but for a few percent."""
    rng = np.random.default_rng(7)
    slopes = rng.standard_normal((ROWS, 10))
    slopes[:, 7] = slopes[:, 6]  # two bores of which only the sum is seen
    bent = rng.standard_normal((ROWS, 10))
    e = jnp.concatenate([values["ecc"], values["bore"], jnp.stack([values["play"] - 3.0, values["pin"]])])
    along = jnp.asarray(bent) @ e
    return {
        "te": values["offset"] + (jnp.asarray(slopes) @ e + CURVATURE * along**2)[: ROWS // 2],
        "loop": (jnp.asarray(slopes) @ e + CURVATURE * along**2)[ROWS // 2 :],
    }


def units(count, seed, *, spread=1.0, wrong=0.0):
    """Standard numbers (count, 11) and measurements of virtual units, in the order of the elements.

    Args:
        count: how many.
        seed: of them.
        spread: of the errors, in that of the prior.
        wrong: size of a harmonic that no error makes, unit of the observation.
    """
    rng = np.random.default_rng(seed)
    u = spread * rng.standard_normal((count, 11))
    uniform = 3.0 + 3.0 * (2 * stats.norm.cdf(u[:, 10]) - 1)
    values = {
        "bore": u[:, :2],
        "ecc": u[:, 2:8],
        "offset": 1e4 * u[:, 8],
        "pin": u[:, 9],
        "play": uniform,
    }
    clean = jax.vmap(model)(jax.tree.map(jnp.asarray, values))
    return u, {
        name: np.asarray(part) + NOISE * rng.standard_normal(part.shape) + wrong * np.cos(3 * np.arange(part.shape[1]))
        for name, part in clean.items()
    }


def solved(data):
    """All units of one prior and noise."""
    return identify.solve_many(model, PRIOR, data, noise=identify.Noise(NOISE), nuisance="offset")


def figures(count, seed):
    """Criteria of 1000 units: coverage, and the Kolmogorov p-values of ranks and of three chances.

    Args:
        count: units.
        seed: of them.
    """
    truth, data = units(count, seed)
    batch = solved(data)
    pull = (batch.u - truth) / batch.u_sd
    held = np.abs(pull) < stats.norm.ppf(0.975)
    found = {"units": count, "coverage": float(held.mean())}
    found |= {f"coverage of {name}": float(part) for name, part in zip(batch.names, held.mean(axis=0))}
    # Elements of one unit depend on each other: one rank for each unit.
    ranks = stats.norm.cdf(pull[np.arange(count), np.arange(count) % pull.shape[1]])
    found["uniform ranks, p"] = float(stats.kstest(ranks, "uniform").pvalue)
    for name in ("p_model", "p_prior", "p_total"):
        found[f"uniform {name}, p"] = float(stats.kstest(getattr(batch.fit, name), "uniform").pvalue)
    wrong = solved(units(count, seed + 1, wrong=3.0)[1]).fit
    wide = solved(units(count, seed + 2, spread=3.0)[1]).fit
    found["wrong reducer: p_model < 0.001"] = float((wrong.p_model < 1e-3).mean())
    found["tripled spread: p_prior < 0.001"] = float((wide.p_prior < 1e-3).mean())
    found["tripled spread: p_model < 0.001"] = float((wide.p_model < 1e-3).mean())
    return found


def main():
    """Print the figures, and keep them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--keep", action="store_true", help="write identify_coverage.json")
    options = parser.parse_args()
    found = figures(options.units, seed=2026)
    print(json.dumps(found, indent=1))
    if options.keep:
        KEPT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
