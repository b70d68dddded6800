"""Plots: functions that take numbers and results in SI and return Axes. The models never import this package."""

from rvjax.plotting import (
    assembly,
    compensation,
    drawings,
    drive,
    dynamic_error,
    dynamics,
    four_bar,
    identified,
    life,
    loaded,
    mesh_force,
    running,
)
from rvjax.plotting.batches import batch_histograms, error_budget, rejects_against_limit
from rvjax.plotting.lost_motion import contributions, torque_angle_loop
from rvjax.plotting.statistics import (
    cost_against_limit,
    cost_against_yield,
    cost_bars,
    response_histogram,
    trade_front,
    unit_curves,
    variance_shares,
)
from rvjax.plotting.style import new_axes, style, use_style, words
from rvjax.plotting.tradeoff import pareto, tradeoff, verdicts

__all__ = [
    "assembly",
    "batch_histograms",
    "compensation",
    "contributions",
    "cost_against_limit",
    "cost_against_yield",
    "cost_bars",
    "drawings",
    "drive",
    "dynamic_error",
    "dynamics",
    "error_budget",
    "four_bar",
    "identified",
    "life",
    "loaded",
    "mesh_force",
    "new_axes",
    "pareto",
    "rejects_against_limit",
    "response_histogram",
    "running",
    "style",
    "torque_angle_loop",
    "trade_front",
    "tradeoff",
    "unit_curves",
    "use_style",
    "variance_shares",
    "verdicts",
    "words",
]
