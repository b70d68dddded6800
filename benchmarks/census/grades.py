"""Cheapest grades against every combination of them: `python -m benchmarks.census.grades [--problems 60]`.

Random problems of 3 to 5 fields with 3 or 4 grades each and tables of costs, for a linear response and for one that is
mildly curved. Combinations are evaluated from the cheapest on. A result costs too much if it costs more than the
cheapest combination whose share of good units a certificate shows for certain. It is not good enough if it costs less
than the cheapest one that meets the requirement at all.
"""

import argparse
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

import rvjax
from rvjax.population import GRADES
from rvjax.tolerances import Requirement, Table, Tolerance, allocate, it_width
from rvjax.units import mm, um

UNITS = 200_000  # of a certificate
DRAWN = 1_000_000  # of the shares of a curved response
_SURE = 5.0  # standard errors of a certificate: 1.96 of its interval, a cushion, and luck


@dataclass(frozen=True)
class Problem:
    """One allocation.

    Attributes:
        slopes: of the response to each error (n,).
        curved: response added by a product of errors, as a part of the limit.
        widths: half-widths of the grades of each field, m.
        costs: of these.
        sizes: nominal, m (n,).
        limit: on either side, m.
        target: share of good units.
    """

    slopes: np.ndarray
    curved: float
    widths: list[np.ndarray]
    costs: list[np.ndarray]
    sizes: np.ndarray
    limit: float
    target: float

    def response(self, errors: Any) -> Any:
        """Response of a unit, or of many: sum a_j e_j + curved (sum a_j e_j)(a_0 e_0)/limit."""
        terms = [a * errors[name] for a, name in zip(self.slopes, names(len(self.slopes)))]
        return sum(terms) * (1 + self.curved * terms[0] / self.limit)

    def share(self, half_widths: np.ndarray, drawn: np.ndarray) -> float:
        """Share of good units: closed form of the linear response, else of sampled units."""
        if not self.curved:
            spread = float(np.linalg.norm(self.slopes * half_widths)) / 3
            return 1 - 2 * float(stats.norm.sf(self.limit / spread))
        errors = dict(zip(names(len(half_widths)), drawn[: len(half_widths)] * half_widths[:, None] / 3))
        return float(np.mean(np.abs(self.response(errors)) <= self.limit))


def names(count: int) -> list[str]:
    """Of the fields."""
    return [f"e{j}" for j in range(count)]


def problem(seed: int) -> Problem:
    """A random problem whose limit lies near the share of one of its inner combinations."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 6))
    sizes = rng.choice([8, 25, 60, 200], count) * mm
    widths, costs = [], []
    for size in sizes:
        first, several = int(rng.integers(4, 9)), int(rng.integers(3, 5))
        widths.append(np.array([it_width(grade, size) / 2 for grade in GRADES[first : first + several]]))
        steps = rng.uniform(1.1, 2.5, several - 1)
        costs.append(rng.lognormal(0, 0.7) * np.append(np.cumprod(steps[::-1])[::-1], 1.0))
    slopes = rng.choice([-1, 1], count) * rng.lognormal(0, 0.5, count)
    target = float(rng.choice([0.95, 0.99, 0.9973]))
    inner = np.array([row[rng.integers(1, len(row))] for row in widths])
    limit = float(np.linalg.norm(slopes * inner)) / 3 * stats.norm.ppf((1 + target) / 2) * rng.uniform(1.0, 1.1)
    return Problem(slopes, 0.1 * (seed % 2), widths, costs, sizes, limit, target)


def allocated(given: Problem, units: int = UNITS) -> Any:
    """Result of `allocate` with grades, with so many units in a certificate."""
    fields = names(len(given.sizes))
    parts = {name: Tolerance.symmetric(5 * um, size=size) for name, size in zip(fields, given.sizes)}
    costs = {name: Table(t, c) for name, t, c in zip(fields, given.widths, given.costs)}
    required = Requirement(lower=-given.limit, upper=given.limit, target=given.target)
    return allocate(given.response, parts, required, costs=costs, certificate_samples=units, grades=True)


def bounds(given: Problem, drawn: np.ndarray, units: int = UNITS) -> tuple[float, float]:
    """Least cost that meets the target by the luck of a certificate, and that meets it for certain."""
    spread = math.sqrt(given.target * (1 - given.target))
    chance = 3 * spread / math.sqrt(drawn.shape[1]) if given.curved else 0.0
    sets = sorted(
        (sum(row[k] for row, k in zip(given.costs, places)), places)
        for places in itertools.product(*(range(len(row)) for row in given.widths))
    )
    nearly = math.inf
    for cost, places in sets:
        share = given.share(np.array([row[k] for row, k in zip(given.widths, places)]), drawn)
        if share >= given.target - chance:
            nearly = min(nearly, cost)
        if share >= given.target + chance + _SURE * spread / math.sqrt(units):
            return nearly, cost
    return nearly, math.inf


def main() -> None:
    """Run the census."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.census.grades", description=__doc__.split("\n")[0])
    parser.add_argument("--problems", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    rvjax.enable_x64()
    drawn = np.random.default_rng(0).standard_normal((5, DRAWN))
    above_certain, below, other = [], [], []
    for seed in range(options.first, options.first + options.problems):
        given = problem(seed)
        found, (nearly, enough) = allocated(given), bounds(given, drawn)
        if found.graded is None or found.graded.status != "OPTIMAL":
            status = found.status if found.graded is None else found.graded.status
            other.append(seed)
            print(f"{seed:4} {status}: cheapest for certain {enough:.4f}", flush=True)
            continue
        above = found.graded.cost / enough - 1
        if above > 1e-9:
            above_certain.append(above)
        if found.graded.cost < nearly * (1 - 1e-9):
            below.append(seed)
        print(
            f"{seed:4} {len(given.sizes)} fields {nearly:.4f} {enough:.4f} {found.graded.cost:.4f} {above:+.2%}",
            flush=True,
        )
    print(
        f"above the certain optimum {len(above_certain)}, at most by {max(above_certain, default=0.0):.2%}; "
        f"below the target {below}; not OPTIMAL {other}"
    )


if __name__ == "__main__":
    main()
