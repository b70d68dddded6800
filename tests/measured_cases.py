"""Readings of a bench that are made from a known curve, and what a table leaves of it."""

import numpy as np

from rvjax import catalogue
from rvjax.compensation import correction
from rvjax.measured import Conditions, Run, findings, fitted, judge
from rvjax.units import arcsec, deg

PARTS = catalogue.RV_40E.orders  # 39, 40, 78, 80, and the sun at 105 and 104
TRUTH = {39: 3.8 * np.exp(0.3j), 40: 3.0 * np.exp(1j), 78: 3.4 * np.exp(2j)}
GRID = np.arange(7200) * 2 * np.pi / 7200
NOISE = 0.2


def curve(angle, truth=TRUTH):
    return sum((np.real(value * np.exp(1j * order * angle)) for order, value in truth.items()), 0 * angle)


def run(angle, error, **more):
    """Of degrees and arcsec."""
    return Run("a.csv", Conditions(stated=False), np.asarray(angle) * deg, np.asarray(error) * arcsec, **more)


def equal(count, turns=1):
    return np.arange(count * turns) * 360 / count


def noise(count, seed=0):
    return NOISE * np.random.default_rng(seed).standard_normal(count)


def evaluated(angle, error, parts=PARTS, truth=TRUTH):
    """The fit, orders that are stored, and the rest in arcsec."""
    judged = judge(run(angle, error), parts)
    fit = fitted(judged, 120)
    seen = fit.seen[fit.found.order[fit.seen] > 1]
    made = correction(fit.found.order[seen], fit.found.value[seen], ratio=105.0)
    left = curve(GRID, truth) + made.output(GRID) / arcsec
    return judged, fit, made.order.tolist(), float(np.sqrt(np.mean(left**2)))


def said(judged):
    return {finding.name: finding for finding in findings(judged)}
