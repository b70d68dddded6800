"""Numbers of the design, mid-points and half-widths together, and a baseline: cost, evaluations, CPU seconds.

The reference problems of `tests/reference/codesign.json` have exact optima. The baseline is SLSQP of SciPy on 16384
Sobol units with derivatives of the sampled quantiles, from three starts; its margins are corrected four times by a
million other units. `python -m benchmarks.codesign [--alone] [problem ...]`.
"""

import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402  (after the flags)
import numpy as np  # noqa: E402
from scipy import optimize, special  # noqa: E402
from scipy.stats import qmc  # noqa: E402

from rvjax.tolerances import Nominal, Requirement, allocate  # noqa: E402
from tests.codesign_cases import CASES, PROGRAMMES, arguments  # noqa: E402

UNITS, FRESH, CORRECTIONS, STARTS = 16_384, 1_000_000, 4, 3
WINDOW = 128  # units whose derivatives are the slope of a quantile


def baseline(given):
    """Least cost and evaluations of units; problems with shares, nominal limits and no mid-points."""
    problem = arguments(given)
    priced, variables, response = problem["costs"], problem["variables"], problem["response"]
    names, fields = list(variables), list(problem["tolerances"])
    middles = jnp.array([float(problem["tolerances"][f].middle) for f in fields])
    fixed = {f: float(problem["tolerances"][f].half_width) for f in fields}
    objective = problem["objective"] or {}
    spent = [0]

    def unit(x, z):
        t = fixed | {f: jnp.exp(x[j]) for j, f in enumerate(priced)}
        values = dict(zip(names, x[len(priced) :]))
        errors = {f: middles[k] + t[f] / 3 * z[k] for k, f in enumerate(fields)}
        return response(errors, values)

    every = jax.jit(jax.vmap(unit, (None, 1)))

    def cost(x):
        own = sum(variables[n].cost(v) if variables[n].cost else 0.0 for n, v in zip(names, x[len(priced) :]))
        widths = sum(c(jnp.exp(x[j])) for j, c in enumerate(priced.values()))
        return widths + own + sum(p * unit(x, jnp.zeros(len(fields)))[n] for n, p in objective.items())

    cost_of, offsets = jax.jit(jax.value_and_grad(cost)), {}
    z = special.ndtri(np.clip(qmc.Sobol(len(fields), seed=1).random(UNITS), 1e-12, 1 - 1e-12)).T
    slopes = {
        n: jax.jit(lambda x, z, n=n: jax.vmap(jax.grad(lambda x, z: unit(x, z)[n]), (None, 1))(x, z))
        for n in problem["requirements"]
    }

    def margin(name, item, x, z):
        if isinstance(item, Nominal):
            value = float(unit(x, jnp.zeros(len(fields)))[name])
            slope = np.asarray(slopes[name](x, jnp.zeros((len(fields), 1))))[0]
            return item.margin(value), float(item.outward(np.array(value))) * slope
        values = np.asarray(every(x, z)[name])
        margins, spent[0] = item.margin(values), spent[0] + len(values)
        order, level = np.argsort(margins), round(item.target * len(margins))
        near = order[max(0, level - WINDOW // 2) : level + WINDOW // 2]
        slope = np.asarray(slopes[name](x, jnp.asarray(z[:, near]))) * item.outward(values[near])[:, None]
        return float(margins[order[level]]) + offsets.get(name, 0.0), slope.mean(axis=0)

    def size(item):
        return abs(item.upper if np.isfinite(item.upper) else item.lower)

    bounds = [(float(np.log(c.finest)), float(np.log(c.coarsest))) for c in priced.values()]
    bounds += [(v.lower, v.upper) for v in variables.values()]
    scale = np.array([1.0] * len(priced) + [v.upper - v.lower for v in variables.values()])
    rng, best = np.random.default_rng(2), None
    for number in range(STARTS):
        x = np.array([np.log(fixed[f]) for f in priced] + [v.first for v in variables.values()])
        if number:
            x[len(priced) :] = [rng.uniform(v.lower, v.upper) for v in variables.values()]
        offsets.clear()
        for _ in range(1 + CORRECTIONS):
            constraints = [
                dict(
                    type="ineq",
                    fun=lambda u, n=n, i=i: -margin(n, i, u * scale, z)[0] / size(i),
                    jac=lambda u, n=n, i=i: -margin(n, i, u * scale, z)[1] * scale / size(i),
                )
                for n, i in problem["requirements"].items()
            ]
            ended = optimize.minimize(
                lambda u: float(cost_of(u * scale)[0]),
                x / scale,
                jac=lambda u: np.asarray(cost_of(u * scale)[1]) * scale,
                bounds=[(a / s, b / s) for (a, b), s in zip(bounds, scale)],
                constraints=constraints,
                method="SLSQP",
            )
            x = ended.x * scale
            fresh = np.random.default_rng(number + 5).standard_normal((len(fields), FRESH))
            for n, item in problem["requirements"].items():
                if isinstance(item, Requirement):
                    offsets[n] = offsets.get(n, 0.0) + margin(n, item, x, fresh)[0] - margin(n, item, x, z)[0]
        best = ended.fun if best is None or (ended.success and ended.fun < best) else best
    return best, spent[0]


def library(given):
    """The same by `allocate`, with its certificate."""
    problem = arguments(given)
    found = allocate(problem.pop("response"), problem.pop("tolerances"), problem.pop("requirements"), **problem)
    return found, found.evaluations["search"]


def main(names, alone):
    """Print one line for each problem, without the baseline if the library runs alone."""
    head = f"{'problem':16} found/optimum  {'status':10}  evaluations  CPU s |"
    print(head + "  baseline: found/optimum  evaluations  CPU s")
    for name in names:
        given, expected = CASES[name]["given"], CASES[name]["expected"]
        start = time.process_time()
        found, evaluations = library(given)
        line = f"{name:16} {found.cost / expected.get('cost', np.nan):13.4f}  {found.status:10} {evaluations:12} "
        line += f"{time.process_time() - start:6.1f} |"
        kinds = {item["kind"] for item in given["requirements"].values()}
        if (
            not alone
            and "cpk" not in kinds
            and not given.get("middles")
            and name.split("-")[0] not in ("listed", "refused")
        ):
            start = time.process_time()
            cost, spent = baseline(given)
            line += f" {cost / expected['cost']:23.4f} {spent:12} {time.process_time() - start:6.1f}"
        print(line, flush=True)


if __name__ == "__main__":
    main([name for name in sys.argv[1:] if name in CASES] or PROGRAMMES, "--alone" in sys.argv)
