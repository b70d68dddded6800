"""Fixed learning sample of an allocation: margins at the required yield, and their slopes.

All tolerances see the same random numbers, so margins are smooth. It certifies nothing: the optimum is fitted to it.
"""

import copy
import dataclasses
import hashlib
import math
from collections.abc import Iterator
from typing import Any, Self

import jax
import numpy as np
from scipy import special

from rvjax._jax.blocks import PULLED, padded
from rvjax.population import Population, Tolerance, drawn, root_key
from rvjax.response import BLOCK, Response, elements_and_rates, gradients, respond, response_names
from rvjax.status import succeeded
from rvjax.tolerances.batch.checkpoint import describe
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.optimum.followed import REACHED, WRONG, Followed, followable
from rvjax.tolerances.optimum.jackknife import GROUPS, groups
from rvjax.tolerances.optimum.shrinkage import MANY, total_of_many
from rvjax.tolerances.requirements.limits import Limits, Pull, along_reach, nearest, tail_quantile
from rvjax.tolerances.worst_case import Extremes, extremes

# Slopes come from the units nearest the quantile: few enough to lie near it, where the response bends.
# Each of many fields contributes little to the spread, and a slope errs by about sqrt(fields/units)/3.
_FEWEST_LANES, _LANES_PART, _LANES_OF_A_FIELD = 256, 32, 16
_MEASURED = 256  # costly units behind the way of a nominal unit to its limit
_NEARBY = 0.1  # logarithm of a half-width, within which costly units keep their slopes
IDLE = 0.25  # part of the way to a limit, beyond which costly units need no slopes
_FARTHER = 2.0  # times as far inside its limit as the nominal response: the median of units whose errors take play off
_SEEN = 6  # units beyond a limit at the target, among the first few that are solved; their number doubles
_MET, _MISSED = 0.02, 2.5e-3  # probability of what few units show at the target, above which they decide nothing
_REMEMBERED = 8  # sets of half-widths whose values are kept, because they are often evaluated again


@dataclasses.dataclass(frozen=True)
class Point:
    """Margins and slopes of the sample at one set of half-widths.

    Constraints are the requirements, the share of failed units where one is a statistic of valid units, the joint one.

    Attributes:
        half_widths: (j,) of the fields that have a cost.
        margins: (c,) margin of each constraint at its target yield: <= 0 is met, inf if too many units fail.
        slopes: (c, j) their derivatives to the logarithms of the half-widths.
        weights: (c, k) derivative of each constraint to the margin of each requirement.
    """

    half_widths: np.ndarray
    margins: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray


class Training:
    """Margins of one sample of units as functions of the half-widths of the fields that have a cost."""

    def __init__(
        self,
        response: Response,
        population: Population,
        fields: tuple[str, ...],
        requirements: dict[str, Limits],
        joint_target: float | None,
        samples: int,
        seed: int,
        memo: Memo | None = None,
    ) -> None:
        self.response, self.population, self.fields, self.requirements = response, population, fields, requirements
        self.names = response_names(response, population)
        self._priced = [list(population.active).index(name) for name in fields]
        self.samples, self.joint_target = samples, joint_target
        self._memo, self._drawn = memo, {"seed": str(seed), "method": "random"}
        self._seen: dict[bytes, np.ndarray] = {}
        self.evaluated = [0]  # units, with or without a gradient, by this sample and its copies
        self._made: dict[str, tuple[float, Tolerance]] = {}  # the latest tolerance of each field, by its half-width
        self.lanes = min(samples, max(_FEWEST_LANES, samples // _LANES_PART, _LANES_OF_A_FIELD * len(fields)))
        self._slopes: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # where they were computed, and of s^power
        self._pulls: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}  # units, parts and norms of each slope
        self.wrong = WRONG  # costly units expected on the wrong side of a limit, at most
        self.followed: Followed | None = None
        """Its units where they are costly; the others are all solved at every set of half-widths."""
        if followable(response, requirements):
            self.followed = Followed(response, population, samples, seed, memo)
            self.lanes = min(samples, max(_FEWEST_LANES, _LANES_OF_A_FIELD * len(fields)))
        else:
            key, block = root_key(seed), min(samples, BLOCK)
            self.blocks = [drawn(population, key, np.uint32(start), count=block) for start in range(0, samples, block)]
            self.z = np.concatenate([np.asarray(z) for z in self.blocks], axis=1)
        self._measure()

    def _measure(self) -> None:
        """Measure the distance of the nominal response from each limit, the scale of the margins."""
        requirements, joint_target = self.requirements, self.joint_target
        values = self._nominal()
        own = self._unit_margins(values)
        nominal = np.array([item.distance(row) for row, item in zip(values, requirements.values())])
        finite = np.where(np.isfinite(own), np.abs(own), 0.0).max(axis=1)
        spread = np.where(finite > 0, finite, 1.0)  # a positive size where the nominal value touches the limit
        self.scales = np.where(np.isfinite(nominal) & (nominal > 0), nominal, spread)
        # With statistics of the valid units failures are a constraint too.
        self.most_failed = min((i.most_failed for i in requirements.values() if i.most_failed < 1), default=None)
        self.distance = np.append(self.scales, np.ones((self.most_failed is not None) + (joint_target is not None)))
        self.correction, self.powers = np.ones(len(self.distance)), np.full(len(self.distance), 2.0)
        self.powers[: len(requirements)] = [item.power for item in requirements.values()]  # by which half-widths add up

    def recentred(self, half_widths: np.ndarray) -> bool:
        """Measure the way to a limit from the median of the units where errors take it far inside; True if any did.

        Position errors of many pins take up most of a backlash. Seen from a nominal response next to the limit, units
        beyond it would count by how far they are beyond, and slopes come out at a third of their size.
        """
        if self.followed is None:
            return False
        inside = -np.median(self._unit_margins(self.values(half_widths)), axis=1)
        farther = np.isfinite(inside) & (inside > _FARTHER * self.scales)
        self.scales = np.where(farther, inside, self.scales)
        self.distance[: len(inside)] = self.scales
        if farther.any():
            self._slopes = {}
        return bool(farther.any())

    def _nominal(self) -> np.ndarray:
        """Required responses (k, n) of units whose only errors are those without a cost: all, or enough of them."""
        nothing = np.zeros(len(self.fields))
        if self.followed is None:
            return self.values(nothing)
        self.evaluated[0] += _MEASURED
        few = np.arange(min(_MEASURED, self.samples))
        return self._rows(self.followed.some_at(self.with_half_widths(nothing), few))

    def aimed(self, requirements: dict[str, Limits], half_widths: np.ndarray, wrong: float) -> Self:
        """The same costly units for other targets of the same limits.

        A slope counts on: it has changed as the way to the limit has.

        Args:
            requirements: with the other targets.
            half_widths: (j,) from which a search goes on.
            wrong: units expected on the wrong side of a limit, at most.
        """
        other, values = copy.copy(self), self.values(half_widths)
        other.requirements, other.wrong, other._seen, other._slopes, other._pulls = requirements, wrong, {}, {}, {}
        before, now = (of._margins(values, {}) + self.distance for of in (self, other))
        for k, (place, known) in self._slopes.items():
            if before[k] > 0 and now[k] > 0:
                other._slopes[k] = place, known * (now[k] / before[k]) ** self.powers[k]
        return other

    def with_half_widths(self, half_widths: np.ndarray) -> Population:
        """The population with these half-widths in the fields that have a cost."""
        for name, t in zip(self.fields, map(float, half_widths)):
            if name not in self._made or self._made[name][0] != t:  # of hundreds of fields often one alone has moved
                self._made[name] = t, self.population.active[name].with_half_width(t)
        return self.population.with_tolerances({name: made for name, (_, made) in self._made.items()})

    def renew(self, half_widths: np.ndarray) -> None:
        """Solve all costly units at some half-widths; predicted values and slopes are forgotten."""
        assert self.followed is not None
        before = self.followed.solved
        self.followed.all_at(self.with_half_widths(half_widths))
        self.evaluated[0] += self.followed.solved - before
        self._seen, self._slopes = {}, {}

    def margins(self, half_widths: np.ndarray) -> np.ndarray:
        """Margins of the constraints (c,)."""
        return self._corrected(self.uncorrected(half_widths))

    def uncorrected(self, half_widths: np.ndarray) -> np.ndarray:
        """Margins (c,) of this sample, without the corrections from a larger sample."""
        return self._margins(self.values(half_widths), self._ranges(half_widths))

    def margins_of_few(self, half_widths: np.ndarray) -> np.ndarray | None:
        """Margins (c,) of the first of the costly units, where these show which requirements are met; else None."""
        allowed = np.array([1 - getattr(r, "target", 1.0) for r in self.requirements.values()])
        if self.followed is None or self.joint_target is not None or not allowed.all():
            return None

        def decided(values: dict[str, np.ndarray]) -> bool:
            margins = self._unit_margins(self._rows(values))
            beyond, count = (margins > 0).sum(axis=1), margins.shape[1]
            met, missed = special.bdtr(beyond, count, allowed), special.bdtrc(beyond - 1, count, allowed)
            return bool((met <= _MET).all() or (missed <= _MISSED).any())

        before, population = self.followed.solved, self.with_half_widths(half_widths)
        found = self.followed.of_few(population, math.ceil(_SEEN / allowed.min()), decided)
        self.evaluated[0] += self.followed.solved - before
        return None if found is None else self._corrected(self._margins(self._rows(found), {}))

    def _rows(self, values: dict[str, np.ndarray]) -> np.ndarray:
        return np.stack([values[name] for name in self.requirements])

    def point(self, half_widths: np.ndarray) -> Point:
        """Margins and slopes."""
        values, ranges = self.values(half_widths), self._ranges(half_widths)
        margins = self._margins(values, ranges)
        weights = np.eye(len(margins), len(values))
        slopes = []
        for k, ((name, item), row) in enumerate(zip(self.requirements.items(), values)):
            if item.of_extremes:
                pull = item.pull(ranges[name].values, margins[k], self.distance[k], self.lanes)
                slopes.append(pull.cotangents @ ranges[name].slopes[pull.units][:, self._priced])
            elif self.followed is not None:
                slopes.append(self._slope_near(half_widths, k, row, float(margins[k])))
            else:
                pull = item.pull(row, margins[k], self.distance[k], self.lanes)
                slopes.append(self._slope(half_widths, pull, np.full(self.samples, k)))
        if self.most_failed is not None:
            slopes.append(np.zeros(len(self.fields)))
        if self.joint_target is not None:
            joint, leading = self._joint(values)
            units = nearest(joint, self.joint_target, self.lanes)
            outward = np.stack([item.outward(row) for row, item in zip(values, self.requirements.values())])
            signs = (outward / self.scales[:, None])[leading[units], units]
            pull = along_reach(units, joint[units] + 1, signs, margins[-1] + 1)
            slopes.append(self._slope(half_widths, pull, leading, len(margins) - 1))
            weights[-1] = (np.eye(len(values))[leading[units]] / self.scales).mean(axis=0)
        return Point(half_widths, self._corrected(margins), self.correction[:, None] * np.stack(slopes), weights)

    def parts(self, point: Point) -> Iterator[Point]:
        """A point of followed units without one group of these, for each group."""
        values, group = self.values(point.half_widths), groups(self.samples)
        for k in range(GROUPS):
            slopes = point.slopes.copy()
            for row, (units, of_units, norms) in self._pulls.items():
                used = group[units] != k
                whole, rest = (self._by_field(of_units @ own) / (norms @ own) for own in (np.ones(len(units)), used))
                slopes[row] *= np.divide(rest, whole, out=np.ones(len(whole)), where=whole != 0)
            margins = self._corrected(self._margins(values[:, group != k], {}))
            yield dataclasses.replace(point, margins=margins, slopes=slopes)

    def correct(self, point: Point, factors: np.ndarray) -> Point:
        """Learn from a larger sample that half-widths times `factors` would just meet each target.

        A few thousand units give a far quantile to a percent or two only. From now on the distance of each
        active constraint from the nominal response is scaled by the result of the larger sample at `point`.
        """
        reach = np.maximum((point.margins + self.distance) / self.distance, 1e-3)
        seen = 1 / (factors * reach)
        active = (reach > 0.9) & (np.abs(np.log(seen)) < 0.2)
        ratio = np.where(active, seen, 1.0)
        self.correction = self.correction * ratio
        margins = ratio * (point.margins + self.distance) - self.distance
        return dataclasses.replace(point, margins=margins, slopes=ratio[:, None] * point.slopes)

    def values(self, half_widths: np.ndarray) -> np.ndarray:
        """Required responses of every unit (k, n), nan where a unit failed; the latest ones are remembered."""
        asked = np.asarray(half_widths, float).tobytes()
        if asked in self._seen:
            return self._seen[asked]
        population, rows = self.with_half_widths(half_widths), []
        if self.followed is not None:
            before = self.followed.solved
            by_name, _ = self.followed.at(population, self._aims, self.wrong)
            self.evaluated[0] += self.followed.solved - before
            return self._remembered(asked, self._rows(by_name))
        self.evaluated[0] += self.samples
        for k, z in enumerate(self.blocks):
            values, status = self._block(population, k, z)
            rows.append(np.where(succeeded(np.asarray(status)), self._rows(values), np.nan))
        return self._remembered(asked, np.concatenate(rows, axis=1)[:, : self.samples])

    def _remembered(self, asked: bytes, values: np.ndarray) -> np.ndarray:
        if len(self._seen) >= _REMEMBERED:
            del self._seen[next(iter(self._seen))]
        return self._seen.setdefault(asked, values)

    def _aims(self, values: dict[str, np.ndarray], moved: float) -> dict[str, list[float]]:
        """Values at the required quantiles that may have reached a limit: the way there grows as half-widths do."""
        rows = self._rows(values)
        joint = None if self.joint_target is None else float(np.quantile(self._joint(rows)[0], self.joint_target))
        found = {}
        for (name, item), row, scale, distance in zip(self.requirements.items(), rows, self.scales, self.distance):
            levels = [item.learned(row, float(distance))]
            levels += [] if joint is None else [joint * scale]
            found[name] = [
                end + sign * level
                for level in levels
                if np.isfinite(level) and 1 + level / distance > REACHED * (1 - moved)
                for end, sign in ((item.upper, 1.0), (item.lower, -1.0))
                if np.isfinite(end)
            ]
        return found

    def _block(self, population: Population, k: int, z: jax.Array) -> tuple[Any, Any]:
        """Values and status of the units of a block."""
        if self._memo is None:
            return respond(self.response, population, z)
        count = z.shape[1]  # the units of a certificate's block
        asked = describe(population, {}) | self._drawn | {"first": str(k * count), "count": str(count)}
        return self._memo.units(self.names, asked, lambda: respond(self.response, population, z))

    def _ranges(self, half_widths: np.ndarray) -> dict[str, Extremes]:
        """Ranges of the responses with a requirement on the worst case."""
        limited = [name for name, item in self.requirements.items() if item.of_extremes]
        population = self.with_half_widths(half_widths) if limited else self.population
        return {name: extremes(self.response, population, self.names, name) for name in limited}

    def _unit_margins(self, values: np.ndarray) -> np.ndarray:
        """Margin of every unit to every limit (k, n), inf where it failed."""
        rows = [item.margin(row) for row, item in zip(values, self.requirements.values())]
        return np.where(np.isnan(values), np.inf, np.stack(rows))

    def _joint(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Margin of every unit to the limit it comes nearest to (n,), in parts of the way there; and which that is."""
        scaled = self._unit_margins(values) / self.scales[:, None]
        scaled[[not item.of_units for item in self.requirements.values()]] = -np.inf
        return scaled.max(axis=0), scaled.argmax(axis=0)

    def _margins(self, values: np.ndarray, ranges: dict[str, Extremes]) -> np.ndarray:
        rows = [ranges[name].values if name in ranges else row for name, row in zip(self.requirements, values)]
        triples = zip(self.requirements.values(), rows, map(float, self.distance))
        found = [
            item.learned(row if item.most_failed >= 1 else row[~np.isnan(row)], distance)
            for item, row, distance in triples
        ]
        if self.most_failed is not None:
            found.append(float(np.isnan(values).any(axis=0).mean()) / self.most_failed - 1)
        if self.joint_target is not None:
            found.append(tail_quantile(self._joint(values)[0], self.joint_target, 1.0))
        return np.array(found)

    def _corrected(self, margins: np.ndarray) -> np.ndarray:
        return (margins + self.distance) * self.correction - self.distance

    def _slope_near(self, half_widths: np.ndarray, k: int, row: np.ndarray, margin: float) -> np.ndarray:
        """The slope of a requirement, by the model of `conlin` where one is known nearby.

        0 far from its limit, and where so many units fail that no quantile is left.
        """
        if margin <= -IDLE * self.distance[k] or not np.isfinite(margin):
            return np.zeros(len(self.fields))
        reach = max(margin + self.distance[k], 1e-3 * self.distance[k])
        place, power = np.log(half_widths), self.powers[k]
        if k not in self._slopes or np.abs(self._slopes[k][0] - place).max() > _NEARBY:
            name = list(self.requirements)[k]
            pull = self.requirements[name].pull(row, margin, self.distance[k], self.lanes)
            slope = self._slope(half_widths, pull, np.full(self.samples, k), k)
            self._slopes[k] = place, slope * reach ** (power - 1)
        there, known = self._slopes[k]
        return known * np.exp(power * (place - there)) / reach ** (power - 1)

    def _slope(self, half_widths: np.ndarray, pull: Pull, of: np.ndarray, kept: int | None = None) -> np.ndarray:
        """Derivative of a margin to the logarithms of the half-widths (j,); `of`: each unit's requirement.

        The parts of its units are remembered for the constraint `kept`.
        """
        if not len(pull.units):
            return np.zeros(len(self.fields))
        if self.followed is not None:
            z, parts = self.followed.z, [part.names for part in self.followed.parts]
        else:
            z, parts = self.z, [self.names]
        given = dict(zip(self.fields, half_widths))
        errors, rates = elements_and_rates(self.population, given, z[:, pull.units])
        required = np.array(list(self.requirements))[of[pull.units]]
        self.evaluated[0] += len(pull.units)
        slopes = np.empty(errors.shape)
        for number, names in enumerate(parts):
            mine = np.isin(required, names)
            if not mine.any():
                continue
            rows = np.array([names.index(name) for name in required[mine]])
            cotangents = np.eye(len(names))[rows].T * pull.cotangents[mine]
            if self.followed is None:
                found = self._gradients(errors[:, mine], cotangents)
            else:
                there = self.with_half_widths(half_widths)
                found = self.followed.slopes(number, there, pull.units[mine], cotangents)
            slopes[:, mine] = found[: len(errors)]  # those to numbers of the design follow
        for name in np.unique(required):
            mine = (required == name) & (pull.cotangents != 0) & np.isfinite(slopes).all(axis=0)
            if self.followed is not None:
                self.followed.learn(name, pull.units[mine], slopes[:, mine] / pull.cotangents[mine])
        used = np.isfinite(slopes).all(axis=0)
        norm, of_units = pull.norms[used].sum(), (slopes * rates)[:, used]
        if kept is not None:
            self._pulls[kept] = pull.units[used], of_units, pull.norms[used]
        if len(self.fields) < MANY:
            total = self._by_field(of_units.sum(axis=1))
        else:
            widely = elements_and_rates(self.population, given, z[:, : padded(pull.units, PULLED).size])[1]
            model = half_widths * self._by_field((slopes[:, used] @ pull.cotangents[used]) ** 2 * widely.var(axis=1))
            total = total_of_many(np.stack([self._by_field(row) for row in of_units.T]), model)
        return total / norm * half_widths if norm > 0 else np.zeros(len(self.fields))

    def _by_field(self, elements: np.ndarray) -> np.ndarray:
        """Sums over the elements of each field that has a cost (j,)."""
        found = self.population.by_field(elements)
        return np.array([found[name].sum() for name in self.fields])

    def _gradients(self, errors: np.ndarray, cotangents: np.ndarray) -> np.ndarray:
        """Gradients (elements, n) of weighted responses."""

        def compute() -> Any:
            return gradients(self.response, self.population, errors, cotangents, self.names)[1]

        if self._memo is None:
            return compute()
        about = repr(sorted((self.population.values or {}).items())).encode() + errors.tobytes() + cotangents.tobytes()
        return self._memo.recall({"gradients of": hashlib.sha256(about).hexdigest()}, compute)
