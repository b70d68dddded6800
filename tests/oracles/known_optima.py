"""Allocations whose optimum is known without sampling: from the literature, or by Lagrange's conditions.

Normal distributions, limits of 3 standard deviations. For a linear response y = sum a_j e_j within +-L the share
within the limits is the target where sum (a_j t_j)^2 = (3 L / z)^2, z = Phi^-1((1 + target)/2); for limits of the
worst case sum |a_j| t_j = L. The least cost under such constraints, which are explicit in the half-widths, is found by
SLSQP in logarithms, and by the closed form t_j ~ (k_j b_j / a_j^2)^(1/(k_j + 2)) where one is published.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import optimize, stats

from rvjax.tolerances import Exponential, ReciprocalPower, Requirement, Tolerance, WorstCaseWithin
from tests.oracles.responses import Linear

INCH, MM = 0.0254, 1e-3
THREE_SIGMA = 2 * stats.norm.cdf(3.0) - 1  # z = 3: limits of the chain at 3 standard deviations, as in root sum squares


@dataclasses.dataclass(frozen=True)
class Case:
    """One allocation with its least cost.

    Attributes:
        source: of the inputs.
        response: of the errors.
        tolerances: where the search starts.
        requirements: of the response.
        costs: by field.
        optimum: least cost.
        share: of the good units with half-widths, in the order of the costs.
        published: least cost as published; None where there is none.
    """

    source: str
    response: Callable[[Any], Any]
    tolerances: dict[str, Tolerance]
    requirements: Any
    costs: dict[str, Any]
    optimum: float
    share: Callable[[np.ndarray], float] | None = None
    published: float | None = None


def least(
    costs: dict[str, Any], constraints: list[Callable[[np.ndarray], float]], start: float, half_widths: bool = False
) -> Any:
    """Least cost where every constraint of the half-widths is >= 0, or these; by SLSQP in logarithms of them."""
    models = list(costs.values())
    total = lambda x: float(sum(model(t) for model, t in zip(models, np.exp(x))))  # noqa: E731
    bounds = [(math.log(model.finest), math.log(model.coarsest)) for model in models]
    met = [{"type": "ineq", "fun": lambda x, g=g: g(np.exp(x))} for g in constraints]
    x0 = np.full(len(models), math.log(start))
    for known in (1e-12, 1e-10, 1e-8):  # at the finest its line search may end without a step
        options = dict(maxiter=1000, ftol=known)
        found = optimize.minimize(total, x0, bounds=bounds, constraints=met, method="SLSQP", options=options)
        if found.success:
            break
        x0 = np.clip(found.x, *np.array(bounds).T)
    assert found.success, found.message
    return np.exp(found.x) if half_widths else float(found.fun)


def squares(slopes: dict[str, float], costs: dict[str, Any], radius: float) -> Callable[[np.ndarray], float]:
    """1 - sum (a_j t_j)^2 / radius^2 over the fields with a cost."""
    a = np.array([slopes.get(name, 0.0) for name in costs])
    return lambda t: 1 - float(np.sum((a * t) ** 2)) / radius**2


def _within(slopes: np.ndarray, limit: float, fixed: float = 0.0) -> Callable[[np.ndarray], float]:
    """Share of the units with |sum a_j e_j| <= limit by half-widths; `fixed`: square of what other errors take."""
    return lambda t: float(2 * stats.norm.cdf(3 * limit / math.sqrt(np.sum((slopes * t) ** 2) + fixed)) - 1)


def shaft_and_housing(arithmetic: bool, target: float = THREE_SIGMA) -> Case:
    """The clearance -A + B - C + D - E + F - G = 0.020 +- 0.015 in; A, C and G are bought parts."""
    fitted = {"B": (0.15997, 0.43899), "D": (0.07202, 0.46823), "E": (0.12576, 0.46537), "F": (0.07202, 0.46823)}
    start = dict(A=0.0015, B=0.008, C=0.0025, D=0.002, E=0.006, F=0.002, G=0.0025)
    slopes = dict(A=-1.0, B=1.0, C=-1.0, D=1.0, E=-1.0, F=1.0, G=-1.0)
    bought, limit = [start[name] for name in "ACG"], 0.015
    b, k = np.array(list(fitted.values())).T
    power = 1 if arithmetic else 2
    reach = limit if arithmetic else 3 * limit / stats.norm.ppf((1 + target) / 2)
    left = reach**power - sum(t**power for t in bought)
    t = lambda price: (k * b / price) ** (1 / (k + power))  # noqa: E731
    price = optimize.brentq(lambda log: np.sum(t(math.exp(log)) ** power) - left, -30, 30, xtol=1e-14)
    optimum = len(b) + float(np.sum(b * t(math.exp(price)) ** -k))
    limits = dict(lower=-limit * INCH, upper=limit * INCH)
    process = dict(finest=1e-4 * INCH, coarsest=0.05 * INCH, fixed=1.0, reference=INCH)
    return Case(
        "Chase (1999), Tolerance allocation methods for designers, ADCATS 99-6: shaft and housing, "
        + ("worst case" if arithmetic else "root sum squares"),
        Linear(slopes),
        {name: Tolerance.symmetric(size * INCH) for name, size in start.items()},
        WorstCaseWithin(**limits) if arithmetic else Requirement(target=target, **limits),
        {name: ReciprocalPower(scale=scale, power=power, **process) for name, (scale, power) in fitted.items()},
        optimum,
        _within(np.ones(4), limit * INCH, sum((t * INCH) ** 2 for t in bought)),
        11.07 if arithmetic else 8.06,
    )


def overrunning_clutch() -> Case:
    """Contact angle arccos((hub + roller)/(cage - roller)) within 7 +- 2 degrees, 99.73 % of the units.

    Both limits are linear in the dimensions: hub + (1 + cos) roller - cos cage has one sign, so that the shares beyond
    them are exact. Costs assumed here.
    """
    nominal = dict(hub=55.29 * MM, roller=22.86 * MM, cage=101.60 * MM)
    costs = {
        name: ReciprocalPower(scale=scale, reference=50e-6, finest=1e-6, coarsest=1e-3)
        for name, scale in dict(hub=2.0, roller=1.0, cage=3.0).items()
    }

    def beyond(t: np.ndarray) -> float:
        share = 0.0
        for degrees, sign in ((5.0, 1.0), (9.0, -1.0)):
            cos = math.cos(math.radians(degrees))
            slopes = np.array([1.0, 1.0 + cos, -cos])
            middle = slopes @ np.array(list(nominal.values()))
            share += stats.norm.cdf(sign * middle / np.linalg.norm(slopes * t / 3))
        return share

    def angle(e: Any) -> Any:
        hub, roller, cage = (nominal[name] + e[name] for name in nominal)
        return jnp.arccos(jnp.minimum((hub + roller) / (cage - roller), 1.0))

    return Case(
        "one-way clutch of the tolerance literature, costs assumed",
        angle,
        {name: Tolerance.symmetric(50e-6) for name in nominal},
        Requirement(lower=math.radians(5.0), upper=math.radians(9.0), target=0.9973),
        costs,
        least(costs, [lambda t: 1 - beyond(t) / 0.0027], 30e-6),
    )


def shared_chains() -> Case:
    """Two chains with two dimensions in common, each 99.73 %."""
    slopes = {"y": dict(a=1.0, b=-1.0, c=2.0), "z": dict(b=1.0, c=1.0, d=-1.0)}
    limits = {"y": 60e-6, "z": 30e-6}
    scales = dict(a=1.0, b=2.0, c=3.0, d=1.0)
    costs = {n: ReciprocalPower(scale=s, power=1.5, finest=1e-6, coarsest=5e-4) for n, s in scales.items()}
    radius = {name: 3 * limit / stats.norm.ppf(1 - 0.0027 / 2) for name, limit in limits.items()}
    return Case(
        "two chains that share two dimensions",
        Linear(slopes),
        {name: Tolerance.symmetric(10e-6) for name in scales},
        {name: Requirement(lower=-limit, upper=limit, target=0.9973) for name, limit in limits.items()},
        costs,
        least(costs, [squares(slopes[name], costs, radius[name]) for name in slopes], 5e-6),
    )


def exponential_costs() -> Case:
    """Costs b exp(-t/d), 99 %."""
    slopes = dict(a=1.0, b=2.0, c=0.5)
    costs = {
        name: Exponential(scale=scale, decay=decay, finest=1e-6, coarsest=1e-3)
        for name, (scale, decay) in dict(a=(3.0, 20e-6), b=(5.0, 8e-6), c=(2.0, 40e-6)).items()
    }
    radius = 3 * 40e-6 / stats.norm.ppf(0.995)
    return Case(
        "exponential costs",
        Linear(slopes),
        {name: Tolerance.symmetric(10e-6) for name in slopes},
        Requirement(lower=-40e-6, upper=40e-6, target=0.99),
        costs,
        least(costs, [squares(slopes, costs, radius)], 5e-6),
    )


def pin_hinge(target: float = 0.99) -> Case:
    """A hinge pin must enter the holes of both leaves: 99 % of the hinges. Dimensions and costs assumed here.

    The gap is the radial clearance of pin and hole, less the distance between the axes of the holes. The holes of the
    leaves have errors across and along. With standard deviations sx and sy of their differences the distance is at
    most R for a share 1 - mean exp(-R^2/(2 (sx^2 cos^2 + sy^2 sin^2))) over all angles; R is normal.
    """
    nominal, scales = 60e-6, dict(body_x=1.0, body_y=4.0, leaf_x=2.0, leaf_y=0.5, hole=3.0, pin=1.0)
    costs = {
        name: ReciprocalPower(scale=scale, power=power, reference=20e-6, finest=1e-6, coarsest=1e-3)
        for (name, scale), power in zip(scales.items(), (1.0, 0.7, 1.3, 1.0, 0.8, 1.2))
    }
    theta = 2 * np.pi * np.arange(256) / 256
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)

    def failing(t: np.ndarray) -> float:
        variance = (t / 3) ** 2
        across = (variance[0] + variance[2]) * np.cos(theta) ** 2 + (variance[1] + variance[3]) * np.sin(theta) ** 2
        room = nominal + math.sqrt(variance[4] + variance[5]) * nodes
        beyond = np.where(room > 0, np.exp(-(room[:, None] ** 2) / (2 * across)).mean(axis=1), 1.0)
        return float(weights @ beyond / weights.sum())

    return Case(
        "pin and two leaves, dimensions and costs assumed",
        lambda e: nominal + e["hole"] - e["pin"] - jnp.hypot(e["body_x"] - e["leaf_x"], e["body_y"] - e["leaf_y"]),
        {name: Tolerance.symmetric(20e-6) for name in scales},
        Requirement(lower=0.0, target=target),
        costs,
        least(costs, [lambda t: 1 - failing(t) / (1 - target)], 20e-6),
        lambda t: 1 - failing(t),
    )


def many_fields(count: int = 200, target: float = 0.9973) -> Case:
    """Slopes from 0.2 to 3, unlike costs b_j/t^k_j: t_j ~ (k_j b_j/(price a_j^2))^(1/(k_j + 2))."""
    slopes, names = np.linspace(0.2, 3.0, count), [f"e{j:03d}" for j in range(count)]
    scales, powers = 1.0 + np.arange(count) % 7, 0.5 + 0.25 * (np.arange(count) % 6)
    limit = 20e-6
    radius = 3 * limit / stats.norm.ppf((1 + target) / 2)
    t = lambda log: (powers * scales * 1e-5**powers / (math.exp(log) * slopes**2)) ** (1 / (powers + 2))  # noqa: E731
    price = optimize.brentq(lambda log: math.log(np.sum((slopes * t(log)) ** 2) / radius**2), 0, 100, xtol=1e-13)
    return Case(
        f"{count} fields, closed form",
        Linear(dict(zip(names, slopes.tolist()))),
        {name: Tolerance.symmetric(5e-6) for name in names},
        Requirement(lower=-limit, upper=limit, target=target),
        {
            name: ReciprocalPower(scale=float(scale), power=float(power), finest=1e-7, coarsest=1e-3)
            for name, scale, power in zip(names, scales, powers)
        },
        float(np.sum(scales * (1e-5 / t(price)) ** powers)),
        _within(slopes, limit),
    )


CASES = {
    "shaft and housing, worst case": lambda: shaft_and_housing(arithmetic=True),
    "shaft and housing, root sum squares": lambda: shaft_and_housing(arithmetic=False),
    "overrunning clutch": overrunning_clutch,
    "shared chains": shared_chains,
    "exponential costs": exponential_costs,
    "hinge of two leaves": pin_hinge,
    "200 fields": many_fields,
}
"""Each makes its case."""
