"""Coverage of the intervals: every interval that the library prints, over many seeds.

`python -m benchmarks.coverage` re-makes the tables of the docs (an hour and a half on one core); `--only` a case alone,
whose figures replace the kept ones.
"""

import argparse
import itertools
import json
import math
from pathlib import Path

import numpy as np

from benchmarks.timing import settings

settings()

from benchmarks.coverage_cases import PIN, RARE  # noqa: E402  (after the flags)
from benchmarks.coverage_intervals import LAWS, held  # noqa: E402
from rvjax.population.population import Population, root_key  # noqa: E402
from rvjax.response.response import respond_units  # noqa: E402
from rvjax.tolerances import Requirement, failure_probability  # noqa: E402

KEPT = Path(__file__).with_name("coverage.json")
BLOCK = 4096


def plain(case, units):
    """Share of failures among plain units of a case (whole blocks), and how many units there were."""
    population, key, failed, drawn = Population.of(case.tolerances), root_key(2026), 0, 0
    while drawn < units:
        values, status = respond_units(case.response, population, key, drawn, count=BLOCK)
        failed += int((~((np.asarray(status) == 0) & (np.asarray(values[""]) <= case.limit))).sum())
        drawn += BLOCK
    return failed / drawn, drawn


def rare(case, exact, seeds):
    """Coverage of the interval of a failure probability, and other tests of it."""
    need = Requirement(upper=case.limit)
    runs = [
        failure_probability(case.response, case.tolerances, need, samples=case.samples, seed=seed)
        for seed in range(seeds)
    ]
    held = [run.probability.lower <= exact <= run.probability.upper for run in runs]
    second = [run.second.lower <= exact <= run.second.upper for run in runs]
    values = np.array([run.probability.value for run in runs])
    return {
        "exact": float(exact),
        "seeds": seeds,
        "samples": case.samples,
        "held": float(np.mean(held)),
        "second held": float(np.mean(second)),
        "mean over exact": float(values.mean() / exact),
        "relative error": float(np.median([run.probability.error / exact for run in runs])),
        "worst over exact": float(max(values, key=lambda v: abs(math.log(max(v / exact, 1e-300)))) / exact),
        "disagree": float(np.mean(["DISAGREE" in run.status for run in runs])),
        "few effective": float(np.mean(["FEW" in run.status for run in runs])),
        "evaluations": int(np.median([run.evaluations for run in runs])),
    }


def main():
    """Print and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", help="name of a case; more than once for several")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--units", type=int, default=5_000_000, help="plain units behind the peak pin force")
    options = parser.parse_args()
    for name, case in RARE.items():
        if options.only is None or name in options.only:
            exact, units = plain(case, options.units) if name == PIN else (case.exact, None)
            found = rare(case, exact, options.seeds) | ({"plain units": units} if units else {})
            keep("rare", name, found)
    for law, method in itertools.product(LAWS, ("random", "sobol")):
        name = f"{law}, {method}"
        if options.only is None or name in options.only:
            keep("intervals", name, held(law, method, options.seeds))


def keep(part, name, found):
    """Print figures and put them among the kept ones."""
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    kept.setdefault(part, {})[name] = found
    KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    print(name, found, flush=True)


if __name__ == "__main__":
    main()
