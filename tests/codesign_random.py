"""Random problems of design and tolerances together, with exact optima and prices.

A response is a monotone function of a sum of errors with coefficients of the numbers. All errors but the first are
normal; where the first one is uniform, shares are integrated over it (Gauss and Legendre).
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax.tolerances import Nominal, ReciprocalPower, Requirement, Tolerance, Variable

NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)
LEAST, MOST = 0.05, 3.0  # half-widths
_BINDS = 1e-5


@dataclasses.dataclass(frozen=True)
class Problem:
    """A random problem: coefficients of responses, limits, prices."""

    seed: int
    uniform: bool
    bend: float
    constant: np.ndarray  # (r, j) coefficients of errors
    linear: np.ndarray  # (r, j, k)
    mean: np.ndarray  # (r, k)
    limits: np.ndarray  # (r, 2)
    targets: np.ndarray  # (r,)
    prices: np.ndarray  # (j,) of 1/half-width
    own: np.ndarray  # (k,) of the squares of numbers
    size: float  # least product of the numbers

    @property
    def fields(self) -> list[str]:
        return [f"e{j}" for j in range(len(self.prices))]

    @property
    def numbers(self) -> list[str]:
        return [f"d{k}" for k in range(len(self.own))]

    def coefficients(self, d: jax.Array) -> jax.Array:
        return self.constant + self.linear @ d

    def bent(self, total: Any) -> Any:
        return total + self.bend * total**3

    def response(self, errors: Any, values: Any) -> dict[str, jax.Array]:
        d = jnp.stack([jnp.asarray(values[name]) for name in self.numbers])
        e = jnp.stack([jnp.asarray(errors[name]) for name in self.fields])
        total = self.coefficients(d) @ e + self.mean @ (d - 1)
        found = {f"y{r}": self.bent(total[r]) for r in range(len(self.limits))}
        return found | {"size": jnp.prod(d) + 0.0 * e.sum()}

    def arguments(self, **changes: Any) -> dict[str, Any]:
        """Arguments of `allocate`."""
        law = {"distribution": "uniform"} if self.uniform else {}
        tolerances = {name: Tolerance.symmetric(0.2, **(law if not j else {})) for j, name in enumerate(self.fields)}
        need = {
            f"y{r}": Requirement(lower=float(low), upper=float(high), target=float(self.targets[r]))
            for r, (low, high) in enumerate(self.limits)
        }
        costs = [ReciprocalPower(reference=float(p), finest=LEAST, coarsest=MOST) for p in self.prices]
        own = [lambda value, w=float(w): w * value**2 for w in self.own]
        return dict(
            response=self.response, tolerances=tolerances, requirements=need | {"size": Nominal(lower=self.size)},
            costs=dict(zip(self.fields, costs)),
            variables={name: Variable(0.5, 2.0, 1.2, cost=cost) for name, cost in zip(self.numbers, own)},
        ) | changes  # fmt: skip

    def exact(self) -> tuple[float, dict[str, float], np.ndarray]:
        """Least cost, {requirement: d cost / d limit}, and the vector (logarithms of half-widths, numbers)."""
        count = len(self.prices)

        def cost(x: np.ndarray) -> float:
            return float((self.prices * np.exp(-x[:count])).sum() + (self.own * x[count:] ** 2).sum())

        def slope(x: np.ndarray) -> np.ndarray:
            return np.append(-self.prices * np.exp(-x[:count]), 2 * self.own * x[count:])

        def held(x: jax.Array, wider: jax.Array) -> jax.Array:
            """Shares as deviates beyond their targets, and the nominal limit; >= 0."""
            t, d = jnp.exp(x[:count]), x[count:]
            slopes = self.coefficients(d)
            by = slopes * t[None] / 3
            first = slopes[:, :1] * t[0] * NODES[None] if self.uniform else jnp.zeros((len(slopes), len(NODES)))
            sd = jnp.sqrt((by[:, 1:] if self.uniform else by) ** 2 @ jnp.ones(count - self.uniform))
            middle = (self.mean @ (d - 1))[:, None] + first  # (r, nodes)
            ends = self._straight(self.limits + jnp.stack([-wider[:-1], wider[:-1]], axis=1))  # (r, 2)
            off = jnp.stack([ends[:, :1] - middle, middle - ends[:, 1:]]) / sd[None, :, None]
            shares = jax.scipy.special.ndtr(off).sum(axis=0) @ WEIGHTS / 2
            due = jax.scipy.special.ndtri(1 - jnp.asarray(self.targets))
            sized = jnp.prod(d) - self.size + wider[-1]
            return jnp.append(due - jax.scipy.special.ndtri(shares), sized)

        nothing = np.zeros(len(self.limits) + 1)
        both = jax.jit(lambda x: (held(x, nothing), *jax.jacrev(held, argnums=(0, 1))(x, nothing)))
        low = np.array([np.log(LEAST)] * count + [0.5] * len(self.own))
        high = np.array([np.log(MOST)] * count + [2.0] * len(self.own))
        rng, best = np.random.default_rng(self.seed), None
        for _ in range(6):
            start = np.concatenate([np.full(count, np.log(0.15)), rng.uniform(0.6, 1.9, len(self.own))])
            met = {
                "type": "ineq",
                "fun": lambda x: np.asarray(both(x)[0]),
                "jac": lambda x: np.asarray(both(x)[1]),
            }
            end = optimize.minimize(
                cost, start, jac=slope, constraints=[met], bounds=list(zip(low, high)), method="SLSQP",
                options={"ftol": 1e-13, "maxiter": 500},
            )  # fmt: skip
            if end.success and both(end.x)[0].min() > -1e-7 and (best is None or end.fun < best.fun):
                best = end
        x = best.x
        margins, by_x, by_limit = map(np.asarray, both(x))
        binding = np.flatnonzero(margins < _BINDS)
        inner = (x > low + 1e-6) & (x < high - 1e-6)
        found, _ = optimize.nnls(by_x[binding][:, inner].T, slope(x)[inner])
        prices = np.zeros(len(nothing))
        prices[binding] = -found
        names = [*(f"y{r}" for r in range(len(self.limits))), "size"]
        return float(best.fun), dict(zip(names, prices * np.diag(by_limit))), x

    def _straight(self, limit: Any) -> Any:
        """The sum of errors at which a response is at a limit."""
        if not self.bend:
            return limit
        found = limit
        for _ in range(8):  # of Newton
            found = found - (self.bent(found) - limit) / (1 + 3 * self.bend * found**2)
        return found


def problem(seed: int) -> Problem:
    """The random problem of a seed."""
    rng = np.random.default_rng([36, seed])
    errors, numbers, responses = int(rng.integers(3, 6)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    shape = (responses, errors)
    return Problem(
        seed, bool(seed % 3 == 1), 0.15 if seed % 4 == 2 else 0.0,
        rng.uniform(0.2, 1.5, shape) * rng.choice([-1, 1], shape), rng.uniform(-0.6, 0.6, (*shape, numbers)),
        rng.uniform(-0.4, 0.4, (responses, numbers)), np.stack([-rng.uniform(0.7, 1.2, responses),
        rng.uniform(0.7, 1.2, responses)], axis=1), rng.choice([0.99, 0.9973], responses),
        rng.uniform(0.3, 2.0, errors), rng.uniform(0.2, 3.0, numbers), float(rng.uniform(0.7, 1.3)) ** numbers,
    )  # fmt: skip
