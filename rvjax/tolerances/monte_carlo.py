"""Monte Carlo: the distribution of a response over units with random errors, in constant memory."""

import contextlib
import dataclasses
import math
import operator
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from rvjax.status import PRECEDENCE, SUCCESS
from rvjax.tolerances.correlation import Correlation, correlated
from rvjax.tolerances.estimates import Estimate, Moments4, deviate_of, wilson
from rvjax.tolerances.layout import root_key
from rvjax.tolerances.order import ExactOrder, Order, quantile_estimate
from rvjax.tolerances.requirements import Requirement
from rvjax.tolerances.responses import Response, by_response, like_response, respond_units, response_names
from rvjax.tolerances.sampling import check_method


@dataclasses.dataclass(frozen=True)
class Statistics:
    """What a batch of units does.

    Fields that depend on the response have its structure: plain for a scalar response, a dict of the
    same names otherwise (quantiles: {p: ...}). A failed unit is a reject in every yield, and takes no
    part in moments, extremes and quantiles.

    Attributes:
        samples: units, failed ones included.
        seed: of the random numbers.
        method: of the random numbers.
        confidence: of every interval.
        failed: units without a valid response.
        failures: their number by status name.
        examples: index of the first failed unit by status name; `sample` replays it.
        worst_index: index of the first unit that failed for the worst reason, None without failures.
        mean: `Estimate` of the mean, unit of the response.
        sd: `Estimate` of the standard deviation; its error holds for any law.
        quantiles: {p: `Estimate`}, linear between order statistics, with binomial intervals; exact with
            `keep` or up to 4096 units, else within one histogram bin.
        minimum: smallest value.
        maximum: largest value.
        yield_: `Estimate` of the share of units within the limits, Wilson interval; None without requirement.
        ppm: `Estimate` of the rejects per million units.
        cp: (U - L)/(6 sd); nan for a one-sided requirement.
        cpk: min(U - mean, mean - L)/(3 sd).
        joint_yield: `Estimate` of the share of units that meet all requirements.
        values: response of every unit, nan for failed ones, if `keep`; else None.
    """

    samples: int
    seed: int
    method: str
    confidence: float
    failed: int
    failures: dict[str, int]
    examples: dict[str, int]
    worst_index: int | None
    mean: Any
    sd: Any
    quantiles: dict[float, Any]
    minimum: Any
    maximum: Any
    yield_: Any
    ppm: Any
    cp: Any
    cpk: Any
    joint_yield: Estimate | None
    values: Any


class _Tally:
    """Host side of a run: what is kept of the chunks."""

    def __init__(self, names: tuple[str, ...], requirements: dict[str, Requirement], kept: int) -> None:
        self.requirements = requirements
        self.moments = {name: Moments4() for name in names}
        self.orders = {name: Order() for name in names}
        self.values = {name: np.full(kept, math.nan) for name in names} if kept else {}
        self.passed = dict.fromkeys(requirements, 0)
        self.joint, self.samples = 0, 0
        self.failures: dict[int, int] = {}
        self.examples: dict[int, int] = {}

    def add(self, values: dict[str, np.ndarray], status: np.ndarray) -> None:
        """Take in the next chunk."""
        good = np.isin(status, [int(name) for name in SUCCESS])
        if not good.all():
            self._add_failures(status, good)
        joint = good.copy()
        for name, raw in values.items():
            finite = raw[good].astype(np.float64, copy=False)
            self.moments[name] = self.moments[name].merge(Moments4.of(finite))
            if self.values:
                self.values[name][self.samples : self.samples + len(raw)][good] = finite
            else:
                self.orders[name].add(finite)
            if name in self.requirements:
                passed = self.requirements[name].margin(finite) <= 0
                self.passed[name] += int(passed.sum())
                joint[good] &= passed
        self.joint += int(joint.sum())
        self.samples += len(status)

    def _add_failures(self, status: np.ndarray, good: np.ndarray) -> None:
        for code in np.unique(status[~good]):
            lanes = status == code
            self.failures[int(code)] = self.failures.get(int(code), 0) + int(lanes.sum())
            self.examples.setdefault(int(code), self.samples + int(np.argmax(lanes)))

    def statistics(self, quantiles: tuple[float, ...], confidence: float, seed: int, method: str) -> Statistics:
        """The figures with their intervals."""
        named = [status for status in PRECEDENCE if int(status) in self.failures]
        orders: dict[str, Any] = self.orders
        if self.values:
            orders = {name: ExactOrder(kept[~np.isnan(kept)]) for name, kept in self.values.items()}
        moments, required = self.moments, self.requirements
        yields = {
            name: wilson(self.passed[name], self.samples, confidence) if name in required else None for name in moments
        }
        capability = {
            name: required[name].capability(m.mean, m.sd) if name in required and m.n else (math.nan, math.nan)
            for name, m in moments.items()
        }
        return Statistics(
            samples=self.samples,
            seed=seed,
            method=method,
            confidence=confidence,
            failed=sum(self.failures.values()),
            failures={status.name: self.failures[int(status)] for status in named},
            examples={status.name: self.examples[int(status)] for status in named},
            worst_index=self.examples[int(named[0])] if named else None,
            mean=like_response({name: m.mean_estimate(confidence) for name, m in moments.items()}),
            sd=like_response({name: m.sd_estimate(confidence) for name, m in moments.items()}),
            quantiles={
                p: like_response({name: quantile_estimate(order, p, confidence) for name, order in orders.items()})
                for p in quantiles
            },
            minimum=like_response({name: m.minimum for name, m in moments.items()}),
            maximum=like_response({name: m.maximum for name, m in moments.items()}),
            yield_=like_response(yields) if required else None,
            ppm=like_response({name: _ppm(share) for name, share in yields.items()}) if required else None,
            cp=like_response({name: cp for name, (cp, _) in capability.items()}) if required else None,
            cpk=like_response({name: cpk for name, (_, cpk) in capability.items()}) if required else None,
            joint_yield=wilson(self.joint, self.samples, confidence) if required else None,
            values=like_response(self.values) if self.values else None,
        )


def _ppm(share: Estimate | None) -> Estimate | None:
    if share is None:
        return None
    return Estimate(1e6 * (1 - share.value), 1e6 * share.error, 1e6 * (1 - share.upper), 1e6 * (1 - share.lower))


def monte_carlo(
    response: Response,
    tolerances: Any,
    *,
    samples: int,
    seed: int,
    method: str = "random",
    chunk: int = 65536,
    requirements: Any = None,
    quantiles: tuple[float, ...] = (0.00135, 0.5, 0.99865),
    correlation: Correlation = None,
    confidence: float = 0.95,
    keep: bool = False,
    progress: bool = False,
) -> Statistics:
    """Statistics of a response over random units, chunk by chunk.

    Unit i depends on the seed, i and the active fields only. Another chunk size gives equal counts and
    values equal to round-off. Device memory holds two chunks, whatever `samples`.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        samples: units, at least 1.
        seed: of the random numbers.
        method: "random".
        chunk: units evaluated at once.
        requirements: `Requirement`, or a dict of them by name of the response.
        quantiles: shares whose quantiles are wanted.
        correlation: {(field or element, field or element): correlation of their z}.
        confidence: of every interval.
        keep: keep the response of every unit (host memory grows with `samples`).
        progress: show a progress bar.

    Returns:
        `Statistics`.
    """
    check_method(method)
    deviate_of(confidence)
    samples, chunk = _positive("samples", samples), _positive("chunk", chunk)
    if samples > 2**32:
        raise ValueError(f"samples = {samples}: units are numbered with 32 bits")
    for p in quantiles:
        if not 0 < p < 1:
            raise ValueError(f"quantiles: {p!r} must lie between 0 and 1")
    tolerances = correlated(tolerances, correlation)
    names = response_names(response, tolerances)
    tally = _Tally(names, by_response(requirements, names, Requirement, "requirements"), samples if keep else 0)
    with progress_bar(progress, samples, "Monte Carlo", "unit") as advance:
        for values, status in _chunks(response, tolerances, root_key(seed), samples, min(chunk, samples)):
            tally.add(values, status)
            advance(len(status))
    return tally.statistics(tuple(quantiles), confidence, seed, method)


def _chunks(
    response: Response, tolerances: Any, key: jax.Array, samples: int, chunk: int
) -> Iterator[tuple[dict[str, np.ndarray], np.ndarray]]:
    """Evaluated chunks in order; the device works on the next one while the host reads this one."""
    ready = None
    for start in (*range(0, samples, chunk), None):
        after = None
        if start is not None:  # the last chunk is as long as the others, and cut below: nothing is compiled twice
            after = (
                respond_units(response, tolerances, key, start, count=chunk),
                min(chunk, samples - start),
            )
        if ready is not None:
            (values, status), count = ready
            yield {name: np.asarray(v)[:count] for name, v in values.items()}, np.asarray(status)[:count]
        ready = after


def _positive(name: str, value: Any) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name} = {value!r}: must be an integer") from None
    if number < 1:
        raise ValueError(f"{name} = {number}: must be at least 1")
    return number


@contextlib.contextmanager
def progress_bar(shown: bool, total: int | None, description: str, unit: str) -> Iterator[Any]:
    """A function that advances a tqdm bar, or does nothing."""
    if not shown:
        yield lambda count: None
        return
    from tqdm import tqdm

    with tqdm(total=total, unit=unit, unit_scale=True, desc=description) as bar:
        yield bar.update
