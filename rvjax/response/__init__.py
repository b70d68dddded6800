"""Response: a pure function of the errors of one unit, evaluated for many units on all devices."""

from rvjax.response.devices import Evaluator, gathered, place
from rvjax.response.gradients import LANES, elements, elements_and_rates, gradients, nominal_status
from rvjax.response.parts import AT_ONCE, Part, parts, status_without_errors
from rvjax.response.response import (
    BLOCK,
    PLAIN,
    PROGRAMS,
    Outcome,
    Response,
    Values,
    by_name,
    by_response,
    evaluate,
    per_response,
    respond,
    respond_units,
    response_names,
    unwrapped,
)

__all__ = ["Outcome", "Response"]
