"""Plots: functions that take numbers and results in SI and return Axes. The models never import this package."""

from rvjax.plotting import drawings, drive, dynamics, loaded
from rvjax.plotting.bars import (
    bars,
    contributions,
    error_budget,
    first_failures,
    identified_elements,
    observation_shares,
    phase_shares,
    residual_orders,
    stacked_bars,
    variance_shares,
)
from rvjax.plotting.curves import (
    corrected_curve,
    efficiency_against_torque,
    identified_curve,
    life_against_torque,
    lines,
    matched_units,
    measured_contents,
    measured_loop,
    unit_curves,
)
from rvjax.plotting.results import cost_against_yield, cost_bars, histogram, pareto, trade_front, tradeoff
from rvjax.plotting.style import new_axes, style, use_style, words

__all__ = [
    "bars",
    "contributions",
    "corrected_curve",
    "cost_against_yield",
    "cost_bars",
    "drawings",
    "drive",
    "dynamics",
    "efficiency_against_torque",
    "error_budget",
    "first_failures",
    "histogram",
    "identified_curve",
    "identified_elements",
    "life_against_torque",
    "lines",
    "loaded",
    "matched_units",
    "measured_contents",
    "measured_loop",
    "new_axes",
    "observation_shares",
    "pareto",
    "phase_shares",
    "residual_orders",
    "stacked_bars",
    "style",
    "trade_front",
    "tradeoff",
    "unit_curves",
    "use_style",
    "variance_shares",
    "words",
]
