"""Pictures: functions that take numbers and results in SI and return Axes. The models never import this package."""

from rvjax.plotting.lost_motion import contributions, torque_angle_loop
from rvjax.plotting.statistics import (
    cost_against_limit,
    cost_against_yield,
    response_histogram,
    unit_curves,
    variance_shares,
)
from rvjax.plotting.style import style
from rvjax.plotting.tradeoff import pareto, tradeoff

__all__ = [
    "contributions",
    "cost_against_limit",
    "cost_against_yield",
    "pareto",
    "response_histogram",
    "style",
    "torque_angle_loop",
    "tradeoff",
    "unit_curves",
    "variance_shares",
]
