"""Plots: functions that take numbers and results in SI and return Axes. The models never import this package."""

from rvjax.plotting import drawings as drawings, drive as drive
from rvjax.plotting.bars import (
    bars as bars,
    error_budget as error_budget,
    first_failures as first_failures,
    identified_elements as identified_elements,
    observation_shares as observation_shares,
    phase_shares as phase_shares,
    residual_orders as residual_orders,
    stacked_bars as stacked_bars,
    variance_shares as variance_shares,
)
from rvjax.plotting.curves import (
    corrected_curve as corrected_curve,
    efficiency_against_torque as efficiency_against_torque,
    identified_curve as identified_curve,
    life_against_torque as life_against_torque,
    lines as lines,
    matched_units as matched_units,
    measured_contents as measured_contents,
    measured_loop as measured_loop,
    unit_curves as unit_curves,
)
from rvjax.plotting.results import (
    cost_against_yield as cost_against_yield,
    cost_bars as cost_bars,
    histogram as histogram,
    pareto as pareto,
    trade_front as trade_front,
    tradeoff as tradeoff,
)
from rvjax.plotting.style import new_axes as new_axes, style as style, use_style as use_style, words as words
