"""Corrections of the margins of a search by what a certificate sees."""

import math

import numpy as np

from rvjax.population import deviate_of
from rvjax.tolerances.batch.monte_carlo import Statistics
from rvjax.tolerances.optimum.certificate import Certifier
from rvjax.tolerances.optimum.margins import FAILED, JOINT, Margins
from rvjax.tolerances.optimum.programme import End

MOST = 0.25
"""The largest correction, in parts of a way, or logarithm of a factor."""

NEAR = 0.1
"""A margin nearer to its limit than this part of its way may bind."""

WORTH = 2e-3
"""Margin of a certificate, in half-widths, or part of the cost, for which another one is computed."""

_ROOMY = 3e-3  # the same of a certificate that holds
_CHANCE = 5e-3  # logarithm of a factor that a certificate may see by chance
_SPARE = 0.3  # standard errors of a share beyond what a certificate needs: followed units are a few off
_APART = 0.02  # change of a correction, in parts of a way, whose effect is more than chance
_STEEPNESS = 0.5, 5.0  # of that effect, at least and at most


class Correction:
    """Corrects margins, one certificate after the other.

    Costly units are one sample for all certificates, so their values give the distance of a limit. A common factor on
    all half-widths is less exact. It has no effect on a response whose units without errors lie at the limit, such as
    a lost motion that errors of the pins reduce.
    """

    def __init__(self, certifier: Certifier) -> None:
        self._certifier = certifier
        self._last: dict[int, tuple[float, float]] = {}  # {row: correction, and the margin that a certificate saw}

    def apply(self, margins: Margins, end: End, certificate: Statistics, held: bool) -> bool:
        """Correct the margins at the end of a search; False if the change is negligible.

        Args:
            margins: of the search.
            end: of the search.
            certificate: of this end.
            held: whether it holds.
        """
        if certificate.verdicts is None:
            return False
        missed = {JOINT, FAILED} | {name for name, verdict in certificate.verdicts.items() if not verdict.met}
        exact, ways, changed = self._of_units(margins, certificate), margins.central_ways(end.point.x), False
        for k, seen in (self._by_factors(margins, ways, certificate, held) | exact).items():
            here, way = float(end.point.margins[k]), 1.0 if k in exact else float(ways[k])
            if here < -NEAR * way or k in margins.exact:
                continue
            if not held and margins.names[k] in missed and seen <= here:
                seen = here + WORTH * way
            by = seen - here
            if k in exact:
                by = float(np.clip(by / self._steepness(margins, k, seen), -MOST, MOST))
            margins.offsets[k] += by * margins.ways[k]
            changed = changed or abs(by) > (_ROOMY if held else WORTH) * way or (not held and by > 0)
        return changed

    def _by_factors(self, margins: Margins, ways: np.ndarray, certificate: Statistics, held: bool) -> dict[int, float]:
        """{row: margin in parts of its way} by common factors on all half-widths."""
        limited = list(self._certifier.run.requirements)
        by_name = dict(zip(margins.names, ways * margins.ways))
        factors = self._certifier.factors(certificate, np.array([by_name[name] for name in limited]))
        named = dict(zip(limited, factors)) | ({} if self._certifier.joint_target is None else {JOINT: factors[-1]})
        named |= {} if margins.most_failed is None else {FAILED: factors[len(limited)]}
        found = {}
        for k, name in enumerate(margins.names):
            if name in named:
                factor = math.exp(float(np.clip(math.log(max(named[name], 1e-3)), -MOST, MOST)))
                if held or abs(math.log(factor)) < _CHANCE:
                    factor = math.sqrt(factor)  # half of what a certificate sees may be chance
                found[k] = float(ways[k]) * (1 / factor - 1)
        return found

    def _of_units(self, margins: Margins, certificate: Statistics) -> dict[int, float]:
        """The same of limits on a share of costly units, from their values, if these are enough."""
        if not self._certifier.follows or certificate.values is None:
            return {}
        run = self._certifier.run
        deviate, found = deviate_of(run.confidence) + _SPARE, dict[int, float]()
        for k, row in enumerate(margins.rows):
            item = run.requirements.get(row.name)
            if item is not None and item.of_shares:
                margin = item.certified_margin(certificate.values[row.name], deviate)
                if math.isfinite(margin):
                    found[k] = margin / float(margins.ways[k])
        return found

    def _steepness(self, margins: Margins, k: int, seen: float) -> float:
        """Change of a margin as certificates see it, for a change of its correction by one; 1 where it is unknown."""
        offset = float(margins.offsets[k] / margins.ways[k])
        before, then = self._last.get(k, (offset, seen))
        self._last[k] = offset, seen
        return float(np.clip((then - seen) / (offset - before), *_STEEPNESS)) if abs(offset - before) > _APART else 1.0
