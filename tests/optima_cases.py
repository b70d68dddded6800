"""Allocations of three errors, maybe a mid-point and a number, whose least cost is known without sampling.

Errors are normal, half-widths three standard deviations. Given b the response is a line of a and c, so that shares are
integrals of the normal law over b (Gauss and Legendre). The least cost for a share is found by SLSQP with these.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import optimize, stats

from rvjax.tolerances import Middle, ReciprocalPower, Requirement, Tolerance, Variable
from tests.oracles.responses import Made

NODES, WEIGHTS = np.polynomial.legendre.leggauss(120)
FINEST, COARSEST, REFERENCE = 0.02, 3.0, 0.3
FIELDS = "abc"


@dataclasses.dataclass(frozen=True)
class Case:
    """One allocation.

    Attributes:
        made: coefficients of the response.
        limits: of y, -inf or inf for none.
        target: share of good units.
        scales: costs of half-widths of `REFERENCE`; of the first two errors alone, where there are two.
        middle: range of the mid-point of b, which is given at 0; None where it is fixed.
        moving: cost of moving it by 1.
        number: range of d; None where it is 1.
        own: price of d.
        start: half-width of all errors.
    """

    made: dict[str, Any]
    limits: tuple[float, float]
    target: float = 0.99
    scales: tuple[float, ...] = (1.0, 1.0, 1.0)
    middle: tuple[float, float] | None = None
    moving: float = 0.0
    number: tuple[float, float] | None = None
    own: float = 0.0
    start: float = 0.1

    def arguments(self, costly: bool, **changes: Any) -> dict[str, Any]:
        """Arguments of `allocate`."""
        costs = [ReciprocalPower(reference=REFERENCE, finest=FINEST, coarsest=COARSEST, scale=s) for s in self.scales]
        low, high = self.limits
        given: dict[str, Any] = dict(
            response=Made(**self.made, costly=costly), costs=dict(zip(FIELDS, costs)),
            tolerances={name: Tolerance.symmetric(self.start, size=0.025) for name in FIELDS},
            requirements={"y": Requirement(lower=low, upper=high, target=self.target)},
            samples=4096, certificate_samples=20_000,
        )  # fmt: skip
        if self.middle:
            given["middles"] = {"b": Middle(*self.middle, scale=self.moving)}
        if self.number:
            own = (lambda d: self.own * d) if self.own else None
            given["variables"] = {"d": Variable(*self.number, start=0.7 * self.number[1], cost=own)}
        return given | changes

    def share(self, t: np.ndarray, m: float = 0.0, d: float = 1.0) -> float:
        """Share of good units with half-widths, the mid-point of b and the number."""
        t = np.append(t, self.start) if len(t) < len(FIELDS) else t
        made = Made(**self.made)
        low, high = self.limits
        if made.step:
            high = math.floor(high / made.step) * made.step
        if made.corner:
            high = math.sqrt(high**2 - made.corner**2)
            low = -high
        a, b, c = np.asarray(made.slopes) * d ** np.asarray(made.powers)
        reach = min(made.edge, abs(m) + 8 * t[1] / 3)
        ends = max(-reach, m - 8 * t[1] / 3), min(reach, m + 8 * t[1] / 3)
        at = (ends[0] + ends[1]) / 2 + (ends[1] - ends[0]) / 2 * NODES
        rest = math.hypot(a * t[0], c * t[2]) / 3
        known = b * at + made.bend * at**2 + made.base + made.shift * (d - 1) + made.bow * (d - 1) ** 2
        inside = stats.norm.cdf((high - known) / rest) - stats.norm.cdf((low - known) / rest)
        density = stats.norm.pdf(at, m, t[1] / 3)
        return float(WEIGHTS @ (inside * density)) * (ends[1] - ends[0]) / 2

    def cost(self, x: np.ndarray) -> float:
        """Cost of a vector: logarithms of the half-widths, mid-point, number."""
        widths = np.exp(x[: len(self.scales)])
        return float(np.dot(self.scales, REFERENCE / widths) + self.moving * abs(x[3]) + self.own * x[4])

    def price(self, share: float, near: np.ndarray) -> float:
        """Price of both limits moving outwards by a little, of steps by whole ones: differences of the least cost.

        Args:
            share: of good units.
            near: vector of the least cost for this share.
        """
        ends, (low, high) = [], self.limits
        for by in (-self.made.get("step", 1e-3), self.made.get("step", 1e-3)):
            ends.append((dataclasses.replace(self, limits=(low - by, high + by)).least(share, [near])[0], by))
        return (ends[1][0] - ends[0][0]) / (ends[1][1] - ends[0][1])

    def least(self, share: float, starts: Sequence[np.ndarray] = ()) -> tuple[float, np.ndarray]:
        """Least cost with a share of good units, and its vector; from two places, or from vectors that are near it."""
        bounds = [(math.log(FINEST), math.log(COARSEST))] * 3 + [self.middle or (0.0, 0.0), self.number or (1.0, 1.0)]
        bounds[len(self.scales) : 3] = [(math.log(self.start),) * 2] * (3 - len(self.scales))
        deviate = stats.norm.ppf(share)
        met = {
            "type": "ineq",
            "fun": lambda x: stats.norm.ppf(min(max(self.share(np.exp(x[:3]), *x[3:]), 1e-12), 1 - 1e-12)) - deviate,
        }
        ends, ways = [], [[low + part * (high - low) for low, high in bounds[3:]] for part in (0.3, 0.6)]
        for start in starts or [np.array([math.log(0.2)] * 3 + way) for way in ways]:
            ends.append(optimize.minimize(self.cost, start, bounds=bounds, constraints=[met], method="SLSQP",
                                          options=dict(ftol=1e-10, maxiter=300)))  # fmt: skip
        good = [end for end in ends if met["fun"](end.x) > -1e-5]
        best = min(good, key=lambda end: end.fun)
        return float(best.fun), best.x


LINE = dict(slopes=(1.0, 2.0, -0.5))
BENT = dict(slopes=(1.0, 0.3, -0.5), bend=1.5)
CORNER = dict(slopes=(1.0, 2.0, -0.5), corner=0.05)
LEVER = dict(slopes=(1.0, 1.0, 0.5), powers=(1.0, -1.0, 0.0))
FREE = dict(middle=(-0.6, 0.6))

CASES = {
    "line": Case(LINE, (-1.0, 1.0), scales=(1.0, 2.0, 0.5)),
    "line, mid-point": Case(LINE, (-0.6, 1.0), **FREE, moving=0.5),
    "line, number": Case(LEVER, (-1.0, 1.0), number=(0.4, 3.0)),
    "square": Case(BENT, (-math.inf, 0.5)),
    "square, mid-point": Case(BENT, (-math.inf, 0.5), **FREE),
    "square, number": Case(BENT | dict(bow=1.0), (-math.inf, 0.5), number=(0.2, 2.0)),
    "corner": Case(CORNER, (-math.inf, 0.4)),
    "corner, mid-point": Case(CORNER | dict(base=0.3), (-math.inf, 0.4), **FREE),
    "corner, number": Case(CORNER | dict(shift=1.0, base=0.4), (-math.inf, 0.4), number=(0.2, 2.0), own=0.3),
    "99.73 %": Case(LINE, (-1.0, 1.0), 0.9973),
    "failing": Case(LINE | dict(edge=0.15), (-1.0, 1.0), scales=(1.0, 1.0)),
    "steps": Case(BENT | dict(step=0.1), (-math.inf, 0.55), scales=(1.0, 2.0)),
}
"""Problems by name."""
