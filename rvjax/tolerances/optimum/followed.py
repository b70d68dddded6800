"""One sample of units, followed from one set of tolerances to the next: only the units that may decide are solved.

A share of units within a limit, and the limit that a share keeps, depend on the units near that limit alone. From a set
of tolerances where all units are known, values at a neighbouring set are predicted by a line, v' = a + b v, fitted to
units that are solved there: those nearest the limit and some at random. What the line leaves over is the spread of the
prediction; every unit is solved that lies near the limit by that measure, until less than a tenth of a unit is expected
to be on the wrong side. The random units check it: they count by the largest deviation among them.

Units with a known gradient g to their errors e, those nearest the limits, have a separate line, through v + g (e' - e).
Where one half-width of rv-40e-whole grows by a tenth, it leaves 0.1 to 2 % of the spread of all units, the other line
5 to 9 %.
"""

import hashlib
from collections.abc import Callable

import numpy as np

from rvjax._jax.blocks import PULLED, padded
from rvjax.population import Population, drawn, root_key
from rvjax.response import BLOCK, Response, elements, is_costly, parts
from rvjax.status import succeeded
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.optimum.known import Known, distance, place_of, whole, wrong_sides
from rvjax.tolerances.requirements.limits import Limits

WRONG = 0.1  # units expected on the wrong side of a limit, at most
REACHED = 0.9  # of the way to a limit, within which no costly unit is solved on its account
_STEP = 128  # units solved next, at least
_RANDOM = 32  # of the first units solved at a new set
_IDLE = 0.5  # change of a limit, in half-widths, up to which outputs that decide nothing are not solved again
_FAR = 1.0  # change of a limit, in half-widths, beyond which nothing is predicted
_FIRST = 512  # units that show there whether the outputs of a part decide anything
_LARGEST = 3.0  # standard deviations of the largest of 32 deviations, more than it has by chance (2.1)
_CAUTION = 1.2  # on the spread, which comes from few units
_FEWEST = 8  # solved units behind a line of units with gradients
_KEPT = 24  # sets of tolerances that are remembered
_ALIKE = 1e-9  # change of a limit, in half-widths, that is rounding

Aims = Callable[[dict[str, np.ndarray], float], dict[str, list[float]]]
"""Values (n,) of all units by name, nan where one failed, and how far limits have moved since, in parts of the larger
half-width -> values at which a unit of each may decide."""


def followable(response: Response, requirements: dict[str, Limits]) -> bool:
    """True if units are costly and all requirements are shares within limits."""
    return is_costly(response) and all(item.of_shares for item in requirements.values())


class Followed:
    """Units of one sample."""

    def __init__(
        self, response: Response, population: Population, samples: int, seed: int, memo: Memo | None = None
    ) -> None:
        self.samples, self.seed, self._memo = samples, seed, memo
        self.parts = parts(response, population)
        self.names = [name for part in self.parts for name in part.names]
        self._known: list[Known] = []
        self._slopes: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._random = np.random.default_rng(seed)
        self._states: list[tuple[np.ndarray, dict[int, np.ndarray]]] = [(np.empty((0, 2)), {}) for _ in self.parts]
        key, block = root_key(seed), min(samples, BLOCK)
        blocks = [np.asarray(drawn(population, key, np.uint32(i), count=block)) for i in range(0, samples, block)]
        self.z = np.concatenate(blocks, axis=1)[:, :samples]

    @property
    def solved(self) -> int:
        """Units solved so far, the most of any part."""
        return max(part.solved for part in self.parts)

    def at(self, population: Population, aims: Aims, wrong: float = WRONG) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Values (n,) by name, nan where a unit failed, and status (n,): exact where a unit may decide.

        Args:
            population: tolerances of the units.
            aims: values at which units decide.
            wrong: units expected on the wrong side of one of these, at most.
        """
        place = place_of(population)
        known = min(self._known, key=lambda item: distance(item.place, place), default=None)
        if known is None or distance(known.place, place) > _FAR:
            return self.all_at(population, None if known is None else aims)
        numbers = range(len(self.parts))
        if distance(known.place, place) <= _ALIKE and all(self.settled(known, n, place, aims, wrong) for n in numbers):
            return whole(known.values, known.status)
        found = _Step(self, known, population)
        found.begin(aims, wrong)
        while found.widen(aims, wrong):
            pass
        new = Known(population, place, found.values, found.doubt, found.status, found.seen)
        self._remember(new)
        return whole(new.values, new.status)

    def all_at(self, population: Population, aims: Aims | None = None) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """The same, every unit solved; with `aims` only where the first units show that an output decides something.

        The first ones, in turn, represent the other units of a part that decides nothing.
        """
        first = self.samples if aims is None else min(_FIRST, self.samples)
        values: dict[str, np.ndarray] = {}
        status: list[np.ndarray] = []
        for number in range(len(self.parts)):
            rows, found = self.solve(number, population, np.arange(first))
            values |= rows
            status.append(found)
        wanted = {} if aims is None else aims(values, 0.0)
        doubt: dict[str, np.ndarray] = {}
        for number, part in enumerate(self.parts):
            idle = not any(wanted.get(name) for name in part.names) and succeeded(status[number]).all()
            if first < self.samples and not idle:
                rows, found = self.solve(number, population, np.arange(first, self.samples))
                values |= {name: np.append(values[name], row) for name, row in rows.items()}
                status[number] = np.append(status[number], found)
            for name in part.names:
                solved, row = np.arange(self.samples) < len(values[name]), values[name]
                values[name] = np.resize(row, self.samples)
                doubt[name] = np.where(solved, 0.0, row.std())
            status[number] = np.resize(status[number], self.samples)
        place = place_of(population)
        self._remember(Known(population, place, values, doubt, status, [place] * len(self.parts)))
        return whole(values, status)

    def exactly(self, population: Population) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """The same, as it is known already where every unit was solved there."""
        place = place_of(population)
        for known in self._known:
            away = max(distance(there, place) for there in (known.place, *known.seen))
            if away <= _ALIKE and not any(row.any() for row in known.doubt.values()):
                return whole(known.values, known.status)
        return self.all_at(population)

    def some_at(self, population: Population, units: np.ndarray) -> dict[str, np.ndarray]:
        """Values by name of some units."""
        found = [self.solve(number, population, units)[0] for number in range(len(self.parts))]
        return {name: row for rows in found for name, row in rows.items()}

    def of_few(
        self, population: Population, count: int, decided: Callable[[dict[str, np.ndarray]], bool]
    ) -> dict[str, np.ndarray] | None:
        """Values of the first `count` units, or of twice as many and so on, that decide; None if half of all do not."""
        values: dict[str, np.ndarray] = {name: np.empty(0) for name in self.names}
        while count <= self.samples // 2:
            more = self.some_at(population, np.arange(len(values[self.names[0]]), count))
            values = {name: np.append(row, more[name]) for name, row in values.items()}
            if decided(values):
                return values
            count *= 2
        return None

    def solve(self, number: int, population: Population, units: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Values by name and status of some units of one part."""
        part = self.parts[number]

        def compute() -> np.ndarray:
            values, status, state = part.solution(population, self.z[:, units])
            self._states_at(number, population).update(zip(units.tolist(), state.T))
            return np.concatenate([np.where(succeeded(np.asarray(status)), values, np.nan), status[None]])

        rows = self._recalled("followed", number, population, units.tobytes(), compute)
        return dict(zip(part.names, rows)), rows[-1].astype(np.int32)

    def slopes(self, number: int, population: Population, units: np.ndarray, cotangents: np.ndarray) -> np.ndarray:
        """Gradients (elements, n) of weighted values of some units of one part.

        Units that were solved at this set of tolerances are not solved again.

        Args:
            number: of the part.
            population: tolerances of the units.
            units: (n,) indices.
            cotangents: weights (k, n) of the values of the part.
        """
        part = self.parts[number]

        def compute() -> np.ndarray:
            states = self._states_at(number, population)
            missing = np.array([unit for unit in dict.fromkeys(units.tolist()) if unit not in states], int)
            if missing.size:
                states.update(zip(missing.tolist(), part.solution(population, self.z[:, missing])[2].T))
            state = np.stack([states[unit] for unit in units.tolist()], axis=1)
            return part.slopes(population, self.z[:, units], state, cotangents)

        return self._recalled("slopes", number, population, units.tobytes() + cotangents.tobytes(), compute)

    def _states_at(self, number: int, population: Population) -> dict[int, np.ndarray]:
        """States of the units of a part that were solved at these tolerances; those of others are forgotten."""
        place = place_of(population)
        if not np.array_equal(self._states[number][0], place):
            self._states[number] = place, {}
        return self._states[number][1]

    def _recalled(
        self, what: str, number: int, population: Population, about: bytes, compute: Callable[[], np.ndarray]
    ) -> np.ndarray:
        if self._memo is None:
            return compute()
        text = repr((self.parts[number].names, self.seed, place_of(population).tolist())).encode()
        return self._memo.recall({what: hashlib.sha256(text + about).hexdigest()}, compute)

    def learn(self, name: str, units: np.ndarray, slopes: np.ndarray) -> None:
        """Gradients of a value to the errors of some units: these are predicted by them from now on.

        Args:
            name: of the value.
            units: (n,) indices.
            slopes: (elements, n).
        """
        self._slopes[name] = units, slopes

    def moved(self, before: Population, after: Population) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """{name: units with gradients (n,), and the change (n,) that these predict from one set to another}."""
        found = {}
        for name, (units, slopes) in self._slopes.items():
            lanes = padded(units, PULLED).reshape(-1, PULLED)  # one program
            here, there = (
                np.concatenate([np.asarray(elements(p, self.z[:, row])) for row in lanes], axis=1)
                for p in (before, after)
            )
            found[name] = units, np.einsum("en,en->n", slopes, (there - here)[:, : len(units)])
        return found

    def drawn(self, count: int) -> np.ndarray:
        """Some units at random."""
        return self._random.choice(self.samples, min(count, self.samples), replace=False)

    def settled(self, known: Known, number: int, place: np.ndarray, aims: Aims, most: float) -> bool:
        """True if the stored values of a part suffice for other aims at the place of its latest units."""
        moved, names = distance(known.seen[number], place), self.parts[number].names
        wanted = aims(known.values, moved)
        if moved > _ALIKE:
            return not any(wanted.get(n) for n in names)
        return all(wrong_sides(known.values[n], known.doubt[n], wanted.get(n, [])).sum() <= most for n in names)

    def _remember(self, known: Known) -> None:
        others = [item for item in self._known if distance(item.place, known.place) > _ALIKE]
        self._known = [*others[:1], *others[1:][-_KEPT:], known]  # the first one is evaluated again at the end


class _Step:
    """Step from one set of tolerances to another."""

    def __init__(self, units: Followed, known: Known, population: Population) -> None:
        self.units, self.known, self.population = units, known, population
        self.values = {name: row.copy() for name, row in known.values.items()}
        self.doubt = {name: row.copy() for name, row in known.doubt.items()}
        self.status = [row.copy() for row in known.status]
        self.seen, self.place = list(known.seen), place_of(population)
        self.solved = [np.zeros(units.samples, bool) for _ in units.parts]
        self.random = units.drawn(_RANDOM)
        self.sloped, self.before = {}, dict(known.values)
        for name, (rows, change) in units.moved(known.population, population).items():
            self.sloped[name] = np.isin(np.arange(units.samples), rows)
            self.before[name] = known.values[name].copy()
            self.before[name][rows] += change

    def begin(self, aims: Aims, most: float) -> None:
        """Solve the units nearest where they decide, some at random, and all that failed."""
        for number, part in enumerate(self.units.parts):
            moved = distance(self.seen[number], self.place)
            wanted = aims(self.known.values, moved)
            if moved <= _IDLE and not any(wanted.get(name) for name in part.names):
                continue
            if moved <= _ALIKE and self.units.settled(self.known, number, self.place, aims, most):
                continue
            first = np.zeros(self.units.samples, bool)
            first[self.random] = True
            for name in part.names:
                row = self.before[name]
                first |= np.isnan(row)
                for level in wanted.get(name, []):
                    if np.isfinite(level):
                        first[np.argsort(np.abs(row - level))[: (_STEP - _RANDOM) // len(part.names)]] = True
            self._solve(number, np.flatnonzero(first))
            if any(np.isnan(self.values[n] - self.known.values[n])[self.random].any() for n in part.names):
                self._solve(number, np.flatnonzero(~self.solved[number]))  # a line foresees no failures

    def widen(self, aims: Aims, most: float) -> bool:
        """Solve the units whose side is uncertain; False if there are none."""
        wanted, more = aims(self.values, 0.0), False
        for number, part in enumerate(self.units.parts):
            wrong = np.zeros(self.units.samples)
            for name in part.names:
                wrong = np.maximum(wrong, wrong_sides(self.values[name], self.doubt[name], wanted.get(name, [])))
            if wrong.sum() <= most:
                continue
            order = np.argsort(-wrong, kind="stable")
            left = wrong.sum() - np.cumsum(wrong[order])
            count = int(np.argmax(left <= most)) + 1
            count = min(-(-count // _STEP) * _STEP, int((wrong > 0).sum()))
            self._solve(number, order[:count])
            more = True
        return more

    def _solve(self, number: int, units: np.ndarray) -> None:
        """Solve some units of a part, and predict the others by all that are solved."""
        rows, self.status[number][units] = self.units.solve(number, self.population, units)
        self.solved[number][units], self.seen[number] = True, self.place
        others = ~self.solved[number]
        for name, row in rows.items():
            self.values[name][units], self.doubt[name][units] = row, 0.0
            self._predict(name, self.solved[number], others)

    def _predict(self, name: str, solved: np.ndarray, others: np.ndarray) -> None:
        """Values of units that are not solved, by a line through those that are, and the spread about it."""
        solved = solved & np.isfinite(self.known.values[name]) & np.isfinite(self.values[name])
        sloped = self.sloped.get(name, np.zeros(len(solved), bool))
        if (solved & sloped).sum() < _FEWEST:
            self._line(name, self.known.values[name], solved, others, self.random)
            return
        self._line(name, self.before[name], solved & sloped, others & sloped, np.flatnonzero(solved & sloped))
        self._line(name, self.known.values[name], solved & ~sloped, others & ~sloped, self.random)

    def _line(self, name: str, before: np.ndarray, solved: np.ndarray, others: np.ndarray, checked: np.ndarray) -> None:
        """Values of some units by a line through the solved ones; the largest deviation of the checked ones counts."""
        now = self.values[name]
        x, y = before[solved], now[solved]
        if len(x) < 3:
            return
        spread = float(((x - x.mean()) ** 2).sum())
        slope = float((x - x.mean()) @ (y - y.mean())) / spread if spread > 0 else 0.0
        predicted = y.mean() + slope * (before - x.mean())
        left = np.where(solved, now - predicted, 0.0)
        largest = float(np.abs(left[checked]).max()) / _LARGEST
        sd = _CAUTION * max(float(np.sqrt((left**2).sum() / (len(x) - 2))), largest)
        now[others] = predicted[others]
        self.doubt[name][others] = np.hypot(sd, slope * self.known.doubt[name][others])
