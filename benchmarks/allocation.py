"""Allocation by gradients and by derivative-free optimisers: units evaluated until the cheapest tolerances are found.

First linear responses, with an optimum in closed form. Then two races, the RV-40E study with its five fields and a
linear response with forty. All optimisers minimise the same cost under the same sampled constraints (the same
units, the same quantiles), from the same start, in logarithms of the half-widths. One look costs `samples` units; a
unit's value with its gradient counts as three. An optimiser has arrived when its best tolerances so far cost at most
1 % more than the optimum, with no requirement violated by more than 0.2 % of the way from the nominal response to the
limit. The optimum is the cheapest such set of all optimisers. Most of them cannot detect that they have arrived: the
table also has the units until each of them stops.
"""

import math
import time

import numpy as np
from scipy import optimize, stats

from benchmarks.timing import arguments, publish, settings

settings()

from rvjax.response.response import PLAIN  # noqa: E402
from rvjax.study import load  # noqa: E402  (after the flags)
from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance, allocate  # noqa: E402
from rvjax.tolerances.allocation.constraints import constraints_of  # noqa: E402
from rvjax.tolerances.allocation.problem import problem_of  # noqa: E402
from rvjax.tolerances.allocation.programme import Programme  # noqa: E402
from rvjax.units import um  # noqa: E402

GRADIENT, VIOLATION, NEAR = 3, 2e-3, 1.01
CLOSED_FORM = {"two fields": (1.0, 2.0), "eight fields": (1.0, 2.0, 0.5, 3.0, 1.5, 0.7, 1.0, 2.5)}


class Race:
    """The common problem, with a record of (units, cost, violation) of everything an optimiser looked at."""

    def __init__(self, response, tolerances, requirements, costs, samples=16384):
        self.problem = problem_of(
            response, tolerances, requirements, costs=costs, correlation=None, confidence=0.95,
            certificate_samples=1_000_000, middles={}, variables={}, objective={}, losses=None, progress=False,
            memo=None, samples=samples, seed=0, joint_target=None, max_steps=300,
        )  # fmt: skip
        self.start = np.array([float(self.problem.population.active[name].half_width) for name in self.problem.priced])

    def begin(self):
        """Forget everything: each optimiser pays for all it sees."""
        self.constraints = constraints_of(self.problem)
        self.constraints.sample(self.problem.samples)
        self.constraints.begin(np.log(self.start))
        self.constraints.units.solved = 0
        self.low, self.high = self.problem.decisions.low, self.problem.decisions.high
        self.looks, self.memory = [], {}

    def look(self, x):
        """Cost and margins (relative) at logarithms of half-widths; one evaluation for both."""
        key = tuple(x)
        if key not in self.memory:
            seen = self.constraints.look(np.clip(x, self.low, self.high), sloped=False)
            self.memory[key] = seen.cost, seen.used - 1
            self.looks.append((self.constraints.units.solved, seen.cost, seen.excess))
        return self.memory[key]

    def penalised(self, x):
        """Cost with an exact penalty, and one for leaving the process range."""
        cost, margins = self.look(x)
        outside = np.maximum(0, self.low - x).sum() + np.maximum(0, x - self.high).sum()
        return cost + 100 * np.maximum(margins, 0).sum() + 10 * outside

    def gradients(self):
        """The search of the library; a gradient counts as two more units."""
        units, extra = self.constraints.units, GRADIENT - 1
        pulled = units.gradients

        def counted(population, errors, weights):
            units.solved += extra * errors.shape[1]
            return pulled(population, errors, weights)

        def look(x):
            seen = self.constraints.look(x)
            self.looks.append((units.solved, seen.cost, seen.excess))
            return seen

        units.gradients = counted
        return Programme(self.constraints, look).run(np.log(self.start), most=300)

    def cobyla(self, first_step):
        constraints = [
            {"type": "ineq", "fun": lambda x: -self.look(x)[1]},
            {"type": "ineq", "fun": lambda x: x - self.low},
            {"type": "ineq", "fun": lambda x: self.high - x},
        ]
        optimize.minimize(
            lambda x: self.look(x)[0] / 10,
            np.log(self.start),
            method="COBYLA",
            constraints=constraints,
            options=dict(rhobeg=first_step, tol=1e-4, maxiter=2000),
        )

    def cobyqa(self):
        met = optimize.NonlinearConstraint(lambda x: self.look(x)[1], -np.inf, 0)
        optimize.minimize(
            lambda x: self.look(x)[0] / 10,
            np.log(self.start),
            method="COBYQA",
            bounds=optimize.Bounds(self.low, self.high),
            constraints=[met],
            options=dict(initial_tr_radius=0.3, final_tr_radius=1e-3, maxfev=500),
        )

    def nelder_mead(self):
        options = dict(maxfev=3000, xatol=1e-4, fatol=1e-4, adaptive=True)
        optimize.minimize(self.penalised, np.log(self.start), method="Nelder-Mead", options=options)

    def powell(self):
        bounds = list(zip(self.low, self.high))
        optimize.minimize(self.penalised, np.log(self.start), method="Powell", bounds=bounds, options=dict(maxfev=3000))

    def evolution(self):
        bounds = list(zip(self.low, self.high))
        optimize.differential_evolution(
            self.penalised, bounds, x0=np.log(self.start), seed=0, maxiter=40, popsize=8, polish=False
        )


def linear(slopes):
    """Response, tolerances, requirement and costs of y = sum a_j e_j, and the cost of its closed-form optimum."""
    fields = [f"e{k:02d}" for k in range(len(slopes))]
    weights = dict(zip(fields, map(float, slopes)))
    response = lambda e: sum(weights[n] * e[n] for n in fields)  # noqa: E731
    limit = 5 * um * math.sqrt(sum(np.square(slopes)))
    shape = np.array(slopes) ** (-2 / 3)  # costs 1/t: t_j ~ (1/a_j^2)^(1/3)
    radius = 3 * limit / stats.norm.ppf((1 + 0.9973) / 2)
    t = shape * radius / math.sqrt(((np.array(slopes) * shape) ** 2).sum())
    tolerances = {n: Tolerance.symmetric(10 * um) for n in fields}
    costs = {n: ReciprocalPower(finest=0.1 * um, coarsest=1000 * um) for n in fields}
    return (response, tolerances, Requirement(lower=-limit, upper=limit), costs), float((10 * um / t).sum())


def closed_forms():
    """Cost found over cost of the closed form, certified by four million units."""
    figures = {}
    for name, slopes in CLOSED_FORM.items():
        (response, tolerances, requirement, costs), optimum = linear(slopes)
        options = dict(costs=costs, samples=65536, certificate_samples=4_000_000)
        found = allocate(response, tolerances, requirement, **options)
        figures[f"closed form, {name}: cost / optimum"] = found.cost / optimum
        figures[f"closed form, {name}: looks"] = len(found.history)
    return figures


def raced(title, race, names):
    """Let optimisers run and compare their records."""
    contenders = {
        "gradients": race.gradients,
        "COBYLA, first step 0.1": lambda: race.cobyla(0.1),
        "COBYLA, first step 1": lambda: race.cobyla(1.0),
        "COBYQA": race.cobyqa,
        "Nelder-Mead": race.nelder_mead,
        "Powell": race.powell,
        "differential evolution": race.evolution,
    }
    race.begin()
    race.gradients()  # compiles what all of them use
    looks, seconds, figures = {}, {}, {}
    for name in names or contenders:
        race.begin()
        start = time.perf_counter()
        contenders[name]()
        looks[name], seconds[name] = race.looks, time.perf_counter() - start
    optimum = min(cost for seen in looks.values() for _, cost, violation in seen if violation <= VIOLATION)
    figures[f"{title}: optimum of the sampled problem"] = optimum
    arrived = {}
    for name, seen in looks.items():
        good = [(units, cost) for units, cost, violation in seen if violation <= VIOLATION]
        arrived[name] = next((units for units, cost in good if cost <= NEAR * optimum), math.inf)
        figures[f"{title}, {name}: best cost / optimum"] = min((cost for _, cost in good), default=math.inf) / optimum
        figures[f"{title}, {name}: units until within 1 %"] = arrived[name]
        figures[f"{title}, {name}: times the units of gradients"] = arrived[name] / arrived["gradients"]
        figures[f"{title}, {name}: units until it stops"] = seen[-1][0]
        figures[f"{title}, {name}: times those of gradients"] = seen[-1][0] / looks["gradients"][-1][0]
        figures[f"{title}, {name}: looks"] = len(seen)
        figures[f"{title}, {name}: seconds"] = seconds[name]
    return figures


def main():
    """Print and publish the figures."""
    options = arguments(__doc__)
    study = load("rv-40e")
    (response, tolerances, requirement, costs), _ = linear(np.linspace(0.5, 3, 40))
    many = Race(response, tolerances, {PLAIN: requirement}, costs)
    rv = Race(study.response(), study.tolerances, study.requirements, study.costs, study.samples)
    figures = closed_forms()
    figures |= raced("forty fields", many, ("gradients", "COBYQA"))  # COBYLA meets no limit there
    figures |= raced("RV-40E", rv, ())
    publish("allocation", figures, options.json)


if __name__ == "__main__":
    main()
