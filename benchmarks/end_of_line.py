"""A virtual end of line: units are sampled, measured with noise, identified; coverage of the intervals, and
how many broken parts are found at a stated rate of false alarms. `python -m benchmarks.end_of_line`, `--keep` for the
docs.

The bench reads orders 40 and 80 and the mean of an RV-40E at rated torque, both ways, with 0.2 arcsec in every real
number. The prior is the drawing; broken units carry one crank journal that is off by several of its standard
deviations.
"""

import argparse
import json
import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import rvjax
from rvjax import catalogue, identify, models
from rvjax.measured import Conditions
from rvjax.study.bench import curve_model
from rvjax.study.identification import nuisance
from rvjax.tolerances import Tolerance, sample
from rvjax.units import arcmin, arcsec, um

KEPT = Path(__file__).with_suffix(".json")
ALARM = 0.01
"""Share of good units that may be called broken."""
SIZES = (3.0, 6.0, 9.0, 12.0)
"""Error of the journal of a broken unit, in standard deviations of the drawing."""
NOISE = 0.2 * arcsec


def question(angles: int = 16) -> tuple[Any, dict[str, Tolerance]]:
    """Model and prior.

    Args:
        angles: of a crank turn.
    """
    link = Tolerance.symmetric(6.5 * um, shape=(2, 2))
    prior = {
        "crank_eccentricity": link,
        "crank_phase": Tolerance.symmetric(5 * arcmin, shape=(2,)),
        "carrier_bore": Tolerance.symmetric(6.5 * um, shape=(2, 2), vector=False),
        "bearing_clearance": Tolerance(4 * um, 12 * um),
        "offset": nuisance("offset", (40,)),
    }
    runs = [Conditions(torque=412.0, direction=d) for d in ("forward", "backward")]
    conditions = models.kind(catalogue.RV_40E).conditions(output_torque=412.0, angles=angles)
    model = curve_model("four_bar", catalogue.RV_40E, conditions, runs, (40, 80), ("offset",), tuple(prior))
    return model, prior


@jax.jit
@jax.vmap
def _measured(model: Any, values: Any, key: jax.Array) -> Any:
    """Measurement of one unit."""
    leaves, structure = jax.tree.flatten(model(values))
    noisy = []
    for leaf, own in zip(leaves, jax.random.split(key, len(leaves))):
        draw = jax.random.normal(own, (2, *leaf.shape)) * NOISE
        noisy.append(leaf + (jax.lax.complex(draw[0], draw[1]) if jnp.iscomplexobj(leaf) else draw[0]))
    return structure.unflatten(noisy)


def line(units: int, *, seed: int = 0, off: float = 0.0) -> tuple[Any, Any, dict[str, Tolerance]]:
    """Units of a line and what is identified of them: (values, Batch, prior).

    Args:
        units: how many.
        seed: of units and noise.
        off: of the first crank journal of each, in standard deviations of the drawing.
    """
    model, prior = question()
    values = jax.jit(jax.vmap(lambda index: sample(prior, index, seed=seed)))(np.arange(units, dtype=np.uint32))
    sigma = prior["crank_eccentricity"].half_width / 3
    throws = values["crank_eccentricity"]
    values = {**values, "crank_eccentricity": throws.at[:, 0, 0].add(off * sigma)}
    keys = jax.random.split(jax.random.key(seed + 1), units)
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (units, *jnp.shape(leaf))), model)
    data = jax.tree.map(np.asarray, _measured(many, values, keys))
    noise = identify.Noise(NOISE)
    return values, identify.solve_many(model, prior, data, noise=noise, nuisance=("offset",)), prior


def held(values: Any, found: identify.Batch, prior: dict[str, Tolerance]) -> dict[str, float]:
    """Share of intervals that hold the truth, of each field but the offset.

    Args:
        values: true ones.
        found: identified ones.
        prior: of both.
    """
    inside = {
        name: (np.asarray(found.lower[name]) <= np.asarray(values[name]))
        & (np.asarray(values[name]) <= np.asarray(found.upper[name]))
        for name in prior
        if name != "offset"
    }
    return {name: float(np.mean(ok)) for name, ok in inside.items()}


def alarms(found: identify.Batch) -> np.ndarray:
    """Units that are called broken: parts of this drawing make such a curve less often than `ALARM`.

    Args:
        found: identified units.
    """
    return np.asarray(found.fit.p_prior) < ALARM


def due(off: float) -> float:
    """Share of broken units that are to be expected among the alarms.

    The curve shows two numbers of the parts: e00 - e01 - e10 + e11, of standard deviation 2 sigma, and backlash. It is
    unknown which part is broken, so both count: a chi square of two numbers, off centre by (off / 2)^2.

    Args:
        off: in standard deviations of the drawing.
    """
    from scipy import stats

    return float(stats.ncx2.sf(stats.chi2.isf(ALARM, 2), 2, off**2 / 4))


def main() -> None:
    """Print the values, and store them with --keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", action="store_true", help=f"write {KEPT.name}")
    parser.add_argument("--units", type=int, default=1000)
    options = parser.parse_args()
    rvjax.enable_x64()
    values, found, prior = line(options.units)
    figures: dict[str, Any] = dict(units=options.units, noise="0.2 arcsec", held=held(values, found, prior))
    every = [h * math.prod(prior[name].shape) for name, h in figures["held"].items()]
    figures["held in all"] = sum(every) / sum(math.prod(prior[name].shape) for name in figures["held"])
    figures["status"] = {
        str(s): int(n) for s, n in zip(*np.unique(np.asarray(found.status).astype(str), return_counts=True))
    }
    figures["numbers evaluated"] = float(np.mean(np.asarray(found.fit.dof_prior)))
    figures["alarms"] = {"0": float(np.mean(alarms(found)))}
    figures["due"] = {"0": due(0.0)}
    for size in SIZES:
        _, broken, _ = line(options.units, seed=100, off=size)
        figures["alarms"][f"{size:g}"] = float(np.mean(alarms(broken)))
        figures["due"][f"{size:g}"] = due(size)
    print(json.dumps(figures, indent=1))
    if options.keep:
        KEPT.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
