"""Coverage of the intervals of `monte_carlo` and `sobol_indices` on distributions with known statistics."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import integrate, stats

from rvjax.tolerances import Requirement, Tolerance, monte_carlo, sobol_indices

PAIR = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0)}  # two standard normal numbers
ROOT = math.sqrt(2)
NORM = stats.norm
SECOND = 1.5  # limit of (a - b)/sqrt 2, the second response of the joint yield
QUANTILES = (0.05, 0.5, 0.99)
UNITS, ROWS = 1024, 512


@dataclasses.dataclass(frozen=True)
class Law:
    """A response y of a and b, its distribution, and P(y <= u | (a - b)/sqrt 2 = d)."""

    of: Callable[[Any, Any], Any]
    law: Any
    given: Callable[[float, float], float]

    @functools.cached_property
    def limit(self):
        """Held by nine units in ten or a few more."""
        return float(self.law.ppf(0.9)) + 0.25

    @functools.cached_property
    def exact(self):
        """Every figure."""
        passed = float(self.law.cdf(self.limit))
        joint = integrate.quad(lambda d: NORM.pdf(d) * self.given(self.limit, d), -9, SECOND, points=(0.0,), limit=200)
        x = np.linspace(-8, 8, 2001)[:-1] + 0.004
        p = NORM.pdf(x) / NORM.pdf(x).sum()
        values = np.asarray(self.of(x[:, None], x[None, :]), float)
        first = float(p @ (values @ p - p @ values @ p) ** 2) / float(p @ (values - p @ values @ p) ** 2 @ p)
        return {
            "mean": float(self.law.mean()),
            "sd": float(self.law.std()),
            **{f"quantile {q}": float(self.law.ppf(q)) for q in QUANTILES},
            "yield": passed,
            "ppm": 1e6 * (1 - passed),
            "joint yield": joint[0],
            "first index": first,
            "total index": 1 - first,  # two fields alike
        }


def _of_sum(function, law, inverse):
    """Distribution of s = (a + b)/sqrt 2, which is independent of (a - b)/sqrt 2."""
    return Law(lambda a, b: function((a + b) / ROOT), law, lambda u, d: inverse(u))


class _Steps:
    """floor(2 s) of a standard normal s."""

    k = np.arange(-20, 20)
    p = np.diff(NORM.cdf(np.arange(-20, 21) / 2))
    mean = functools.partial(lambda k, p: k @ p, k, p)
    std = functools.partial(lambda k, p: math.sqrt(k**2 @ p - (k @ p) ** 2), k, p)
    ppf = staticmethod(lambda q: math.floor(2 * NORM.ppf(q)))
    cdf = staticmethod(lambda u: NORM.cdf((math.floor(u) + 1) / 2))


class _Largest:
    """The larger of two standard normal numbers."""

    mean = staticmethod(lambda: 1 / math.sqrt(math.pi))
    std = staticmethod(lambda: math.sqrt(1 - 1 / math.pi))
    ppf = staticmethod(lambda q: NORM.ppf(math.sqrt(q)))
    cdf = staticmethod(lambda u: NORM.cdf(u) ** 2)


def _exponential_given(u, d):
    """a^2 + b^2 = s^2 + d^2."""
    return 2 * NORM.cdf(math.sqrt(max(0.0, 2 * u - d * d))) - 1


LAWS = {
    "normal": _of_sum(lambda s: s, NORM, NORM.cdf),
    "lognormal": _of_sum(lambda s: jnp.exp(0.5 * s), stats.lognorm(0.5), lambda u: NORM.cdf(2 * math.log(u))),
    "chi-square": Law(lambda a, b: (a * a + b * b) / 2, stats.expon, _exponential_given),
    "kinked": _of_sum(jnp.abs, stats.halfnorm, lambda u: 2 * NORM.cdf(u) - 1),
    "maximum": Law(jnp.maximum, _Largest, lambda u, d: NORM.cdf(ROOT * u - abs(d))),
    "discrete": _of_sum(lambda s: jnp.floor(2 * s), _Steps, _Steps.cdf),
}


def held(name: str, method: str, seeds: int) -> dict[str, float]:
    """Share of the seeds at which each interval holds its exact figure."""
    law, found = LAWS[name], []
    response = lambda e: {"y": law.of(e["a"], e["b"]), "d": (e["a"] - e["b"]) / ROOT}  # noqa: E731
    need = {"y": Requirement(upper=law.limit), "d": Requirement(upper=SECOND)}
    for seed in range(seeds):
        options = dict(samples=UNITS, chunk=UNITS, method=method, requirements=need, quantiles=QUANTILES)
        run = monte_carlo(response, PAIR, seed=seed, **options)
        figures = {"mean": run.mean["y"], "sd": run.sd["y"], "yield": run.yield_["y"], "ppm": run.ppm["y"]}
        figures |= {f"quantile {q}": run.quantiles[q]["y"] for q in QUANTILES} | {"joint yield": run.joint_yield}
        if method == "sobol":
            indices = sobol_indices(lambda e: law.of(e["a"], e["b"]), PAIR, samples=ROWS, seed=seed, chunk=ROWS)
            figures |= {"first index": indices.first["a"], "total index": indices.total["a"]}
        inside = {n: f.lower - 1e-9 <= law.exact[n] <= f.upper + 1e-9 for n, f in figures.items()}
        inside["yield, lower end"] = run.yield_["y"].lower <= law.exact["yield"]
        found.append(inside)
    return {n: float(np.mean([each[n] for each in found])) for n in found[0]} | {"seeds": seeds}
