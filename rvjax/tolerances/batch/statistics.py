"""Statistics of a Monte Carlo run, each with its standard error and confidence interval."""

import dataclasses
import math
from typing import TYPE_CHECKING

from rvjax.base import frames
from rvjax.population import Estimate
from rvjax.records import PyTree

if TYPE_CHECKING:
    from rvjax.base.frames import DataFrame


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Statistics of a sample of units.

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
        sd: `Estimate` of the standard deviation; its error holds for any distribution.
        quantiles: {p: `Estimate`}, linear between order statistics; exact with `keep` or up to 4096 units, else
            from counts in bins: the interval contains the bins of its ends. Intervals are binomial for independent
            units.
        minimum: smallest value.
        maximum: largest value.
        infinite: units whose response is infinite on the side without a limit. They are successes, count in yields and
            quantiles, and take no part in mean, sd, cp and cpk, which are those of the finite responses.
        yield_: `Estimate` of the share of units within the limits, Wilson interval; None without limits of units.
        ppm: `Estimate` of the rejects per million units.
        cp: (U - L)/(6 sd); nan for a one-sided requirement.
        cpk: min(U - mean, mean - L)/(3 sd).
        cp_estimate: `Estimate` of cp, nan where there is none.
        cpk_estimate: `Estimate` of cpk, by the delta method for any distribution.
        joint_yield: `Estimate` of the share of units that meet all requirements.
        verdicts: `Verdict` on each requirement; None without.
        values: response of every unit, nan for failed ones, if `keep`; else None.
        study: inputs, as text: tolerances, requirements, response (its hash, with a checkpoint) ...
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
    mean: PyTree
    sd: PyTree
    quantiles: dict[float, PyTree]
    minimum: PyTree
    maximum: PyTree
    infinite: PyTree
    yield_: PyTree
    ppm: PyTree
    cp: PyTree
    cpk: PyTree
    cp_estimate: PyTree
    cpk_estimate: PyTree
    joint_yield: Estimate | None
    verdicts: PyTree
    values: PyTree
    study: dict[str, str]
    versions: dict[str, str]

    def to_pandas(self) -> "DataFrame":
        """Return a `pandas.DataFrame`, SI: one row for each response, every estimate with its error and interval."""
        some = isinstance(self.mean, dict)

        def of(item: PyTree, name: str) -> PyTree:
            return item[name] if some and item is not None else item

        def row(name: str) -> dict[str, object]:
            found: dict[str, object] = {"response": name, **frames.spread("mean", of(self.mean, name))}
            found |= frames.spread("sd", of(self.sd, name))
            found |= {end: of(getattr(self, end), name) for end in ("minimum", "maximum", "infinite")}
            for p, quantile in self.quantiles.items():
                found |= frames.spread(f"quantile_{p:g}", of(quantile, name))
            found |= frames.spread("yield", of(self.yield_, name))
            return found | {"cp": of(self.cp, name), "cpk": of(self.cpk, name)}

        return frames.tidy(map(row, self.mean if some else ["response"]), ["response"])


def shares_alone(statistics: Statistics) -> Statistics:
    """Shares and verdicts; other figures are nan, for only units near the limits were solved.

    Args:
        statistics: of all units, by name, with old values of units that are far from the limits.
    """
    nothing = Estimate(*[math.nan] * 4)
    estimates, numbers = (dict.fromkeys(statistics.mean, value) for value in (nothing, math.nan))
    return dataclasses.replace(
        statistics, mean=estimates, sd=estimates, quantiles=dict.fromkeys(statistics.quantiles, estimates),
        minimum=numbers, maximum=numbers, cp=numbers, cpk=numbers, cp_estimate=estimates, cpk_estimate=estimates,
        failures={}, examples={}, worst_index=None, values=None,
    )  # fmt: skip


def rejects(share: Estimate | None) -> Estimate | None:
    """Rejects per million of a share of good units."""
    if share is None:
        return None
    return Estimate(1e6 * (1 - share.value), 1e6 * share.error, 1e6 * (1 - share.upper), 1e6 * (1 - share.lower))
