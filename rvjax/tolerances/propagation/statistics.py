"""The figures of a Monte Carlo run, each with its standard error and confidence interval."""

import dataclasses
import math
from typing import Any

import numpy as np

from rvjax.status import PRECEDENCE
from rvjax.tolerances.propagation.checkpoint import versions
from rvjax.tolerances.propagation.estimates import Estimate, wilson
from rvjax.tolerances.propagation.order import quantile_estimate
from rvjax.tolerances.propagation.responses import like_response
from rvjax.tolerances.propagation.scrambles import mean_of, share_estimate
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
        yield_: `Estimate` of the share of units within the limits, Wilson interval; None without requirement.
        ppm: `Estimate` of the rejects per million units.
        cp: (U - L)/(6 sd); nan for a one-sided requirement.
        cpk: min(U - mean, mean - L)/(3 sd).
        joint_yield: `Estimate` of the share of units that meet all requirements.
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
    values: Any
    study: dict[str, str]
    versions: dict[str, str]


def statistics(
    tally: Tally, *, quantiles: tuple[float, ...], confidence: float, seed: int, method: str, study: dict[str, str]
) -> Statistics:
    """The figures of what a tally has counted.

    Args:
        tally: of all units.
        quantiles: shares whose quantiles are wanted.
        confidence: of every interval.
        seed: of the random numbers.
        method: of the random numbers.
        study: what was asked, as text.
    """
    named = [status for status in PRECEDENCE if int(status) in tally.failures]
    streams = {name: [tree.total() for tree in trees] for name, trees in tally.moments.items()}
    whole = {name: parts[0] for name, parts in streams.items()}
    for name, parts in streams.items():
        for part in parts[1:]:
            whole[name] = whole[name].merge(part)
    if tally.streams == 1:
        means = {name: m.mean_estimate(confidence) for name, m in whole.items()}
        sds = {name: m.sd_estimate(confidence) for name, m in whole.items()}
    else:
        means = {
            name: mean_of([m.mean_or_nan for m in parts], whole[name].mean_or_nan, confidence)
            for name, parts in streams.items()
        }
        sds = {name: mean_of([m.sd for m in parts], whole[name].sd, confidence) for name, parts in streams.items()}

    def share(hits: np.ndarray) -> Estimate:
        if tally.streams == 1:
            return wilson(int(hits[0]), int(tally.seen[0]), confidence)
        return share_estimate(hits, tally.seen, confidence)

    orders, required = tally.orders(), tally.requirements
    yields = {name: share(tally.passed[name]) if name in required else None for name in tally.names}
    capability = {
        name: required[name].capability(m.mean, m.sd) if name in required and m.n else (math.nan, math.nan)
        for name, m in whole.items()
    }
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
        mean=like_response(means),
        sd=like_response(sds),
        quantiles={
            p: like_response({name: quantile_estimate(order, p, confidence) for name, order in orders.items()})
            for p in quantiles
        },
        minimum=like_response({name: m.minimum for name, m in whole.items()}),
        maximum=like_response({name: m.maximum for name, m in whole.items()}),
        yield_=like_response(yields) if required else None,
        ppm=like_response({name: _ppm(share) for name, share in yields.items()}) if required else None,
        cp=like_response({name: cp for name, (cp, _) in capability.items()}) if required else None,
        cpk=like_response({name: cpk for name, (_, cpk) in capability.items()}) if required else None,
        joint_yield=share(tally.joint) if required else None,
        values=like_response(tally.values) if tally.values else None,
        study=study,
        versions=versions(),
    )


def _ppm(share: Estimate | None) -> Estimate | None:
    if share is None:
        return None
    return Estimate(1e6 * (1 - share.value), 1e6 * share.error, 1e6 * (1 - share.upper), 1e6 * (1 - share.lower))
