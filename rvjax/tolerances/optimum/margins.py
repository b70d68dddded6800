"""Margins of all requirements, and their derivatives, at one vector of decisions.

Shares of units come from a sample of the tails, other statistics (mean, spread, capability, worst case) on a plain
one, nominal outputs without units. A limit on both sides is two constraints where its margin has a corner between
them. Every margin is a part of its way: of the distance of the central response from the limit at the start.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping

import numpy as np
from scipy import special

from rvjax._jax.blocks import PULLED
from rvjax.population import Population, first_points
from rvjax.response import Response, response_names
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.loss import QuadraticLoss
from rvjax.tolerances.optimum.anchor import Anchor, AnchoredUnits
from rvjax.tolerances.optimum.decisions import Decisions
from rvjax.tolerances.optimum.limit_lines import LimitLines
from rvjax.tolerances.optimum.local import Local
from rvjax.tolerances.optimum.mean_loss import MeanLoss
from rvjax.tolerances.optimum.nominal import NominalOutputs
from rvjax.tolerances.optimum.share import Share, joint_share, share_of
from rvjax.tolerances.optimum.sides import sides, size
from rvjax.tolerances.optimum.tail_sample import Centres, TailSample, centres_of, kernel, smooth_quantile
from rvjax.tolerances.optimum.units import Weights
from rvjax.tolerances.optimum.worst_case_margin import worst_case
from rvjax.tolerances.requirements.limits import Limits
from rvjax.tolerances.worst_case import extremes

WIDTH = 0.06  # of the smoothing of quantiles, standard deviations of the response along its gradient
_MOST_LANES = 2 * PULLED  # units behind the slope of a quantile
_AGREE = 0.02  # of the way to a limit, by which lines may differ from a sample
_INSET = 2e-5  # of the way of a limit without sampling error: a programme ends within 1e-4 of it, on either side
JOINT = "joint"
"""Name of the constraint on units that meet all limits."""

FAILED = "failed"
"""Name of the constraint on the share of failed units, which statistics of the valid ones need."""


@dataclasses.dataclass(frozen=True)
class Constraint:
    """One row of the margins: a requirement, or one side of it."""

    name: str
    item: Limits


class Margins:
    """Constraints of an allocation as functions of its vector of decisions."""

    def __init__(
        self,
        response: Response,
        decisions: Decisions,
        requirements: dict[str, Limits],
        objective: dict[str, float],
        joint_target: float | None,
        samples: int,
        seed: int,
        memo: Memo | None = None,
        losses: Mapping[str, QuadraticLoss] | None = None,
        lossy: int = 0,
        sloped: int = PULLED,
    ) -> None:
        """Constraints on `samples` units, and `losses` of `lossy` others.

        The mean of `losses` is part of the objective. Costly units behind it are few, and followed as those in the
        tails are, `sloped` of each response with gradients.
        """
        self.decisions, self.requirements, self.objective = decisions, requirements, objective
        self.joint_target, self.samples, self.seed = joint_target, samples, seed
        self.response = response
        wanted = {name for name, item in requirements.items() if item.of_sample}
        self._units = AnchoredUnits(response, decisions, wanted, memo)
        self._units.sloped = sloped
        self._outputs = response_names(response, decisions.base)
        self.rows = [Constraint(n, i) for n, i in requirements.items() if i.of_shares]
        self._shares = len(self.rows)
        for name, item in requirements.items():
            if not item.of_shares:
                self.rows += [Constraint(name, side) for side in sides(item)]
        outputs = {n for n, item in requirements.items() if not item.of_sample} | set(objective)
        self._nominal = NominalOutputs(response, tuple(sorted(outputs)))
        self._plain = any(i.of_sample and not i.of_shares for i in requirements.values())
        self.most_failed = min((i.most_failed for i in requirements.values() if i.most_failed < 1), default=None)
        self.names = [row.name for row in self.rows] + ([FAILED] if self.most_failed is not None else [])
        self.names += [JOINT] if joint_target is not None else []
        self.exact = [k for k, row in enumerate(self.rows) if row.item.exact]
        self.offsets = np.zeros(len(self.names))
        self.ways = np.ones(len(self.names))
        self.widths = np.ones(len(self.names))
        numbers = decisions.base.numbers
        self.tails = TailSample(numbers, samples, seed)
        self._centres: dict[int, Centres] = {}
        self.mirrored = False
        """True: both limits of a response have units, though one decides, because numbers may move the response."""
        self.lines: dict[int, LimitLines] = {}
        self.losses = MeanLoss(response, decisions, losses or {}, lossy, seed, memo)
        self.plain = first_points(numbers, seed, samples) if self._plain else np.zeros((numbers, 0))

    @property
    def evaluated(self) -> int:
        """Units that the search has solved."""
        return self._units.evaluated + self.losses.evaluated

    # The sample.

    def begin(self, x: np.ndarray) -> None:
        """Measure the way of each margin, and place units in the tails."""
        outputs, _ = self._nominal.at(self.decisions.population(x))
        centre = self._central(x) if self._units.parts else {}
        values = self._units.values(x, self.tails.z, "tails") if self._units.parts else {}
        for k, row in enumerate(self.rows):
            if not row.item.of_sample:
                self.ways[k] = size(row.item) or abs(outputs[row.name]) or 1.0
            else:
                finite = values[row.name][np.isfinite(values[row.name])]
                spread = float(finite.std()) if len(finite) else 0.0
                way = abs(float(row.item.margin(centre[row.name])))
                self.ways[k] = max(w for w in (way, spread, 1e-300) if math.isfinite(w))
                if not row.item.limits_values:
                    self.ways[k] = row.item.upper
        self.offsets[self.exact] = _INSET * self.ways[self.exact]
        self.replace_sample(x)

    def begin_like(self, other: "Margins") -> None:
        """Take the ways of the margins and the places in the tails of another sample."""
        self.ways, self.widths, self._centres = other.ways.copy(), other.widths.copy(), other._centres
        self.offsets[self.exact] = _INSET * self.ways[self.exact]
        self.tails = TailSample(self.decisions.base.numbers, self.samples, self.seed, other.tails.centres)

    def replace_sample(self, x: np.ndarray) -> None:
        """Units in the tails as they lie at x."""
        if not self._shares:
            return
        population = self.decisions.population(x)
        values = self._units.values(x, self.tails.z, "tails")
        found: list[Centres] = []
        self.lines, self._centres = {}, {}
        for k, shared in enumerate(self._shared(values)):
            margins, target = shared.margins, shared.target
            order = np.argsort(margins)
            order = order[np.isfinite(margins[order])]
            beyond = np.cumsum(self.tails.weights[order[::-1]])[::-1] / self.samples
            at = min(int(np.searchsorted(-beyond, -(1 - target))), max(len(order) - PULLED // 2, 0))
            first = max(0, at - self._units.sloped // 2)
            units = order[first : first + self._units.sloped]
            if not len(units):
                continue
            cotangents = {name: pull[units] for name, pull in shared.outward.items()}
            slopes = self._units.slopes_to_z(population, self.tails.z[:, units], cotangents)
            middle = margins[order[min(at, len(order) - 1)]]
            near = np.abs(margins[units] - middle)
            weights = self.tails.weights[units] / (near + np.median(near) + 1e-300)
            sizes = np.linalg.norm(slopes, axis=0)
            self.widths[self._row(k)] = WIDTH * float(np.median(sizes)) or WIDTH * self.ways[self._row(k)]
            placed = centres_of(self.tails.z[:, units], slopes, weights, float(special.ndtri(max(target, 0.6))))
            if len(placed.places) and self.mirrored and k < self._shares:
                row, z = self.rows[k], self.tails.z[:, units]
                outward = cotangents[row.name]
                centre = float(np.median(values[row.name][units] - outward * (slopes * z).sum(axis=0)))
                ways = row.item.upper - centre, centre - row.item.lower
                this, other = ways if weights @ outward > 0 else ways[::-1]
                placed = placed.mirrored(other / this if this > 0 else 0.0)
            if len(placed.places):
                self._centres[self._row(k)] = placed
                found.append(placed)
        if found:
            self.anchor = None
            self.tails = TailSample(self.decisions.base.numbers, self.samples, self.seed, Centres.joined(found))

    def draw_lines(self, x: np.ndarray, due: dict[int, float]) -> None:
        """Take quantiles and their derivatives from lines where these agree with what a large sample saw at x.

        Args:
            x: the vector.
            due: {row: margin in parts of its way, without correction}.
        """
        values = self._units.values(x, self.tails.z, "tails")
        for k, centres in self._centres.items():
            if k in due and np.isfinite(self._share(k, values).margins).all():
                lines = LimitLines(self._units, functools.partial(self._share, k), self._reads(k), centres, self.seed)
                found = lines.look(x)
                if found is not None and abs(found[0] / self.ways[k] - due[k]) < _AGREE:
                    self.lines[k] = lines

    def follow(self, x: np.ndarray) -> None:
        """Solve the units that decide at x; values elsewhere follow their gradients from there."""
        values = self._units.values(x, self.tails.z, "tails")
        away: dict[str, np.ndarray] = {}
        for number, shared in enumerate(self._shared(values)):
            width = self.widths[self._row(number)]
            level = smooth_quantile(shared.margins, self.tails.weights, 1 - shared.target, width)
            distance = np.abs(shared.margins - (level if math.isfinite(level) else 0.0)) / width
            distance = np.where(np.isnan(distance), np.inf, distance)
            away |= {name: np.minimum(away.get(name, np.inf), distance) for name in shared.outward}
        self._units.drop(x, self.tails.z, away)
        self.losses.follow(x)

    @property
    def anchor(self) -> Anchor | None:
        """Vector at which units in the tails were solved, which all follow; None if all are solved."""
        return self._units.anchor

    @anchor.setter
    def anchor(self, anchor: Anchor | None) -> None:
        self._units.anchor = anchor
        self.losses.follow_from(None if anchor is None else anchor.x)

    def _row(self, k: int) -> int:
        return k if k < self._shares else len(self.names) - 1

    # Margins.

    def look(self, x: np.ndarray, *, sloped: bool = True) -> Local:
        """Cost, margins and derivatives at a vector of decisions; `sloped` False: units without derivatives."""
        decisions, n = self.decisions, self.decisions.size
        population = decisions.population(x)
        margins, jacobian = np.zeros(len(self.names)), np.zeros((len(self.names), n))
        if self._shares:
            self._look_at_shares(x, population, margins, jacobian, sloped)
        if self._plain:
            self._look_at_statistics(x, population, margins, jacobian, sloped)
        outputs, rates = self._nominal.at(population)
        for k, row in enumerate(self.rows):
            if not row.item.of_sample:
                value = outputs[row.name]
                margins[k] = row.item.margin(value) if math.isfinite(value) else math.inf
                jacobian[k] = float(row.item.outward(np.array(value))) * decisions.by_number(rates[row.name])
        slopes, bends = decisions.cost_slopes(x)
        priced = sum(price * outputs[name] for name, price in self.objective.items())
        towards = sum((p * decisions.by_number(rates[name]) for name, p in self.objective.items()), np.zeros(n))
        loss, pulled = self.losses.look(x, sloped=sloped)
        margins = (margins + self.offsets) / self.ways
        return Local(
            x, decisions.cost(x), slopes, bends, float(priced) + loss, towards + pulled, margins,
            jacobian / self.ways[:, None], self.offsets / self.ways,
        )  # fmt: skip

    def of_tails(self, tails: TailSample, x: np.ndarray) -> Local:
        """The same with the units in the tails of another sample, or with other weights of these."""
        kept, self.tails = self.tails, tails
        found = self.look(x)
        self.tails = kept
        return found

    def missed(self, point: Local) -> np.ndarray:
        """Excess (e,) of the limits without sampling error, in parts of their ways."""
        return (point.margins - point.moved)[self.exact]

    def of_others(self, x: np.ndarray, times: int) -> dict[int, float]:
        """{row: margin in parts of its way, without correction} on shares, of so many times as many other units."""
        population, found = self.decisions.population(x), dict[int, float]()
        tails = TailSample(population.numbers, times * self.samples, self.seed + 1, self.tails.centres)
        for number, shared in enumerate(self._shared(self._units.values(x, tails.z, "others"))):
            k = self._row(number)
            level = smooth_quantile(shared.margins, tails.weights, 1 - shared.target, self.widths[k])
            found[k] = (level - self._widened(k, shared.target)) / self.ways[k]
        return found

    def spared(self, x: np.ndarray, requirements: dict[str, Limits]) -> np.ndarray:
        """Distance (c,) by which the quantiles at the targets of other requirements lie further within, in parts."""
        found = np.zeros(len(self.names))
        values = self._units.values(x, self.tails.z, "tails") if self._shares else {}
        for k, row in enumerate(self.rows[: self._shares]):
            own = share_of(row.name, row.item, values[row.name])
            level, there = (
                smooth_quantile(own.margins, self.tails.weights, 1 - target, self.widths[k])
                for target in (own.target, share_of(row.name, requirements[row.name], values[row.name]).target)
            )
            found[k] = max(level - there, 0.0) / self.ways[k] if math.isfinite(level - there) else 0.0
        return found

    def _widened(self, k: int, target: float) -> float:
        """Error of a smooth quantile: a normal tail at distance z, widened by h, is too wide by z h^2/2 (in sd)."""
        return self.widths[k] * WIDTH * max(float(special.ndtri(target)), 0.0) / 2

    def total(self, x: np.ndarray) -> float:
        """Cost at a vector of decisions, with the objective."""
        outputs, _ = self._nominal.at(self.decisions.population(x))
        return self.decisions.cost(x) + sum(price * outputs[name] for name, price in self.objective.items())

    def central_ways(self, x: np.ndarray) -> np.ndarray:
        """Distance (c,) of the central response from each limit, in parts of the way of each margin."""
        found = np.ones(len(self.names))
        if self._units.parts:
            centre = self._central(x)
            for k, row in enumerate(self.rows):
                if row.item.of_sample and row.item.limits_values:
                    way = abs(float(row.item.margin(centre[row.name]))) / self.ways[k]
                    found[k] = max(way, 1e-3) if math.isfinite(way) else 1.0
        return found

    def limits(self) -> np.ndarray:
        """Sizes (c,) of the limits, unit of each response; the way of a margin where the limit is 0."""
        found = [size(row.item) or float(way) for row, way in zip(self.rows, self.ways)]
        return np.array(found + [1.0] * (len(self.names) - len(self.rows)))

    def leading(self, x: np.ndarray) -> dict[str, float]:
        """{requirement: derivative of the joint margin to its margin}."""
        values = self._units.values(x, self.tails.z, "tails")
        shared = self._shared(values)[-1]
        level = smooth_quantile(shared.margins, self.tails.weights, 1 - shared.target, self.widths[-1])
        weights = kernel(shared.margins, self.tails.weights, level, self.widths[-1])
        return {name: float(np.abs(pull) @ weights) for name, pull in shared.outward.items()}

    def _central(self, x: np.ndarray) -> dict[str, float]:
        """Responses of the unit whose standard normal numbers are 0."""
        values = self._units.values(x, np.zeros((self.decisions.base.numbers, 1)), "centre")
        return {name: float(row[0]) for name, row in values.items()}

    def _shared(self, values: dict[str, np.ndarray]) -> list[Share]:
        """Units of each constraint on a share."""
        joint = [len(self.names) - 1] if self.joint_target is not None else []
        return [self._share(k, values) for k in [*range(self._shares), *joint]]

    def _reads(self, k: int) -> tuple[str, ...]:
        """Responses of a row on a share."""
        every = (n for n, i in self.requirements.items() if i.of_units)
        return (self.rows[k].name,) if k < len(self.rows) else tuple(every)

    def _share(self, k: int, values: dict[str, np.ndarray]) -> Share:
        """Units of a row on a share."""
        if k < len(self.rows):
            row = self.rows[k]
            return share_of(row.name, row.item, values[row.name])
        assert self.joint_target is not None
        items = {n: i for n, i in self.requirements.items() if i.of_units}
        ways = {n: float(self.ways[self.names.index(n)]) for n in items}
        return joint_share(items, ways, values, self.joint_target)

    def _look_at_shares(
        self, x: np.ndarray, population: Population, margins: np.ndarray, jacobian: np.ndarray, sloped: bool
    ) -> None:
        several = dict[int, tuple[np.ndarray, Weights]]()
        for k, lines in list(self.lines.items()):
            found = lines.look(x)
            if found is None:  # as before, from units in the tails
                del self.lines[k]
            else:
                margins[k], jacobian[k] = found
        if len(self.lines) == self._shares + (self.joint_target is not None):
            return
        values = self._units.values(x, self.tails.z, "tails")
        for number, shared in enumerate(self._shared(values)):
            own, target, k = shared.margins, shared.target, self._row(number)
            if k in self.lines:
                continue
            level = smooth_quantile(own, self.tails.weights, 1 - target, self.widths[k])
            margins[k] = level - self._widened(k, target)
            units, weights = self._deciding(k, own, level) if sloped else (np.zeros(0, int), np.zeros(0))
            if len(units):
                several[k] = units, {name: pull[units] * weights for name, pull in shared.outward.items()}
        if several:
            slopes = self._units.slopes(x, population, self.tails.z, list(several.values()))
            jacobian[list(several)] = np.stack(slopes)

    def _deciding(self, k: int, margins: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
        """Units (m,) that decide a quantile, and their weights (m,) in its derivative; empty where there are none."""
        if not math.isfinite(level):
            return np.zeros(0, int), np.zeros(0)
        weights = kernel(margins, self.tails.weights, level, self.widths[k])
        units = np.argsort(-weights, kind="stable")[: min(_MOST_LANES, int((weights > 0).sum()))]
        weights = weights[units] / weights[units].sum()
        return (units, weights) if np.isfinite(weights).all() else (units[:0], weights[:0])

    def _look_at_statistics(
        self, x: np.ndarray, population: Population, margins: np.ndarray, jacobian: np.ndarray, sloped: bool
    ) -> None:
        values = self._units.values(x, self.plain, "plain")
        for k, row in enumerate(self.rows):
            item = row.item
            if item.of_shares or not item.of_sample:
                continue
            if item.of_extremes:
                both = functools.partial(extremes, self.response, names=self._outputs, name=row.name)
                margins[k], jacobian[k] = worst_case(both, self.decisions, x, item, self.ways[k])
                continue
            own = values[row.name]
            valid = own if item.most_failed >= 1 else own[~np.isnan(own)]
            margins[k] = item.learned(valid, self.ways[k])
            pull = item.pull(own, margins[k], self.ways[k], len(own))
            if sloped and len(pull.units) and math.isfinite(margins[k]):
                weighted = {row.name: pull.cotangents / pull.norms.sum()}
                jacobian[k] = self._units.slope(x, population, self.plain[:, pull.units], weighted)
        if self.most_failed is not None:  # units that fail have no slope
            failed = np.any([np.isnan(row) for row in values.values()], axis=0)
            margins[len(self.rows)] = float(failed.mean()) / self.most_failed - 1
