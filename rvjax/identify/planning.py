"""Before a measurement: which elements it identifies (`identifiability`), and the best next one (`rank_measurements`).

The gain of measurements about the elements of interest, I, is the expected fall of the entropy of u_I, in nats:
(ln det C_II - ln det C'_II)/2. It is computed as the information about all numbers less that about what u_I leaves
open, [ln det(1 + J'J) - ln det(1 + Z'J'J Z)]/2 with Z the directions that leave u_I as it is: two sums of logarithms of
numbers above 1, which keep their digits next to a wide nuisance. With nuisances gains are not submodular, two torques
cancel an offset that one cannot, so that choosing the best one after the other may miss the best set.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from rvjax._jax.checks import checked
from rvjax._jax.sizes import SETS
from rvjax.identify.elements import Identifiability, Spectrum, compress_rows, findings, mapped_values
from rvjax.identify.identification import Model, Problem, counted, program_of
from rvjax.identify.observation import Noise
from rvjax.identify.posterior import Posterior
from rvjax.population import Correlation


@checked
def identifiability(
    model: Model,
    prior: object,
    *,
    noise: Noise,
    at: object = None,
    nuisance: str | Iterable[str] = (),
    correlation: Correlation = None,
) -> Identifiability:
    """Predict which elements a measurement identifies; needs no data.

    Args:
        model: pure function, values of the prior's structure -> observation.
        prior: record or dict (nested ones too) with a `Tolerance`, a constant or None in each field.
        noise: of the observation.
        at: values at which the model is linearised, structure of the prior; None: the mid-point of the prior.
        nuisance: names of fields or elements that are not of interest; here they count as all others.
        correlation: {(field or element, field or element): correlation of their u}.

    Raises:
        ValueError: an argument that does not fit, or a model that is not finite there.
    """
    problem = Problem.of(model, prior, noise=noise, nuisance=nuisance, correlation=correlation)
    u = np.zeros(problem.elements.count) if at is None else problem.elements.at("at", at)
    slopes = slopes_at(problem, u)[0] / problem.sd[:, None]
    mixing = problem.elements.mixing
    spectrum = Spectrum.of(np.sqrt(problem.discount) * slopes @ mixing)
    return findings(problem.elements.names, mixing, spectrum)


def slopes_at(problem: Problem, u: np.ndarray, models: Sequence[Model] = ()) -> np.ndarray:
    """Slopes over u (k, m, p) of models at u (p,), by default of that of the problem; the model must be finite there.

    Args:
        problem: with its noise left out.
        u: standard numbers.
        models: that differ in fields of their parts alone.

    Raises:
        ValueError: a model that is not finite at u.
    """
    observation, slopes = problem.evaluate(np.tile(u, (max(len(models), 1), 1)), models=models)
    if not (np.isfinite(slopes).all() and np.isfinite(observation).all()):
        values = problem.elements.structure(mapped_values(problem.elements, u[None])[0])
        raise ValueError(f"model: its observation or its slope is not finite at {values}, in SI".replace("\n", " "))
    return slopes


@dataclasses.dataclass(frozen=True)
class Ranking:
    """Measurements by information.

    Attributes:
        gains: {candidate: nats about the elements of interest, from this measurement only}.
        chosen: names of the best set found, the largest gain first.
        total: nats of that set.
        proved: whether all sets were tried.
    """

    gains: dict[str, float]
    chosen: tuple[str, ...]
    total: float
    proved: bool


@checked
def rank_measurements(
    prior: object,
    candidates: Mapping[str, Model],
    *,
    noise: Noise | Mapping[str, Noise],
    nuisance: str | Iterable[str] = (),
    given: Posterior | None = None,
    count: float = 1,
    costs: Mapping[str, float] | None = None,
    correlation: Correlation = None,
    exhaustive: int = 5000,
    already: str = "",
) -> Ranking:
    """Rank measurements by their information about all elements except nuisances.

    Args:
        prior: record or dict with a `Tolerance`, a constant or None in each field.
        candidates: {name: model of what would be observed}.
        noise: of every candidate, or {name: Noise}.
        nuisance: names of fields or elements that are not of interest.
        given: what was measured before; None: nothing.
        count: how many to choose; with `costs` and not 1, the budget that the costs of the set may not exceed.
        costs: {name: cost}; with a count of 1 the choice is the largest gain per cost.
        correlation: {(field or element, field or element): correlation of their u}.
        exhaustive: most sets that are all tried; beyond, the best is searched one by one and by exchanges.
        already: name of a candidate that is measured in any case; gains are on top of it.

    Raises:
        ValueError: an unknown name, or an argument that does not fit.
    """
    if not isinstance(candidates, Mapping) or not candidates:
        raise ValueError(f"candidates = {candidates!r}: must be a dict of models by name")
    for name, model in candidates.items():
        if not callable(model):
            raise ValueError(f"candidates: {name} = {model!r}: must be a function")
    counted("exhaustive", exhaustive, 1)
    if already and already not in candidates:
        raise ValueError(f"already = {already!r} is no candidate; these are: {', '.join(candidates)}")
    noises = noise if isinstance(noise, Mapping) else dict.fromkeys(candidates, noise)
    for name in (*noises, *candidates):
        if name not in candidates or name not in noises:
            raise ValueError(f"noise: {name!r} must be a candidate with a Noise")
    problems = {
        name: Problem.of(model, prior, noise=noises[name], nuisance=nuisance, correlation=correlation)
        for name, model in candidates.items()
    }
    if any(len(each.nuisance) == each.elements.count for each in problems.values()):
        raise ValueError(f"nuisance = {nuisance!r}: no element is left")
    gain = _Gain.of(problems, given, already)
    names = [name for name in candidates if name != already]
    gains = gain.of_sets([(k,) for k in range(len(names))])
    if costs is None:
        counted("count", count, 1)  # type: ignore[arg-type]
        if count > len(names):
            raise ValueError(f"count = {count!r}: there are only {len(names)} candidates")
        prices, number = np.ones(len(names)), math.comb(len(names), int(count))
        sets: Iterable[tuple[int, ...]] = itertools.combinations(range(len(names)), int(count))
    else:
        prices, number = _prices(costs, names), 2 ** len(names) - 1
        if not count > 0:
            raise ValueError(f"count = {count!r}: must be positive, unit of the costs")
        sets = _affordable(prices, float(count))
    if costs is None or count != 1:
        chosen, total, proved = _choose(gain, sets, number, exhaustive, prices, float(count))
    else:
        best = int(np.argmax(gains / prices))
        chosen, total, proved = (best,), float(gains[best]), True
    order = sorted(chosen, key=lambda k: -gains[k])
    return Ranking(dict(zip(names, map(float, gains))), tuple(names[k] for k in order), total, proved)


def _prices(costs: Mapping[str, float], names: list[str]) -> np.ndarray:
    for name in costs:
        if name not in names:
            raise ValueError(f"costs: {name!r} is no candidate; these are: {', '.join(names)}")
    for name in names:
        if name not in costs:
            raise ValueError(f"costs: candidate {name!r} has none, unit of the costs")
        if not (costs[name] > 0 and math.isfinite(costs[name])):
            raise ValueError(f"costs[{name!r}] = {costs[name]!r}: must be positive and finite, unit of the costs")
    return np.array([float(costs[name]) for name in names])


def _affordable(prices: np.ndarray, budget: float) -> Iterator[tuple[int, ...]]:
    for size in range(1, len(prices) + 1):
        for places in itertools.combinations(range(len(prices)), size):
            if prices[list(places)].sum() <= budget:
                yield places


@dataclasses.dataclass(frozen=True, eq=False)
class _Gain:
    """Gains of sets of candidates, from the triangular factors of their slopes."""

    factors: np.ndarray  # (candidates, rows, n): of slopes over v, where z = z^ + L v
    open: np.ndarray  # Z (n, k)
    already: np.ndarray  # (rows, n): of what is measured in any case

    @classmethod
    def of(cls, problems: Mapping[str, Problem], given: Posterior | None, already: str) -> "_Gain":
        first = next(iter(problems.values()))
        elements, asked = first.elements, np.setdiff1d(np.arange(first.elements.count), first.nuisance)
        u, root = np.zeros(elements.count), np.eye(elements.mixing.shape[1])
        if given is not None:
            if given.names != elements.names:
                raise ValueError(f"given: has the elements {', '.join(given.names)}, prior {', '.join(elements.names)}")
            if not given.peaks:
                raise ValueError(f"given: status {given.status}, it must have a mode")
            u, root = given.u, given.peaks[0].spectrum.root
        mixing = elements.mixing @ root
        every = list(problems.values())
        raw = zip(every, _slopes(every, u))
        slopes = [np.sqrt(each.discount) / each.sd[:, None] * slope @ mixing for each, slope in raw]
        factors = [compress_rows(item) for item in slopes]
        rows = max(len(item) for item in factors)
        stacked = np.stack([np.pad(item, ((0, rows - len(item)), (0, 0))) for item in factors])
        own, free = np.array([name == already for name in problems]), np.linalg.svd(mixing[asked])[2][asked.size :].T
        return cls(stacked[~own], free, stacked[own].reshape(-1, root.shape[1]))

    def of_sets(self, sets: list[tuple[int, ...]]) -> np.ndarray:
        """Gain of each set, all of one size."""
        rows = self.factors[np.array(sets, int)].reshape(len(sets), -1, self.factors.shape[-1])
        both = np.concatenate([rows, np.tile(self.already, (len(sets), 1, 1))], axis=1)
        return self._about(both) - self._about(self.already)

    def _about(self, rows: np.ndarray) -> np.ndarray:
        """Nats about the elements of interest of rows (..., rows, n)."""
        return _nats(rows) - (_nats(rows @ self.open) if self.open.size else 0.0)

    def best(self, sets: Iterable[tuple[int, ...]]) -> tuple[tuple[int, ...], float]:
        """Return the set of largest gain; the empty one where there is none."""
        best: tuple[tuple[int, ...], float] = ((), 0.0)
        for _, same in itertools.groupby(sets, len):
            while block := list(itertools.islice(same, SETS)):
                gains = self.of_sets(block)
                if gains.max() > best[1] or not best[0]:
                    best = block[int(np.argmax(gains))], float(gains.max())
        return best


def _slopes(problems: list[Problem], u: np.ndarray) -> list[np.ndarray]:
    """Slopes over u (m, p) of the model of each problem; those that share a program are evaluated side by side."""
    groups: dict[Hashable, dict[int, Problem]] = {}
    for each in problems:
        groups.setdefault(program_of(each.model), {})[id(each.model)] = each
    slopes: dict[int, np.ndarray] = {}
    for group in groups.values():
        first, *_ = same = list(group.values())
        slopes |= zip(group, slopes_at(first, u, [each.model for each in same]))
    return [slopes[id(each.model)] for each in problems]


def _nats(rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.log1p(np.linalg.svd(rows, compute_uv=False) ** 2).sum(axis=-1) / 2)


def _choose(
    gain: _Gain, sets: Iterable[tuple[int, ...]], number: int, exhaustive: int, prices: np.ndarray, budget: float
) -> tuple[tuple[int, ...], float, bool]:
    """Return the best set within a budget, its gain, and whether all were tried."""
    if number <= exhaustive:
        return *gain.best(sets), True
    fits: Callable[[Iterable[int]], bool] = lambda places: prices[list(places)].sum() <= budget * (1 + 1e-12)  # noqa: E731
    chosen: tuple[int, ...] = ()
    total = 0.0
    while True:  # the largest gain per cost that is still affordable
        added = [(*chosen, k) for k in range(len(prices)) if k not in chosen and fits((*chosen, k))]
        if not added:
            break
        gains = gain.of_sets(added)
        best = int(np.argmax((gains - total) / prices[[item[-1] for item in added]]))
        chosen, total = added[best], float(gains[best])
    while True:  # exchanges of one for another
        outside = [k for k in range(len(prices)) if k not in chosen]
        swaps = [(*(i for i in chosen if i != out), k) for out in chosen for k in outside]
        swap = gain.best(item for item in swaps if fits(item))
        if not swap[1] > total * (1 + 1e-12):
            return chosen, total, False
        chosen, total = swap
