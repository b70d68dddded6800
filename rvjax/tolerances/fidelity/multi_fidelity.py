"""Several fidelities: cheap responses, computed for many units, spare most of the dear one's."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from rvjax.population import CentralMoments, Correlation, Estimate, Population, deviate_of, wilson
from rvjax.response import BLOCK, Response, by_name, by_response, response_names
from rvjax.tolerances.batch.statistics import rejects
from rvjax.tolerances.fidelity.control_variates import Basis, Regressed, regressed
from rvjax.tolerances.fidelity.fidelities import Units
from rvjax.tolerances.fidelity.targeting import (
    Prediction,
    Targeted,
    chosen,
    expected_doubt,
    inclusion,
    targeted,
)
from rvjax.tolerances.requirements.limits import Limits

WORTH = 1.25
"""Variance of a plain figure over that of one with cheap responses, from which on these are used."""

WORTH_CHOOSING = 2.0
"""The same of a yield, expected: units that are chosen for it are lost to mean and standard deviation."""

_FEWEST_CHOSEN = 10
_UNSEEN_SKEWNESS = 2.0  # of squares, times that of the sample
_APART = 0.9999  # confidence of a plain interval that a figure must not leave


@dataclasses.dataclass(frozen=True)
class MultiFidelity:
    """What a batch of units does, from few units of a dear response and many of cheap ones.

    Fields but the counts have the structure of the response.

    Attributes:
        samples: units of the dear response.
        cheap_samples: further units of the cheap responses alone.
        failed: dear units without a valid value; those of the plain ones where others were chosen near a limit.
        mean: `Estimate` of the mean of the valid units.
        sd: `Estimate` of the standard deviation of the valid units.
        yield_: `Estimate` of the share of units within the limits, failed ones outside; None without requirements.
        ppm: `Estimate` of the rejects per million units.
        plain: {"mean", "sd", "yield": `Estimate`} from the dear units alone that were not chosen, for comparison.
        gain: {"mean", "sd", "yield": variance of plain Monte Carlo of `samples` units over that of the figure}: so many
            times fewer dear units do the same; the cheap ones are not counted. Below 1 where the figure is plain and
            some units were chosen for a yield.
        correlation: of the dear response and its prediction from all cheap ones, on units that the regression had not
            seen.
        correlations: {cheap response: correlation of its value, or its first one, with the dear one}.
        cheap_per_dear: units of the cheap responses for every dear one at which a given time gives the narrowest
            interval (of the yield where there is one, else of the mean), by the measured `seconds`; nan where plain.
        seconds: {"dear", "cheap": measured seconds per unit, all cheap responses together}.
        status: "OK"; "POOR_CORRELATION": every figure is plain, as from `monte_carlo`; "PARTLY_PLAIN": some are
            (their gain is at most 1); "TOO_FEW_UNITS" for a regression: every figure is plain; and, joined by ", ",
            "ESTIMATES_DISAGREE" where a figure leaves the 99.99 % interval of the plain one: its interval holds both.
    """

    samples: Any
    cheap_samples: Any
    failed: Any
    mean: Any
    sd: Any
    yield_: Any
    ppm: Any
    plain: Any
    gain: Any
    correlation: Any
    correlations: Any
    cheap_per_dear: Any
    seconds: Any
    status: Any


def multi_fidelity(
    response: Response,
    cheap: Any,
    tolerances: Any,
    *,
    samples: int,
    cheap_samples: int,
    seed: int,
    requirements: Any = None,
    correlation: Correlation = None,
    confidence: float = 0.95,
    chosen_share: float = 0.5,
) -> MultiFidelity:
    """Mean, standard deviation and yield of a dear response, with cheap ones as control variates.

    Dear units also pass through every cheap response. A regression on the cheap values, their squares and
    products as far as the units suffice, takes from the scatter of the dear values what the cheap ones know; the mean
    of the regression comes from the many cheap units. Each unit is predicted by a fit to others, so that a mean is
    unbiased.

    With requirements, a share of the dear units is chosen, once the others have shown how well cheap values predict: by
    the predicted doubt whether a unit keeps its limits, from all units with cheap values. A yield is the mean of the
    predicted probabilities, plus the chosen units' differences from them, weighted. That is unbiased too.

    An interval trusts that what was seen on `samples` units is all there is: a way to fail that no cheap response
    knows of, and that strikes fewer than one of the dear units, stays unseen. `plain` allows for it.

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        cheap: a response that costs little, or a dict of them by any name; its value of the same name is used, or
            all its values where it has none of that name. See `linearised`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        samples: units of the dear response, at least 20.
        cheap_samples: further units of the cheap responses, at least `samples`; a hundred times as many are well spent.
        seed: of the random numbers; units are those of `monte_carlo`.
        requirements: `Requirement`, or a dict of them by name of the response; their targets play no part.
        correlation: {(field or element, field or element): correlation of their z}.
        confidence: of every interval.
        chosen_share: of the dear units chosen near the limits, where there are requirements; 0 for none.

    Returns:
        `MultiFidelity`. Where the cheap responses say little, it is what `monte_carlo` gives.

    Raises:
        ValueError: bad arguments.
    """
    if samples < 20:
        raise ValueError(f"samples = {samples!r}: must be at least 20")
    if not samples <= cheap_samples < 2**32 - samples:
        raise ValueError(f"cheap_samples = {cheap_samples!r}: must be at least samples = {samples}, and below 2**32")
    if not 0 <= chosen_share <= 0.9:
        raise ValueError(f"chosen_share = {chosen_share!r}: must lie between 0 and 0.9")
    deviate_of(confidence)
    population = Population.of(tolerances, correlation)
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    for name, item in required.items():
        if not item.of_units:
            raise ValueError(f"requirements[{name!r}] = {item!r}: says nothing of one unit")
    levels = dict(cheap) if isinstance(cheap, Mapping) else {"cheap": cheap}
    if not levels:
        raise ValueError("cheap: needs at least one response")
    units = Units(response, levels, population, names, seed)
    near = int(chosen_share * samples) if required else 0
    near = near if near >= _FEWEST_CHOSEN else 0
    study = _Study(units, required, samples, near, cheap_samples, seed, confidence)
    result = by_name(MultiFidelity, study.results())
    first = result.failed[names[0]] if isinstance(result.failed, dict) else result.failed
    counts = dict(samples=samples, cheap_samples=cheap_samples, failed=first, seconds=units.taken)
    result = dataclasses.replace(result, **counts)
    return result if required else dataclasses.replace(result, yield_=None, ppm=None)


@dataclasses.dataclass(frozen=True)
class _Study:
    units: Units
    requirements: dict[str, Limits]
    samples: int
    near: int
    cheap_samples: int
    seed: int
    confidence: float

    def results(self) -> dict[str, dict[str, Any]]:
        """Every field of the result, by name of the response."""
        even = self.samples - self.near
        block, many = min(BLOCK, -(-even // 2)), min(BLOCK, -(-self.cheap_samples // 2))
        dear = self.units.dear_values(np.arange(even), block)
        own = self.units.cheap_values(np.arange(even), block)
        fresh = self.units.cheap_values(self.samples + np.arange(self.cheap_samples), many)
        bases = {name: Basis.of(own[name], fresh[name]) for name in self.units.names}
        yields: dict[str, Targeted] = {}
        if self.near:
            yields = self._chosen(dear, own, fresh, bases, block)
        if self.near and not yields:  # nobody knows better: the rest of the units as they come
            rest = np.arange(even, self.samples)
            dear = _longer(dear, self.units.dear_values(rest, block))
            own = _longer(own, self.units.cheap_values(rest, block))
            bases = {name: Basis.of(own[name], fresh[name]) for name in self.units.names}
        return {n: self._figures(n, dear[n], own[n], fresh[n], bases[n], yields.get(n)) for n in self.units.names}

    def _chosen(
        self,
        dear: dict[str, np.ndarray],
        own: dict[str, np.ndarray],
        fresh: dict[str, np.ndarray],
        bases: dict[str, Basis | None],
        block: int,
    ) -> dict[str, Targeted]:
        """Yields from units chosen near the limits, of those responses for which that is worth it."""
        passes = {}
        for name, limits in self.requirements.items():
            basis, known = bases[name], int((~np.isnan(dear[name])).sum())
            if basis is not None and known >= self.samples / 4:
                passes[name] = Prediction.fitted(basis, own[name], dear[name]).passes(fresh[name], limits)
        while passes:
            probabilities = inclusion(list(passes.values()), self.near)
            gains = {name: self._expected_gain(p, probabilities) for name, p in passes.items()}
            least = min(gains, key=lambda name: gains[name])
            if gains[least] >= WORTH_CHOOSING:
                break
            del passes[least]  # the units go where they are worth more
        if not passes:
            return {}
        drawn = chosen(probabilities, self.near, np.random.default_rng(self.seed % 2**64))
        values = self.units.dear_values(self.samples + drawn, block)
        kept = {name: self.requirements[name].margin(values[name]) <= 0 for name in passes}
        return {name: targeted(p, probabilities, drawn, kept[name]) for name, p in passes.items()}

    def _expected_gain(self, passes: np.ndarray, probabilities: np.ndarray) -> float:
        share = float(passes.mean())
        units = share * (1 - share)
        return units / self.samples / (expected_doubt(passes, probabilities) + units / self.cheap_samples)

    def _figures(
        self,
        name: str,
        dear: np.ndarray,
        own: np.ndarray,
        fresh: np.ndarray,
        basis: Basis | None,
        share: Targeted | None,
    ) -> dict[str, Any]:
        good, n = ~np.isnan(dear), len(dear)
        whole = CentralMoments.of(dear[good])
        plain = {"mean": whole.mean_estimate(self.confidence), "sd": whole.sd_estimate(self.confidence)}
        if name in self.requirements:
            kept = int((self.requirements[name].margin(dear) <= 0).sum())
            plain["yield"] = wilson(kept, n, self.confidence)
        found, gain = dict(plain), {figure: n / self.samples for figure in plain}
        mean = None
        if basis is not None and whole.n > basis.columns(own[:1]).shape[1] + 2 and whole.s2 > 0:
            mean, square = self._regressions(dear, own, fresh, basis)
            if mean.gain >= WORTH:
                found["mean"] = mean.estimate(self.confidence, whole.mean + mean.value)
                gain["mean"] *= mean.gain
            if square.gain >= WORTH:
                found["sd"] = self._sd(whole, mean, square)
                gain["sd"] *= square.gain
        if share is not None:
            found["yield"] = share.estimate(self.confidence)
            gain["yield"] = (
                _binomial(found["yield"].value, self.cheap_samples) / self.samples / found["yield"].error ** 2
            )
        used = [figure for figure in found if found[figure] is not plain[figure]]
        reasons = ["TOO_FEW_UNITS" if basis is None else "POOR_CORRELATION"]
        if used:
            reasons = ["PARTLY_PLAIN"] if len(used) < len(found) else []
        for figure in used:
            allowed = self._allowed(figure, name, dear, whole)
            if not allowed.lower <= found[figure].value <= allowed.upper:
                found[figure] = _both(found[figure], plain[figure])
                reasons = [*(r for r in reasons if r != "ESTIMATES_DISAGREE"), "ESTIMATES_DISAGREE"]
        return dict(
            samples=self.samples,
            cheap_samples=self.cheap_samples,
            failed=n - whole.n,
            mean=found["mean"],
            sd=found["sd"],
            yield_=found.get("yield"),
            ppm=rejects(found.get("yield")),
            plain=plain,
            gain=gain,
            correlation=mean.correlation if mean is not None else math.nan,
            correlations={k: _correlation(dear, own[:, j]) for k, j in self.units.first_of(name).items()},
            cheap_per_dear=self._best_ratio(mean if "mean" in used else None, share),
            seconds=dict(self.units.taken),
            status=", ".join(reasons) or "OK",
        )

    def _regressions(
        self, dear: np.ndarray, own: np.ndarray, fresh: np.ndarray, basis: Basis
    ) -> tuple[Regressed, Regressed]:
        """Means of the deviation from the plain mean, and of its square from the plain mean square."""
        good = ~np.isnan(dear)
        off = np.where(good, dear - dear[good].mean(), 0.0) / good.mean()
        square = np.where(good, (dear - dear[good].mean()) ** 2 - dear[good].var(), 0.0) / good.mean()
        columns = basis.columns(own), basis.columns(fresh)
        return regressed(off, *columns), regressed(square, *columns, squared=off)

    def _sd(self, whole: CentralMoments, mean: Regressed, square: Regressed) -> Estimate:
        """From the mean square about the plain mean: less the square of how far that is off, on the average."""
        level = whole.s2 / whole.n - mean.value**2 + mean.variance
        # What is left of the squares is rare and large where the law is skewed; few units show half of that.
        found = dataclasses.replace(square, skewness=_UNSEEN_SKEWNESS * square.skewness).estimate(
            self.confidence, level + square.value
        )
        sd = math.sqrt(max(0.0, found.value))
        error = found.error / (2 * sd) if sd > 0 else math.nan
        return Estimate(sd, error, math.sqrt(max(0.0, found.lower)), math.sqrt(max(0.0, found.upper)))

    def _allowed(self, figure: str, name: str, dear: np.ndarray, whole: CentralMoments) -> Estimate:
        """The plain interval that a figure must not leave."""
        if figure == "yield":
            return wilson(int((self.requirements[name].margin(dear) <= 0).sum()), len(dear), _APART)
        return whole.mean_estimate(_APART) if figure == "mean" else whole.sd_estimate(_APART)

    def _best_ratio(self, mean: Regressed | None, share: Targeted | None) -> float:
        """Cheap units per dear one: the variance is r/n + h/N, the time n dear + N cheap."""
        taken = self.units.taken
        if share is not None:
            dear, cheap = share.doubt * self.near, share.units * self.cheap_samples
        elif mean is not None:
            dear, cheap = mean.residual, mean.explained
        else:
            return math.nan
        return math.sqrt(cheap / dear * taken["dear"] / taken["cheap"]) if dear > 0 else math.inf


def _longer(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([values, second[name]]) for name, values in first.items()}


def _binomial(share: float, units: int) -> float:
    """Variance of the indicator of a share; at 0 and 1 that of half a unit."""
    inside = min(max(share, 0.5 / units), 1 - 0.5 / units)
    return inside * (1 - inside)


def _correlation(dear: np.ndarray, cheap: np.ndarray) -> float:
    """Of the units that have both values; 0 where one does not vary."""
    both = ~np.isnan(dear) & ~np.isnan(cheap)
    x, y = dear[both] - dear[both].mean(), cheap[both] - cheap[both].mean()
    size = math.sqrt(float(x @ x) * float(y @ y))
    return float(x @ y) / size if size > 0 else 0.0


def _both(first: Estimate, second: Estimate) -> Estimate:
    """The first figure with an interval that holds both."""
    lower, upper = min(first.lower, second.lower), max(first.upper, second.upper)
    return Estimate(first.value, max(first.error, second.error), lower, upper)
