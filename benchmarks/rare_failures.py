"""Failures of a few units in a million: importance sampling about design points, and plain Monte Carlo.

The RV-40E study with its own tolerances: how often the misfit of a disc exceeds 24, 25 and 27 um. Plain Monte
Carlo counts among --units fresh units (10^8 take about five minutes on two cores); its own error is a few percent.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import publish, settings

settings()

from rvjax.population.population import Population, root_key  # noqa: E402
from rvjax.response.response import BLOCK, respond_units  # noqa: E402
from rvjax.study import load  # noqa: E402
from rvjax.study.response import Response  # noqa: E402  (after the flags)
from rvjax.tolerances import Requirement, failure_probability  # noqa: E402
from rvjax.units import um  # noqa: E402

OUTPUT, LIMITS, SAMPLES = "misfit", (24 * um, 25 * um, 27 * um), 65_536


def counted(response, tolerances, units):
    """Units beyond each limit among the first `units` (whole blocks), with failed units, and the number of units."""
    beyond, drawn, key = np.zeros(len(LIMITS), int), 0, root_key(2026)
    while drawn < units:
        values, status = respond_units(response, Population.of(tolerances), key, drawn, count=BLOCK)
        value = np.where(np.asarray(status) == 0, np.asarray(values[OUTPUT]), np.inf)
        beyond += [(value > limit).sum() for limit in LIMITS]
        drawn += BLOCK
    return beyond, drawn


def main():
    """Print and publish the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--units", type=int, default=100_000_000, help="of plain Monte Carlo")
    options = parser.parse_args()
    study = load("rv-40e")
    response = Response.of(study.design, (OUTPUT,), study.conditions)
    figures = {}
    for limit in LIMITS:
        start = time.perf_counter()
        found = failure_probability(
            response, study.tolerances, {OUTPUT: Requirement(upper=limit)}, samples=SAMPLES, seed=0
        )
        share = found.probability[OUTPUT]
        name = f"misfit > {limit / um:.0f} um: "
        figures |= {
            name + "probability": share.value,
            name + "standard error, %": 100 * share.error / share.value,
            name + "evaluations": found.evaluations[OUTPUT],
            name + "seconds, compilation included": time.perf_counter() - start,
            name + "points of failure": found.points[OUTPUT],
            name + "reliability index": found.reliability_index[OUTPUT],
            name + "plain units for the same error": (1 - share.value) * share.value / share.error**2,
        }
    start = time.perf_counter()
    beyond, drawn = counted(response, study.tolerances, options.units)
    figures |= {"plain units": drawn, "plain seconds": time.perf_counter() - start}
    for limit, count in zip(LIMITS, beyond):
        name = f"misfit > {limit / um:.0f} um: "
        share, error = count / drawn, math.sqrt(count) / drawn
        ours = figures[name + "probability"]
        both = math.hypot(error, ours * figures[name + "standard error, %"] / 100)
        figures |= {
            name + "plain probability": share,
            name + "plain standard error, %": 100 / math.sqrt(max(count, 1)),
            name + "difference, %": 100 * (ours / share - 1) if count else math.nan,
            name + "difference, standard errors of both": (ours - share) / both if count else math.nan,
        }
    publish("rare_failures", figures, options.json)


if __name__ == "__main__":
    main()
