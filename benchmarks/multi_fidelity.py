"""What cheap responses spare, and whether the intervals hold: closed forms over many seeds.

`python -m benchmarks.multi_fidelity` makes the table of the docs, in ten minutes on one core; `--only` a case alone,
whose figures replace the kept ones.
"""

import argparse
import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import stats

from benchmarks.timing import settings
from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance, monte_carlo, multi_fidelity

KEPT = Path(__file__).with_name("multi_fidelity.json")
NUMBERS = {name: Tolerance.symmetric(3.0) for name in "abcd"}  # four standard normal numbers
ROOT = math.sqrt(2)
FAILING = stats.norm.sf(2.0)


class _Largest:
    """The larger of two independent normal numbers of one spread."""

    def __init__(self, spread):
        self.spread = spread

    def mean(self):
        return self.spread / math.sqrt(math.pi)

    def std(self):
        return self.spread * math.sqrt(1 - 1 / math.pi)

    def cdf(self, u):
        return stats.norm.cdf(u / self.spread) ** 2

    def ppf(self, q):
        return self.spread * stats.norm.ppf(math.sqrt(q))


@dataclasses.dataclass(frozen=True)
class Case:
    """A dear response of known law, and cheap ones that know a part of it."""

    dear: Callable[[Any], Any]
    cheap: dict[str, Callable[[Any], Any]]
    law: Any
    upper: float
    failing: float = 0.0

    @property
    def need(self):
        return Requirement(upper=self.upper)

    @property
    def exact(self):
        passed = float(self.law.cdf(self.upper)) * (1 - self.failing)
        return {"mean": float(self.law.mean()), "sd": float(self.law.std()), "yield": passed}


def _case(dear, cheap, law, share=0.99, **more):
    return Case(dear, cheap, law, float(law.ppf(share)), **more)


def _sum(e):
    return (e["a"] + e["b"]) / ROOT


def _ring(e):
    return (e["a"] ** 2 + e["b"] ** 2) / 2


CASES = {
    "linear": _case(
        lambda e: _sum(e) + 0.1 * e["c"],
        {"one": lambda e: e["a"] + 0.9 * e["b"], "two": lambda e: 0.8 * e["a"] + e["b"]},
        stats.norm(0, math.sqrt(1.01)),
    ),
    "linear, 99.9 %": _case(
        lambda e: _sum(e) + 0.1 * e["c"],
        {"one": lambda e: e["a"] + 0.9 * e["b"], "two": lambda e: 0.8 * e["a"] + e["b"]},
        stats.norm(0, math.sqrt(1.01)),
        0.999,
    ),
    "quadratic": _case(
        lambda e: _ring(e) + 0.1 * e["c"],
        {"one": lambda e: e["a"] ** 2 + 0.8 * e["b"] ** 2, "line": lambda e: e["b"]},
        stats.exponnorm(10.0, scale=0.1),
    ),
    "lognormal": _case(
        lambda e: jnp.exp(0.5 * _sum(e) + 0.05 * e["c"]),
        {"line": lambda e: 1 + 0.5 * _sum(e)},
        stats.lognorm(math.sqrt(0.2525)),
    ),
    "maximum": _case(
        lambda e: jnp.maximum(e["a"] + 0.2 * e["c"], e["b"] + 0.2 * e["d"]),
        {"rough": lambda e: jnp.maximum(e["a"], e["b"]), "line": lambda e: e["a"] + e["b"]},
        _Largest(math.sqrt(1.04)),
    ),
    "one way of two": _case(
        lambda e: jnp.maximum(e["a"] + 0.1 * e["c"], e["b"] + 0.1 * e["d"]),
        {"one": lambda e: e["a"]},
        _Largest(math.sqrt(1.01)),
    ),
    "some fail": _case(
        lambda e: Outcome(
            _sum(e) + 0.1 * e["c"], jnp.where(e["d"] > 2.0, int(Status.MAX_STEPS), int(Status.CONVERGED))
        ),
        {"rough": lambda e: _sum(e)},
        stats.norm(0, math.sqrt(1.01)),
        failing=float(FAILING),
    ),
    "unrelated": _case(lambda e: e["a"], {"other": lambda e: e["b"]}, stats.norm()),
}


def held(case: Case, samples: int, cheap_samples: int, seeds: int, first: int = 0) -> dict[str, Any]:
    """How often the intervals hold, how far the means of the figures are off, and the widths beside plain ones."""
    rows: dict[str, list[tuple[float, ...]]] = {figure: [] for figure in case.exact}
    words: dict[str, int] = {}
    for seed in range(first, first + seeds):
        asked = dict(samples=samples, seed=seed, requirements=case.need)
        run = multi_fidelity(case.dear, case.cheap, NUMBERS, cheap_samples=cheap_samples, **asked)
        plain = monte_carlo(case.dear, NUMBERS, **asked)
        words[run.status] = words.get(run.status, 0) + 1
        for figure, item, other in (
            ("mean", run.mean, plain.mean),
            ("sd", run.sd, plain.sd),
            ("yield", run.yield_, plain.yield_),
        ):
            exact = case.exact[figure]
            inside = item.lower - 1e-12 <= exact <= item.upper + 1e-12
            width, plain_width = item.upper - item.lower, other.upper - other.lower
            rows[figure].append((item.value - exact, inside, width, plain_width, item.lower <= exact))
    found: dict[str, Any] = {"samples": samples, "cheap samples": cheap_samples, "seeds": seeds, "status": words}
    for figure, of in rows.items():
        off, inside, width, plain_width, below = np.array(of, float).T
        found[figure] = {
            "exact": case.exact[figure],
            "held": float(inside.mean()),
            "lower end held": float(below.mean()),
            "bias, standard errors": float(off.mean() / (off.std(ddof=1) / math.sqrt(len(off)))),
            "width": float(np.median(width)),
            "evaluations of plain for the same width": float(np.median((plain_width / width) ** 2)),
        }
    return found


def main():
    """Print and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", help="name of a case; more than once for several")
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--cheap-samples", type=int, default=4000)
    parser.add_argument("--dry", action="store_true", help="print only")
    options = parser.parse_args()
    for name, case in CASES.items():
        if options.only is not None and name not in options.only:
            continue
        found = held(case, options.samples, options.cheap_samples, options.seeds)
        print(name, json.dumps(found, indent=1), flush=True)
        if not options.dry:
            kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
            kept[f"{name}, {options.samples}"] = found
            KEPT.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    settings()
    main()
