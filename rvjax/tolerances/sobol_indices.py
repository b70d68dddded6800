"""Sobol indices: share of each error in the variance of a response, without and with interactions."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax._jax.sizes import padded
from rvjax.base import frames
from rvjax.population import (
    SCRAMBLES,
    Correlation,
    Estimate,
    Population,
    SobolPoints,
    of_groups,
    one_decides,
    unknown_share,
)
from rvjax.records import PyTree
from rvjax.response import Response, respond, response_names, unwrapped
from rvjax.status import succeeded

if TYPE_CHECKING:
    from rvjax.base.frames import DataFrame

_FEWEST = 2 * SCRAMBLES


@dataclasses.dataclass(frozen=True)
class SobolIndices:
    """Shares of the variance of a response; every share has the response's structure.

    Attributes:
        first: {field: `Estimate`} of var(E[y | field])/var(y), the share of the field alone.
        total: {field: `Estimate`} of E[var(y | all others)]/var(y), with all its interactions.
        trusted: False if one unit has a quarter of the variance of 1024 units (a tenth of that of very many): the
            variance may not exist. The interval of each share is then 0 to 1.
        samples: rows of the design, each one unit of A, of B and of every mixture.
        used: rows without a failed unit; the shares are theirs.
        failed: units without a valid response.
        evaluations: units evaluated, samples (fields + 2).
        seed: of the scrambles.
    """

    first: PyTree
    total: PyTree
    trusted: PyTree
    samples: int
    used: int
    failed: int
    evaluations: int
    seed: int

    def to_pandas(self) -> "DataFrame":
        """A `pandas.DataFrame`: one row for each field and response, both shares with their errors and intervals."""
        plain = any(isinstance(item, Estimate) for item in self.first.values())
        first, total, trusted = (
            {"response": shares} if plain else shares for shares in (self.first, self.total, self.trusted)
        )
        rows = [
            {"field": field, "response": name}
            | frames.spread("first", one)
            | frames.spread("total", total[name][field])
            | {"trusted": trusted[name]}
            for name, shares in first.items()
            for field, one in shares.items()
        ]
        return frames.tidy(rows, ["field", "response"])


@checked
def sobol_indices(
    response: Response,
    tolerances: object,
    *,
    samples: int,
    seed: int,
    chunk: int = 65536,
    correlation: Correlation = None,
) -> SobolIndices:
    """Variance-based sensitivity indices of every field, in constant memory.

    Two samples A and B of units, and for each field i the sample AB_i: A with field i taken from B
    (Saltelli et al. 2010, Comput. Phys. Commun. 181, 259). An array field is one group. A and B are the
    two halves of the coordinates of 16 independently scrambled Sobol sequences, unit j being point
    j // 16 of sequence j mod 16. Standard errors come from the spread of the 16 sequences, intervals
    (95 %) from Student's distribution with 15 degrees of freedom. Shares of a variance that may not exist have the
    interval 0 to 1 (`trusted`). A field that the response does not read has
    indices of exactly 0; a constant response gives 0 for all.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        samples: rows, at least 32; 16 times a power of two is best. Cost: samples (fields + 2) units.
        seed: of the scrambles.
        chunk: units evaluated at once.
        correlation: must be empty; a share of the variance is defined for independent fields only.

    Returns:
        `SobolIndices`. Rows with a failed unit are excluded.

    Raises:
        ValueError: correlated fields, or too few samples.
    """
    population = Population.of(tolerances)
    if correlation or population.mixing is not None:
        raise ValueError("correlation: Sobol indices are defined for independent fields only; see rss for shares")
    if samples < _FEWEST:
        raise ValueError(f"samples = {samples!r}: must be at least {_FEWEST}, two for each of {SCRAMBLES} scrambles")
    if chunk < 1:
        raise ValueError(f"chunk = {chunk!r}: must be at least 1")
    names, fields = response_names(response, population), tuple(population.active)
    sums = {name: _Sums(len(fields)) for name in names}
    used = failed = 0
    points, block = SobolPoints(2 * population.numbers, seed), min(chunk, samples)
    for start in range(0, samples, block):
        count = min(block, samples - start)
        z = padded(points.z(start, count), block, axis=1, fill=0)  # one program for chunks of one length
        a, b = np.split(z, 2)
        mixtures = (mixed for _, mixed in population.exchanged(a, b))
        rows = [_evaluated(response, population, units, count) for units in itertools.chain([a, b], mixtures)]
        good = np.all([valid for _, valid in rows], axis=0)
        used += int(good.sum())
        failed += sum(int((~valid).sum()) for _, valid in rows)
        scramble = (start + np.flatnonzero(good)) % SCRAMBLES
        for name in names:
            sums[name].add([values[name][good] for values, _ in rows], scramble)
    shares = {name: item.shares(fields) for name, item in sums.items()}
    found = SobolIndices(
        first={name: first for name, (first, _) in shares.items()},
        total={name: total for name, (_, total) in shares.items()},
        trusted={name: item.trusted for name, item in sums.items()},
        samples=samples,
        used=used,
        failed=failed,
        evaluations=samples * (len(fields) + 2),
        seed=seed,
    )
    return unwrapped(found)


def _evaluated(
    response: Response, population: Population, z: np.ndarray, count: int
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Values and validity of the first `count` units."""
    values, status = respond(response, population, np.asarray(z, jnp.result_type(float)))
    found = {n: np.asarray(v, float)[:count] for n, v in values.items()}
    finite = np.all([np.isfinite(row) for row in found.values()], axis=0)  # no variance counts an infinite value
    return found, succeeded(np.asarray(status))[:count] & finite


class _Sums:
    """Sums over rows by scramble, of one response: constant memory."""

    def __init__(self, fields: int) -> None:
        self.origin: float | None = None  # values are taken relative to the first one, which keeps their digits
        self.scale = 1.0  # times a power of two, which keeps them too: the square of 1e160 is no number
        self.own = np.zeros((5, SCRAMBLES))  # rows, a, b, a^2, b^2
        self.crossed = np.zeros((3, fields, SCRAMBLES))  # b (ab - a), ab - a, (ab - a)^2
        self.ends = np.zeros(2)  # least and largest of a and b

    def add(self, rows: list[np.ndarray], scramble: np.ndarray) -> None:
        """Take in A, B and every AB_i of the next chunk, and the scramble of each row."""
        a, b, *_ = rows
        if not a.size:
            return
        if self.origin is None:
            self.scale = 2.0 ** -max(math.frexp(max(np.abs(a).max(), np.abs(b).max()))[1], -1000)
            self.origin = float(a[0]) * self.scale
        a, b, *mixed = (self.scale * row - self.origin for row in rows)
        self.ends = np.array([min(self.ends[0], a.min(), b.min()), max(self.ends[1], a.max(), b.max())])
        summed: Callable[[np.ndarray], np.ndarray] = lambda values: np.bincount(scramble, values, SCRAMBLES)  # noqa: E731
        self.own += [summed(v) for v in (np.ones(len(a)), a, b, a * a, b * b)]
        for i, row in enumerate(mixed):
            step = row - a
            self.crossed[:, i] += [summed(b * step), summed(step), summed(step * step)]

    def shares(self, fields: tuple[str, ...]) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
        """First and total indices of the fields."""
        if not self.own[0].any():
            nothing = dict.fromkeys(fields, Estimate.about(math.nan, math.nan, 0.0))
            return nothing, dict(nothing)
        mean, variance = self._spread()
        crossed, steps, squares = self.crossed
        # Saltelli et al. 2010, Table 2: (b) with f_B centred, which removes most of its variance, and (f), Jansen's.
        first = {name: self._share(crossed[i] - mean * steps[i], variance) for i, name in enumerate(fields)}
        total = {name: self._share(squares[i] / 2, variance) for i, name in enumerate(fields)}
        return first, total

    def _spread(self) -> tuple[float, np.ndarray]:
        """Mean, and the variance times the rows of every scramble."""
        rows, a, b, aa, bb = self.own
        mean = float((a + b).sum() / (2 * rows.sum()))
        return mean, (aa + bb - 2 * mean * (a + b)) / 2 + rows * mean**2

    @property
    def trusted(self) -> bool:
        """True unless one unit has a large part of the variance."""
        n = float(self.own[0].sum())
        if not n:
            return True
        mean, variance = self._spread()
        return not one_decides(float(np.max((self.ends - mean) ** 2)), 2 * float(variance.sum()), 2 * n)

    def _share(self, parts: np.ndarray, variances: np.ndarray) -> Estimate:
        """Return the share of a field: the ratio of two sums over scrambles.

        Its error comes from the spread of the linearised ratio between them. Of a variance that is not to be trusted
        nothing is known, unless the share is 0.
        """
        whole, share = variances.sum(), Estimate(0.0, 0.0, 0.0, 0.0)
        if not whole <= 0:
            ratio = float(parts.sum() / whole)
            scatter = (parts - ratio * variances) / whole * SCRAMBLES  # of the linearised ratio; its mean is 0
            share = of_groups(ratio + scatter, ratio, 0.95)
        return unknown_share(share) if parts.any() and not self.trusted else share
