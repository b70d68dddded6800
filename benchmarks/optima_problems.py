"""The problems of `benchmarks.optima`, by name: what is allocated, and the least cost and exact prices where known.

Certificates have a million units, of 200 fields a quarter; some known defects were found with other sizes. A
certificate of n units wants a share 2.7 standard errors above the target, so that ratios lie above 1: 1.003 to 1.006
at a million units.
"""

import copy
import functools
import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy import optimize, stats

from benchmarks.census import grades
from rvjax.commands.init import written
from rvjax.study import Study, load, parse_study
from rvjax.tolerances import (
    CpkAtLeast,
    MeanWithin,
    Middle,
    Nominal,
    ReciprocalPower,
    Requirement,
    Table,
    Tolerance,
    Variable,
)
from rvjax.units import um
from tests import codesign_cases, codesign_random
from tests.oracles import known_optima
from tests.oracles.known_optima import least, squares
from tests.oracles.linear_pair import COSTS, LIMIT, PAIR, closed_cost, linear, radius, two
from tests.oracles.responses import Failing, Linear

THREE_CRANKS = Path(__file__).parents[1] / "tests" / "three-cranks.toml"
OWN = Path(__file__).parents[1] / "tests" / "three-cranks-own.toml"
"""A user's reducer: 99.73 %, limits on pin force and misfit, a mid-point that may move, and few samples."""
STILL = {"a": Middle(0, 0)}
"""A mid-point that cannot move: the same problem by another search."""
EDGE = 15 * um  # units with a larger |b| fail
FEW = dict(samples=4096, certificate_samples=200_000)  # of the known defects


class Known(NamedTuple):
    """An allocation.

    Attributes:
        arguments: of `allocate`.
        optimum: least cost, of an infeasible problem least shortfall; nan where it is not known.
        prices: {requirement: exact d cost / d limit, all its limits moving outwards}, where known.
    """

    arguments: dict[str, Any]
    optimum: float = math.nan
    prices: dict[str, float] = {}  # noqa: RUF012  (never changed)


class Problem(NamedTuple):
    """One row of the table.

    Attributes:
        kind: of problem.
        make: its allocation.
        right: status of a right result.
        alone: in its own process, with kept programs, as a user runs a study.
    """

    kind: str
    make: Callable[[], Known]
    right: str = "OPTIMAL"
    alone: bool = False


def pair(limit: float, optimum: float, price: float | None, **changes: Any) -> Known:
    """a + 2 b within +- limit, or what differs from it."""
    given = dict(response=linear, tolerances=PAIR, costs=COSTS, requirements=Requirement(lower=-limit, upper=limit))
    return Known(given | changes, optimum, {} if price is None else {"": price})


def published(name: str) -> Known:
    """Of `tests.oracles.known_optima`."""
    case = known_optima.CASES[name]()
    given = {key: getattr(case, key) for key in ("response", "tolerances", "requirements", "costs")}
    return Known(given | (dict(certificate_samples=250_000) if name == "200 fields" else {}), case.optimum)


def reference(name: str) -> Known:
    """Of `tests/reference/codesign.json`."""
    case = codesign_cases.CASES[name]
    due = case["expected"]
    optimum = due["cost"] if "cost" in due else sum(due["shortfall"].values())
    if name == "rv-0":
        return Known(of_study(codesign_cases.reference_study(1_000_000)), optimum, due["prices"])
    return Known(codesign_cases.arguments(case["given"]), optimum, due.get("prices", {}))


def drawn_at_random(seed: int) -> Known:
    """Of `tests/codesign_random.py`."""
    problem = codesign_random.problem(seed)
    cost, prices, _ = problem.exact()
    return Known(problem.arguments(), cost, prices)


def long_lists() -> Known:
    """Three numbers of five values each, without errors that count: the cheapest of 125 combinations."""
    among = (1.3, 0.4, 2.1, 0.9, 1.7)
    own = {"x": lambda v: v**2, "y": lambda v: 2.3 * v, "z": lambda v: 1.1 * v**3}
    root = lambda values: math.sqrt(math.prod(values))  # noqa: E731
    sets = [values for values in itertools.product(among, repeat=3) if root(values) >= 1.2]
    given = dict(
        response=lambda e, v: {"size": jnp.sqrt(v["x"] * v["y"] * v["z"]) + 0.0 * e["a"]},
        tolerances={"a": Tolerance(0.0, 0.0)}, requirements={"size": Nominal(lower=1.2)}, costs={},
        variables={name: Variable(0.3, 3.0, cost=cost, among=among) for name, cost in own.items()},
    )  # fmt: skip
    return Known(given, min(sum(cost(v) for cost, v in zip(own.values(), values)) for values in sets))


def hopeless_number() -> Known:
    """A stress of 3.2/size^2, at least 0.8 with size <= 2, that must not exceed 0.7; all units meet their limit."""
    cases = codesign_cases.CASES.values()
    given = copy.deepcopy(next(case for case in cases if case["expected"].get("status") == "INFEASIBLE")["given"])
    given["requirements"]["y"]["upper"], given["requirements"]["stress"]["upper"] = 2.0, 0.7
    return Known(codesign_cases.arguments(given), 0.1)


def differences(cost: Callable[[dict[str, float]], float], limits: dict[str, float]) -> dict[str, float]:
    """Prices by central differences of the least cost, 0.1 % of each limit."""
    found = {}
    for name, limit in limits.items():
        ends = [cost(limits | {name: limit * (1 + side)}) for side in (-1e-3, 1e-3)]
        found[name] = (ends[1] - ends[0]) / (2e-3 * limit)
    return found


def two_bounds() -> Known:
    """Four fields of two chains: a ends at its finest, d at its coarsest."""
    slopes = {"sum": dict(a=1.0, b=1.0, c=1.0, d=1.0), "pair": dict(a=1.0, b=-1.0)}
    limits = {"sum": 30 * um, "pair": 16 * um}
    scales, powers = dict(a=0.5, b=2.0, c=1.0, d=3.0), dict(a=1.0, b=0.7, c=1.5, d=1.2)
    finest, coarsest = dict(a=12 * um), dict(d=13 * um)
    costs = {
        f: ReciprocalPower(scale=scales[f], power=powers[f], finest=finest.get(f, 0.2 * um),
                           coarsest=coarsest.get(f, 400 * um))
        for f in "abcd"
    }  # fmt: skip
    cost = lambda at: least(costs, [squares(slopes[n], costs, radius(0.99, limit)) for n, limit in at.items()], 8 * um)  # noqa: E731
    given = dict(
        response=Linear(slopes), tolerances={f: Tolerance.symmetric(10 * um) for f in "abcd"}, costs=costs,
        requirements={n: Requirement(lower=-limit, upper=limit, target=0.99) for n, limit in limits.items()},
    )  # fmt: skip
    return Known(given, cost(limits), differences(cost, limits))


def finest_field() -> Known:
    """Three fields, and one at its finest that takes 88 % of the variance."""
    slopes, scales = dict(a=1.3, b=-0.4, c=2.6, d=0.9), dict(a=1.0, b=0.3, c=4.0, d=2.2)
    costs = {
        f: ReciprocalPower(scale=scales[f], finest=(13.044 if f == "c" else 0.2) * um, coarsest=400 * um)
        for f in "abcd"
    }
    cost = lambda at: least(costs, [squares(slopes, costs, radius(0.99, at[""]))], 14 * um)  # noqa: E731
    given = dict(
        response=Linear(slopes), tolerances={f: Tolerance.symmetric(10 * um) for f in "abcd"}, costs=costs,
        requirements=Requirement(lower=-31 * um, upper=31 * um, target=0.99), samples=4096,
    )  # fmt: skip
    return Known(given, cost({"": 31 * um}), differences(cost, {"": 31 * um}))


def cheapest_grades() -> Known:
    """Grades with tables of costs, against every combination; without exchanges of grades 14 % too expensive."""
    given = grades.problem(14)
    fields = grades.names(len(given.sizes))
    arguments = dict(
        response=given.response, costs={f: Table(t, c) for f, t, c in zip(fields, given.widths, given.costs)},
        tolerances={f: Tolerance.symmetric(5 * um, size=size) for f, size in zip(fields, given.sizes)},
        requirements=Requirement(lower=-given.limit, upper=given.limit, target=given.target), grades=True,
    )  # fmt: skip
    return Known(arguments, grades.bounds(given, np.zeros((5, 1)), 1_000_000)[0])


def fragile(**changes: Any) -> Known:
    """P(|a| <= limit) P(|b| <= EDGE) = 99 %: units with a larger |b| fail. The share left to a is scanned."""
    share = 0.99 + 0.01 * np.linspace(0.001, 0.999, 100_000)
    a = 3 * LIMIT / stats.norm.ppf((1 + share) / 2)
    b = 3 * EDGE / stats.norm.ppf((1 + 0.99 / share) / 2)
    required = Requirement(lower=-LIMIT, upper=LIMIT, target=0.99)
    given = dict(response=Failing({"a": 1.0, "b": 0.0}, {"a": 1.0, "b": EDGE}), requirements=required)
    return pair(LIMIT, float((10 * um / a + 10 * um / b).min()), None, **(given | FEW | changes))


def stepped(**changes: Any) -> Known:
    """|a + 2 b| rounded up to whole steps of 2 um; the limit lies within a step, so that 20 um count."""
    size, required = 2 * um, Requirement(upper=20.1 * um, target=0.99)
    response = lambda e: jnp.ceil(jnp.abs(linear(e)) / size) * size  # noqa: E731
    return pair(
        20 * um, closed_cost(0.99, 20 * um), None, **(dict(response=response, requirements=required) | FEW | changes)
    )


def correlated() -> Known:
    """t_a^2 + 4 t_b^2 + 2.4 t_a t_b = radius^2, scanned; the cost is as 1/limit."""
    ratio = np.linspace(0.5, 5, 100_000)
    b = radius(0.9973) / np.sqrt(ratio**2 + 4 + 2.4 * ratio)
    optimum = float((10 * um / (ratio * b) + 10 * um / b).min())
    return pair(LIMIT, optimum, -optimum / LIMIT, correlation={("a", "b"): 0.6})


def joint() -> Known:
    """|a + 2 b| and |b| within their limits at once for 99 %: quadrature over b."""
    nodes, weights = np.polynomial.legendre.leggauss(80)

    def failing(t: np.ndarray, limits: dict[str, float]) -> float:
        b = limits["b"] * nodes
        lower, upper = (3 * (end - 2 * b) / t[0] for end in (-limits["y"], limits["y"]))
        inside = (stats.norm.cdf(upper) - stats.norm.cdf(lower)) * stats.norm.pdf(3 * b / t[1])
        return 1 - float(weights @ inside) * 3 * limits["b"] / t[1]

    cost = lambda at: least(COSTS, [lambda t: 1 - failing(t, at) / 0.01], 5 * um)  # noqa: E731
    limits = {"y": LIMIT, "b": 6 * um}
    required = {n: Requirement(lower=-limit, upper=limit, target=0.99) for n, limit in limits.items()}
    required["b"] = Requirement(upper=6 * um, target=0.99)
    given = dict(response=two, tolerances=PAIR, costs=COSTS, requirements=required, joint_target=0.99)
    return Known(given, cost(limits), differences(cost, limits))


def capability() -> Known:
    """Cpk >= 1.33 of a - c, and 99.73 % of a + 2 b."""
    slopes, limits = {"y": dict(a=1.0, b=2.0), "x": dict(a=1.0, c=-1.0)}, {"y": LIMIT, "x": LIMIT}
    costs = COSTS | {"c": COSTS["a"]}
    reach = lambda at: {"y": radius(0.9973, at["y"]), "x": at["x"] / 1.33}  # noqa: E731
    cost = lambda at: least(costs, [squares(slopes[n], costs, r) for n, r in reach(at).items()], 5 * um)  # noqa: E731
    required = {
        "y": Requirement(lower=-LIMIT, upper=LIMIT, target=0.9973),
        "x": CpkAtLeast(lower=-LIMIT, upper=LIMIT, cpk=1.33),
    }
    given = dict(response=Linear(slopes), tolerances={f: PAIR["a"] for f in "abc"}, costs=costs, requirements=required)
    return Known(given, cost(limits), differences(cost, limits))


def rare_target() -> Known:
    """99.99 %: 20 rejects in the certificate."""
    best = closed_cost(0.9999)
    required = Requirement(lower=-LIMIT, upper=LIMIT, target=0.9999)
    return pair(LIMIT, best, -best / LIMIT, requirements=required, certificate_samples=200_000)


def of_study(study: Study) -> dict[str, Any]:
    """Arguments of the allocation of a study, as `rvjax allocate` or `rvjax design` give them."""
    shared = ("tolerances", "costs", "samples", "seed", "joint_target", "certificate_samples", "middles")
    given = {name: getattr(study, name) for name in shared}
    if not study.variables:
        graded = any(getattr(study.tolerances, name).size is not None for name in study.fields)
        return given | dict(response=study.units, requirements=study.requirements, grades=graded)
    prices = {name: price(1.0) for name, price in study.objective.items()}
    required = study.requirements | study.nominal
    return given | dict(
        response=study.design_response(), requirements=required, variables=study.variables, objective=prices
    )


def studied(name: str, **changes: Any) -> Problem:
    """An embedded study, or a file."""
    return Problem("study", lambda: Known(of_study(load(name)) | changes), alone=True)


def begun(base: str, target: float) -> Problem:
    """The study that `rvjax init` writes for a reducer, with a mid-point that may move and another target."""

    def make() -> Known:
        text = re.sub(r"(?m)^target = 0\.99\b", f"target = {target}", written(base).text)
        middle = '[middle.equidistant_modification]\nlower = "-5 um"\nupper = "20 um"\n\n'
        return Known(of_study(parse_study(text.replace("[run]", middle + "[run]", 1), name=base)))

    return Problem("study", make, alone=True)


SMALL = ReciprocalPower(reference=0.3, finest=0.02, coarsest=3.0)
Z99 = float(stats.norm.ppf(0.99))


class Costly(NamedTuple):
    """A response of few units, as a loaded reducer is."""

    function: Callable[..., Any]
    costly: bool = True

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)


def small(
    function: Callable[..., Any], required: Any, *, half_width: float = 0.1, fields: str = "a", **more: Any
) -> dict[str, Any]:
    """Arguments of a problem of one or two errors."""
    given = dict(
        response=function, tolerances={f: Tolerance.symmetric(half_width) for f in fields},
        costs=dict.fromkeys(fields, SMALL), requirements=required, samples=4096, certificate_samples=20_000,
    )  # fmt: skip
    return given | more


def number_inside() -> Known:
    """Costly a + (d - 1)^2 <= 0.3: the best d is 1."""
    given = small(Costly(lambda e, v: e["a"] + (v["d"] - 1) ** 2), Requirement(upper=0.3, target=0.99),
                  variables={"d": Variable(0.0, 4.0, start=1.4)})  # fmt: skip
    return Known(given, Z99 / 3)


def number_in_a_bend() -> Known:
    """Costly sqrt(1e-4 + (a + d - 1)^2) <= 0.3: at d = 1 both sides count."""
    given = small(Costly(lambda e, v: jnp.sqrt(1e-4 + (e["a"] + v["d"] - 1) ** 2)), Requirement(upper=0.3, target=0.99),
                  variables={"d": Variable(0.0, 4.0, start=1.4)})  # fmt: skip
    return Known(given, 0.3 * float(stats.norm.ppf(0.995)) / (3 * math.sqrt(0.09 - 1e-4)))


def middle_inside() -> Known:
    """Costly a + 2 (b - 0.3)^2 <= 0.3, the mid-point of b may move: a non-central chi-square, by quadrature over b."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)

    def failing(t: np.ndarray) -> float:
        b = t[1] / 3 * nodes
        return float(weights @ stats.norm.sf((0.3 - 2 * b**2) / (t[0] / 3))) / math.sqrt(2 * math.pi)

    costs = dict(a=SMALL, b=SMALL)
    optimum = least(costs, [lambda t: 1 - failing(t) / 0.01], 0.2)
    given = small(Costly(lambda e: e["a"] + 2 * (e["b"] - 0.3) ** 2), Requirement(upper=0.3, target=0.99), fields="ab",
                  middles={"b": Middle(-1.0, 1.0)})  # fmt: skip
    return Known(given, optimum)


def mean_of_a_number() -> Known:
    """-0.5 <= mean of a + d - 1 <= 0.2, d costs 3 (2 - d): d = 1.2, and a is free."""
    given = small(lambda e, v: e["a"] + v["d"] - 1, MeanWithin(lower=-0.5, upper=0.2), half_width=0.3,
                  variables={"d": Variable(0.0, 2.0, cost=lambda d: 3 * (2 - d))},
                  certificate_samples=100_000)  # fmt: skip
    return Known(given, 3 * 0.8 + 0.1, {"": -3.0})


def rare_pair() -> Known:
    """a + 0.5 b <= 0.5 for 99.99 %."""
    z = float(stats.norm.ppf(0.9999))
    costs = dict(a=SMALL, b=SMALL)
    optimum = least(costs, [lambda t: 1 - z**2 / 9 * (t[0] ** 2 + t[1] ** 2 / 4) / 0.25], 0.3)
    given = small(lambda e: e["a"] + 0.5 * e["b"], Requirement(upper=0.5, target=0.9999), half_width=0.3, fields="ab",
                  certificate_samples=100_000)  # fmt: skip
    return Known(given, optimum)


def constant_miss() -> Known:
    """0 a + 0.7 <= 0.5."""
    return Known(small(lambda e: 0 * e["a"] + 0.7, Requirement(upper=0.5, target=0.99)), 0.2)


def flank_and_diameter() -> Known:
    """Three numbers: y grows as 1/diameter, a nominal flank that must reach 10 mm, and 65 per m of diameter.

    flank = diameter (1 - 2 share) / 12 limits both; the price of the limit follows by differences.
    """
    scale = lambda v: 0.12 / v["diameter"]  # noqa: E731
    flank = lambda v: v["diameter"] * (1 - v["share"]) / 8 - 0.1 * v["play"]  # noqa: E731
    response = lambda e, v: {  # noqa: E731
        "y": (e["a"] + e["b"]) * scale(v) + 3 * v["play"] * um / 1e-3 * v["share"] - 2 * um * (v["play"] / 1e-3),
        "flank": flank(v) + 0.0 * e["a"], "diameter": v["diameter"] + 0.0 * e["a"],
    }  # fmt: skip
    fields = {n: ReciprocalPower(scale=k, finest=0.5 * um, coarsest=60 * um) for n, k in (("a", 1.0), ("b", 2.0))}

    def cost(limits: dict[str, float]) -> float:
        z = Z99 / 3

        def total(x: np.ndarray) -> float:
            t, d, _s, _p = np.exp(x[:2]) * um, x[2], x[3], x[4]
            return float(10 * um / t[0] + 20 * um / t[1] + 65 * d)

        def met(x: np.ndarray) -> list[float]:
            t, d, s, p = np.exp(x[:2]) * um, x[2], x[3], x[4]
            reach = z * 0.12 / d * math.hypot(*t) + (3 * s - 2) * p * um
            return [1 - reach / limits["y"], (d * (1 - s) / 8 - 1e-4 * p) / limits["flank"] - 1]

        limited = dict(type="ineq", fun=met)
        bounds = [(math.log(0.5), math.log(60))] * 2 + [(0.06, 0.3), (0.1, 0.6), (0.0, 2.0)]
        ends = [
            optimize.minimize(total, [2.0, 2.0, d, s, 1.0], method="SLSQP", bounds=bounds, constraints=limited,
                              options=dict(ftol=1e-14, maxiter=500))
            for d in (0.1, 0.2) for s in (0.15, 0.3, 0.5)
        ]  # fmt: skip
        return min(float(end.fun) for end in ends if min(met(end.x)) > -1e-9)

    limits = {"y": 12 * um, "flank": 0.01}
    given = dict(
        response=response, tolerances={f: Tolerance.symmetric(8 * um) for f in "ab"}, costs=fields,
        requirements={"y": Requirement(upper=limits["y"], target=0.99), "flank": Nominal(lower=limits["flank"])},
        variables=dict(diameter=Variable(0.06, 0.3, start=0.15), share=Variable(0.1, 0.6), play=Variable(0.0, 2e-3)),
        objective={"diameter": 65.0}, samples=4096, certificate_samples=20_000,
    )  # fmt: skip
    exact = differences(cost, limits)
    return Known(given, cost(limits), {"y": exact["y"], "flank": -exact["flank"]})


def _rows() -> dict[str, Problem]:
    closed = [name for name in known_optima.CASES if name != "200 fields"]
    kinds = {"listed-0": "lists", "middle-0": "mid-points", "capability-0": "Cpk", "undercut-0": "nominal"}
    rows = {name: Problem("closed form", functools.partial(published, name)) for name in closed}
    rows["200 fields"] = Problem("200 fields", functools.partial(published, "200 fields"))
    for name in [*codesign_cases.PROGRAMMES, "rv-0"]:
        right = codesign_cases.CASES[name]["expected"]["status"]
        kind = kinds.get(name, "codesign")
        rows[name] = Problem(kind, functools.partial(reference, name), right, alone=name == "rv-0")
    for seed in (2, 4, 9, 10, 12):  # curved, uniform, normal, curved and uniform, normal
        rows[f"random-{seed}"] = Problem("codesign", functools.partial(drawn_at_random, seed))
    return rows | {
        "long lists": Problem("lists", long_lists),
        "hopeless number": Problem("nominal", hopeless_number, "INFEASIBLE"),
        "two bounds": Problem("bounds", two_bounds),
        "finest field": Problem("bounds", finest_field),
        "grades": Problem("grades", cheapest_grades),
        "units that fail": Problem("failures", fragile),
        "units that fail, still": Problem("failures", functools.partial(fragile, middles=STILL)),
        "steps": Problem("steps", stepped),
        "steps, still": Problem("steps", functools.partial(stepped, middles=STILL)),
        "correlated": Problem("correlated", correlated),
        "joint target": Problem("joint", joint),
        "Cpk and shares": Problem("Cpk", capability),
        "target 99.99 %": Problem("rare", rare_target),
        "rv-40e": studied("rv-40e"),
        "rv-40e-whole": studied("rv-40e-whole"),
        "three cranks": studied(str(THREE_CRANKS)),
        "rv-40e-design": studied("rv-40e-design"),
        "number inside": Problem("small", number_inside),
        "number in a bend": Problem("small", number_in_a_bend),
        "mid-point inside": Problem("small", middle_inside),
        "mean of a number": Problem("small", mean_of_a_number),
        "rare pair": Problem("small", rare_pair),
        "flank and diameter": Problem("small", flank_and_diameter),
        "constant miss": Problem("small", constant_miss, "INFEASIBLE"),
        "own, 1024": studied(str(OWN)),
        "own, 4096": studied(str(OWN), samples=4096),
        "rv-20e, mid-point": begun("rv-20e", 0.99),
        "rv-320e, mid-point": begun("rv-320e", 0.99),
        "rv-20e, 99.73 %": begun("rv-20e", 0.9973),
        "rv-80e, 99.73 %": begun("rv-80e", 0.9973),
        "rv-320e, 99.73 %": begun("rv-320e", 0.9973),
        "cycloidal-17": studied("cycloidal-17"),
        "cycloidal-17-additive": studied("cycloidal-17-additive"),
    }


PROBLEMS = _rows()
