"""The figures of a Monte Carlo run, each with its standard error and confidence interval."""

import dataclasses
import math
from typing import Any

from rvjax.status import PRECEDENCE
from rvjax.tolerances.propagation.checkpoint import versions
from rvjax.tolerances.propagation.estimates import Estimate
from rvjax.tolerances.propagation.order import quantile_estimate
from rvjax.tolerances.propagation.requirements import Limits
from rvjax.tolerances.propagation.sampled import Sampled
from rvjax.tolerances.propagation.tally import Tally


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
        standard_errors: where the errors of the estimates come from: "independent units", or the spread of
            "16 independent scrambles".
        confidence: of every interval.
        failed: units without a valid response.
        failures: their number by status name.
        examples: index of the first failed unit by status name; `sample` replays it.
        worst_index: index of the first unit that failed for the worst reason, None without failures.
        mean: `Estimate` of the mean, unit of the response.
        sd: `Estimate` of the standard deviation; its error holds for any law.
        quantiles: {p: `Estimate`}, linear between order statistics; exact with `keep` or up to 4096 units,
            else within one histogram bin. Intervals are binomial for independent units.
        minimum: smallest value.
        maximum: largest value.
        yield_: `Estimate` of the share of units within the limits, Wilson interval; None without limits of units.
        ppm: `Estimate` of the rejects per million units.
        cp: (U - L)/(6 sd); nan for a one-sided requirement.
        cpk: min(U - mean, mean - L)/(3 sd).
        joint_yield: `Estimate` of the share of units that meet all requirements.
        verdicts: `Verdict` on each requirement; None without.
        values: response of every unit, nan for failed ones, if `keep`; else None.
        study: what was asked, as text: tolerances, requirements, response (its hash, with a checkpoint) ...
        versions: of rvjax and what the numbers come from.
    """

    samples: int
    seed: int
    method: str
    standard_errors: str
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
    verdicts: Any
    values: Any
    study: dict[str, str]
    versions: dict[str, str]


def statistics(
    tally: Tally,
    requirements: dict[str, Limits],
    *,
    quantiles: tuple[float, ...],
    confidence: float,
    seed: int,
    method: str,
    study: dict[str, str],
) -> Statistics:
    """The figures of what a tally has counted, as dicts by name of the response.

    Args:
        tally: of all units.
        requirements: by name.
        quantiles: shares whose quantiles are wanted.
        confidence: of every interval.
        seed: of the random numbers.
        method: of the random numbers.
        study: what was asked, as text.
    """
    named = [status for status in PRECEDENCE if int(status) in tally.failures]
    seen = {
        name: Sampled([tree.total() for tree in trees], tally.passed.get(name), tally.seen, confidence)
        for name, trees in tally.moments.items()
    }
    orders, any_units = tally.orders(), bool(tally.requirements)
    yields = {name: None if item.passed is None else item.share() for name, item in seen.items()}
    verdicts = {name: item.verdict(seen[name]) for name, item in requirements.items()}
    return Statistics(
        samples=int(tally.seen.sum()),
        seed=seed,
        method=method,
        standard_errors="independent units" if tally.streams == 1 else f"{tally.streams} independent scrambles",
        confidence=confidence,
        failed=sum(tally.failures.values()),
        failures={status.name: tally.failures[int(status)] for status in named},
        examples={status.name: tally.examples[int(status)] for status in named},
        worst_index=tally.examples[int(named[0])] if named else None,
        mean={name: item.mean() for name, item in seen.items()},
        sd={name: item.sd() for name, item in seen.items()},
        quantiles={p: {n: quantile_estimate(order, p, confidence) for n, order in orders.items()} for p in quantiles},
        minimum={name: item.whole.minimum for name, item in seen.items()},
        maximum={name: item.whole.maximum for name, item in seen.items()},
        yield_=yields if any_units else None,
        ppm={name: _ppm(share) for name, share in yields.items()} if any_units else None,
        cp={name: _capability(tally, name, item)[0] for name, item in seen.items()} if any_units else None,
        cpk={name: _capability(tally, name, item)[1] for name, item in seen.items()} if any_units else None,
        joint_yield=next(iter(seen.values())).share(tally.joint) if any_units else None,
        verdicts=verdicts or None,
        values=tally.values or None,
        study=study,
        versions=versions(),
    )


def _capability(tally: Tally, name: str, sampled: Sampled) -> tuple[float, float]:
    moments = sampled.whole
    if name not in tally.requirements or not moments.n:
        return math.nan, math.nan
    return tally.requirements[name].capability(moments.mean, moments.sd)


def _ppm(share: Estimate | None) -> Estimate | None:
    if share is None:
        return None
    return Estimate(1e6 * (1 - share.value), 1e6 * share.error, 1e6 * (1 - share.upper), 1e6 * (1 - share.lower))
