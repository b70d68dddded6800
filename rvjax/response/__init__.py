"""Response: a pure function of the errors of one unit, evaluated for many units on all devices."""

from rvjax.response.derivatives import (
    elements as elements,
    elements_and_rates as elements_and_rates,
    gradients as gradients,
)
from rvjax.response.parts import (
    Evaluator as Evaluator,
    Part as Part,
    Whole as Whole,
    parts as parts,
    status_without_errors as status_without_errors,
    unit_at_mid_points as unit_at_mid_points,
)
from rvjax.response.response import (
    BLOCK as BLOCK,
    PLAIN as PLAIN,
    PROGRAMS as PROGRAMS,
    UNITS as UNITS,
    DesignResponse as DesignResponse,
    Outcome,
    Response,
    Values as Values,
    by_name as by_name,
    by_response as by_response,
    evaluate as evaluate,
    is_costly as is_costly,
    mesh_of as mesh_of,
    numbers_of as numbers_of,
    on as on,
    per_response as per_response,
    respond as respond,
    respond_units as respond_units,
    response_names as response_names,
    units_devices as units_devices,
    units_on as units_on,
    unwrapped as unwrapped,
)

__all__ = ["Outcome", "Response"]
