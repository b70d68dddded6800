"""Constraints of an allocation at one vector of decisions: used ways of all limits and their derivatives.

The used way of a limit is r = 1 + q/W: q is how far the quantile of the units at the wanted share lies beyond the limit
(a statistic or an output without errors in its place), W the way from the median to the limit. r <= 1 is met. Squares
of the used ways are nearly linear in the squares of the half-widths, because variances add.
"""

import functools
import math
from collections.abc import Collection, Iterator

import numpy as np
from scipy import special

from rvjax._jax.sizes import PULLED
from rvjax.population import first_points
from rvjax.response import response_names
from rvjax.tolerances.allocation.decisions import AT
from rvjax.tolerances.allocation.look import DECIDES, Look, rows_of
from rvjax.tolerances.allocation.problem import FEW, QUICK, STAGES, Problem
from rvjax.tolerances.allocation.sample import Limited, NearUnits, Units, Values
from rvjax.tolerances.allocation.tails import Centres, Quantile, TailSample, centres_of, quantile
from rvjax.tolerances.allocation.whole_sample import WholeSample, nominal_outputs
from rvjax.tolerances.limits import Limits

_BEYOND = 40  # units of the last sample beyond each limit that decides
_MOST = 16_384  # units of a sample that grows, at most
_FIELDS = 60  # decisions that `QUICK` units are enough for: more learn the sample by heart
_PART = 2  # times as many units in the tails as are behind a slope, at least
_SMALL = 1e-3  # way of a limit in parts of the spread, where the median lies beyond it


class Constraints(WholeSample):
    """Constraints of a problem on a plain sample that grows: of few units, and later of those near a limit alone."""

    def __init__(self, problem: Problem, first: int) -> None:
        """Of a problem, with so many units for the first look."""
        self.problem, self.decisions, self.first = problem, problem.decisions, first
        required = problem.requirements
        self.rows = rows_of(required, joint=problem.joint_target is not None)
        self.most_failed = min((i.most_failed for i in required.values() if i.most_failed < 1), default=None)
        wanted = {n for n, i in required.items() if i.of_sample} | set(problem.losses)
        self.units = Units(problem.response, self.decisions, wanted, problem.memo)
        self.names = response_names(problem.response, self.decisions.base)
        outputs = {n for n, item in required.items() if not item.of_sample} | set(problem.objective)
        self.outputs = tuple(sorted(outputs))  # without errors
        self.ways = np.ones(len(self.rows))
        self.moved = np.array([AT if row.exact else 0.0 for row in self.rows])
        """Corrections (c,) of the used ways that are no quantiles."""
        self.rejects = np.array([self.target(k) for k in range(len(self.rows))])
        """Share of units (c,) that may lie beyond each limit on the sample; 0 where no share is limited."""
        self.aside: frozenset[str] = frozenset()
        self._near: NearUnits | None = None
        self.sample(first)

    def target(self, k: int) -> float:
        """Share of units that a row lets lie beyond its limit; 0 where it limits no share."""
        row = self.rows[k]
        if not row.share:
            return 0.0
        joint = self.problem.joint_target
        return 1 - float(getattr(row.item, "target", joint if joint is not None else 0.0))

    # The sample.

    def counts(self, look: Look) -> list[int]:
        """Units of the samples to come.

        Args:
            look: at the end of the search on the first sample.
        """
        near = [1 - getattr(r.item, "target", self.problem.joint_target or 0.0)
                for k, r in enumerate(self.rows) if r.share and look.used[k] > DECIDES]  # fmt: skip
        wanted = 2 ** math.ceil(math.log2(_BEYOND / min(near, default=1.0)))
        last = min(max(wanted, min(self.problem.samples, QUICK), FEW), _MOST)
        return [*(count for count in STAGES if count < last), last] if last > FEW else []

    def sample(self, count: int) -> None:
        """Take so many plain units; fewer ones are among them."""
        numbers = self.decisions.base.numbers
        plain = first_points(numbers, self.problem.seed, count) if self.units.parts else np.zeros((numbers, 0))
        self.plain, self.tails = plain, TailSample(plain, self.problem.seed)
        self.count, self._near = count, None

    def begin(self, x: np.ndarray) -> None:
        """Measure the way of each limit: of the median to it, without priced errors or at the start."""
        free = self.decisions.without_errors(x)
        values = [self.units.values(p, self.plain) for p in (free, self.decisions.population(x))]
        outputs, _ = nominal_outputs(self.problem.response, self.decisions.population(x), self.outputs)
        for k, row in enumerate(self.rows):
            if row.item is None:
                continue
            if row.nominal:
                self.ways[k] = _size(row.item) or abs(outputs[row.name]) or 1.0
                continue
            if not row.item.limits_values:
                self.ways[k] = row.item.upper
                continue
            ways = [self._inside(row.item, found[row.name]) for found in values]
            finite = values[1][row.name][np.isfinite(values[1][row.name])]
            spread = float(finite.std()) if len(finite) else 0.0
            least = _SMALL * spread or 1e-12 * _size(row.item) or 1e-300
            beyond = -max(ways) if math.isfinite(max(ways)) else 0.0
            self.ways[k] = max(*ways, least) if max(ways) > 0 else max(spread, beyond, least)

    @staticmethod
    def _inside(item: Limits, values: np.ndarray) -> float:
        """Distance of the median inside the limits."""
        margins = item.margin(values[np.isfinite(values)])
        return -float(np.median(margins)) if len(margins) else -math.inf

    def place(self, x: np.ndarray) -> None:
        """Put units into the tails that decide at a vector; a sample that grows has none there."""

    def spare(self, look: Look | None) -> None:
        """Solve few units of responses whose limits do not decide at a look; None: all units of all."""
        self.aside, self._near = frozenset() if look is None else self.far(look), None

    def far(self, look: Look) -> frozenset[str]:
        """Responses whose limits do not decide at a look; none where all decide together.

        Args:
            look: of the search.
        """
        if self.problem.joint_target is not None:
            return frozenset()
        inside = {row.name for row, used in zip(self.rows, look.used) if row.share and used <= DECIDES}
        return frozenset(inside - set(self.problem.losses))

    @property
    def by_quantiles(self) -> bool:
        """True if units matter for quantiles alone, so that those near them are enough."""
        alone = all(row.share or row.nominal or row.exact for row in self.rows)
        return alone and not self.problem.losses

    def limits(self, names: Collection[str] | None = None) -> list[Limited]:
        """Limits on shares, which decide what units are near.

        Args:
            names: of the responses; None: all.
        """
        together = tuple(n for n, i in self.problem.requirements.items() if i.of_units)
        return [
            Limited((r.name,) if r.item else together, functools.partial(self._in_ways, k), float(self.rejects[k]))
            for k, r in enumerate(self.rows)
            if r.share and (names is None or r.item is None or r.name in names)
        ]

    def _in_ways(self, k: int, values: Values) -> np.ndarray:
        """Margins (n,) of the units of a row on a share, in ways of the limit."""
        return self.margins(k, values)[0] / self.ways[k]

    def values(self, x: np.ndarray) -> Values:
        """Values (n,) of the sample at a vector by name, nan where a unit failed; none where no share is limited."""
        if not any(row.share for row in self.rows):
            return {}
        population = self.decisions.population(x)
        if self._near is not None:
            return self._near.values(population, self.limits())
        found = self.units.values(population, self.tails.z, self.aside, FEW)
        if self.by_quantiles:
            self._near = NearUnits(self.units, self.tails.z, found)
        return found

    # Used ways.

    def look(self, x: np.ndarray, *, sloped: bool = True, every: bool = False) -> Look:
        """Cost and used ways at a vector, with derivatives of limits that may decide.

        Args:
            x: the vector.
            sloped: False: without derivatives of the units.
            every: True: with derivatives of all limits.
        """
        decisions, n = self.decisions, self.decisions.size
        used, jacobian, errors = np.zeros(len(self.rows)), *np.zeros((2, len(self.rows), n))
        values = self.values(x)
        nominal, rates, priced, towards = self.nominal(x)
        pulls: list[tuple[int, Quantile, Values]] = []
        for k, row in enumerate(self.rows):
            if row.nominal:
                used[k], jacobian[k] = nominal[k], rates[k]
            elif row.share:
                margins, outward = self.margins(k, values)
                seen = self.quantile(k, margins)
                used[k] = 1 + seen.level / self.ways[k]
                wanted = sloped and (every or used[k] > DECIDES or row.name not in self.aside)
                if wanted and len(seen.units) and math.isfinite(seen.level):
                    pulls.append((k, seen, {name: pull[seen.units] * seen.weights for name, pull in outward.items()}))
            elif row.exact:
                used[k], jacobian[k] = self.worst_case(k, x)
            else:
                used[k], jacobian[k] = self.statistic(k, x, sloped=sloped)
            used[k] += 0.0 if row.nominal else self.moved[k]
        for (k, seen, _), each in zip(pulls, self._slopes(x, pulls)):
            jacobian[k] = each.sum(axis=1)
            errors[k] = np.sqrt(((each - np.outer(jacobian[k], seen.weights)) ** 2).sum(axis=1))
        cost, slopes, _ = decisions.cost(x)
        loss, pull = self.mean_loss(x, sloped=sloped)
        powers = np.array([row.power for row in self.rows])
        return Look(x, cost, slopes, priced, towards, loss, pull, used, jacobian, errors, powers)

    def _slopes(self, x: np.ndarray, pulls: list[tuple[int, Quantile, Values]]) -> Iterator[np.ndarray]:
        """Derivatives (n, m) of the used way of each of these rows by its units; one call solves those of all rows."""
        if not pulls:
            return
        ends = np.cumsum([0, *(len(seen.units) for _, seen, _ in pulls)])
        weights = {name: np.zeros(ends[-1]) for _, _, own in pulls for name in own}
        for (_, _, own), first, last in zip(pulls, ends[:-1], ends[1:]):
            for name, row in own.items():
                weights[name][first:last] = row
        units = np.concatenate([seen.units for _, seen, _ in pulls])
        found = self.units.slopes(x, self.tails.z[:, units], weights)
        for (k, _, _), first, last in zip(pulls, ends[:-1], ends[1:]):
            yield found[:, first:last] / self.ways[k]

    def missed(self, look: Look) -> float:
        """Largest excess over a limit without sampling error."""
        over = [look.used[k] - self.moved[k] - 1 for k, row in enumerate(self.rows) if row.exact]
        return float(max(over, default=-math.inf))

    def quantiles(self, x: np.ndarray, rejects: np.ndarray) -> np.ndarray:
        """Used ways (c,) of shares at a vector, if so many units (c,) may lie beyond; 0 elsewhere."""
        values, found = self.values(x), np.zeros(len(self.rows))
        for k, row in enumerate(self.rows):
            if row.share:
                level = self.quantile(k, self.margins(k, values)[0], rejects[k]).level
                found[k] = 1 + level / self.ways[k]
        return found

    def sizes(self) -> np.ndarray:
        """Sizes (c,) of the limits, unit of each response; the way of a limit that is 0."""
        found = [(row.item and _size(row.item)) or float(way) for row, way in zip(self.rows, self.ways)]
        return np.array(found)

    def quantile(
        self, k: int, margins: np.ndarray, rejects: float | None = None, weights: np.ndarray | None = None
    ) -> Quantile:
        """Quantile of the margins (n,) of a row, at its wanted rejects or at others.

        Args:
            k: number of the row.
            margins: of the units.
            rejects: share of the units; None: the wanted one.
            weights: (n,) of the units; None: those of the sample.
        """
        rejects = float(self.rejects[k]) if rejects is None else float(rejects)
        weights = self.tails.weights[: len(margins)] if weights is None else weights
        return quantile(margins, weights, rejects, float(self.ways[k]), self.behind(len(margins)))

    def behind(self, count: int) -> int:
        """Units behind a slope, at least.

        Args:
            count: units of the sample.
        """
        return PULLED

    def margins(self, k: int, values: Values) -> tuple[np.ndarray, Values]:
        """Margins (n,) of the units of a row on a share, and their derivatives (n,) to each response.

        Args:
            k: number of the row.
            values: of the units by name.
        """
        row = self.rows[k]
        if row.item is not None:
            own = values[row.name]
            pull = np.where(np.isnan(own), 0.0, row.item.outward(own))
            return row.item.margins(own), {row.name: pull}
        items = {n: i for n, i in self.problem.requirements.items() if i.of_units}
        ways = {r.name: float(way) for r, way in zip(self.rows, self.ways) if r.item is not None}
        failed = np.any([np.isnan(values[n]) for n in items], axis=0)
        scaled = np.stack([item.margin(values[n]) / ways[n] for n, item in items.items()])
        leading = np.where(failed, -1, np.where(np.isnan(scaled), -np.inf, scaled).argmax(axis=0))
        pulls = {
            n: np.where(leading == i, item.outward(values[n]) / ways[n], 0.0)
            for i, (n, item) in enumerate(items.items())
        }
        return np.where(failed, np.inf, scaled.max(axis=0)), pulls


class TailConstraints(Constraints):
    """Constraints on one sample of many units, most of them in the tails that decide; all are solved at each vector."""

    def counts(self, look: Look) -> list[int]:
        """The same number twice: the units are placed twice."""
        return [self.first] * 2

    def place(self, x: np.ndarray) -> None:
        """The same, of this sample: by the units behind each quantile and their derivatives."""
        if not self.units.parts:
            return
        values, found = self.values(x), list[Centres]()
        for k, row in enumerate(self.rows):
            if not row.share:
                continue
            margins, outward = self.margins(k, values)
            seen = self.quantile(k, margins)
            units = seen.units[np.argsort(-seen.weights, kind="stable")][:PULLED]
            if not len(units) or not math.isfinite(seen.level):
                continue
            pulled = {name: pull[units] for name, pull in outward.items()}
            z = self.tails.z[:, units]
            slopes = self.units.slopes_to_z(self.decisions.population(x), z, pulled)
            near = np.abs(margins[units] - seen.level)
            weights = self.tails.weights[units] / (near + np.median(near) + 1e-300)
            least = -float(special.ndtri(max(self.rejects[k], 1e-12)))
            placed = centres_of(z, slopes, weights, max(least, 0.25))
            found += [placed] if len(placed.places) else []
        if found:
            self.tails = TailSample(self.plain, self.problem.seed, Centres.joined(found))

    def far(self, look: Look) -> frozenset[str]:
        """None: few units would be another sample, with other weights."""
        return frozenset()

    @property
    def by_quantiles(self) -> bool:
        """False: all units are solved."""
        return False

    def behind(self, count: int) -> int:
        """A part of the units."""
        return count // _PART


def constraints_of(problem: Problem) -> Constraints:
    """Constraints of a problem, on the sample for the time of its units."""
    if not problem.effort.tails:
        return Constraints(problem, FEW)
    return TailConstraints(problem, QUICK * 2 ** math.ceil(math.log2(max(problem.decisions.size / _FIELDS, 1))))


def _size(item: Limits) -> float:
    """Size of a limit."""
    return abs(item.lower if math.isinf(item.upper) else item.upper)
