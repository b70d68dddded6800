"""Response: a pure function of the errors of one unit, evaluated for many units on all devices."""

from rvjax.response.devices import Evaluator as Evaluator
from rvjax.response.devices import gathered as gathered
from rvjax.response.devices import place as place
from rvjax.response.gradients import LANES as LANES
from rvjax.response.gradients import elements as elements
from rvjax.response.gradients import elements_and_rates as elements_and_rates
from rvjax.response.gradients import gradients as gradients
from rvjax.response.gradients import nominal_status as nominal_status
from rvjax.response.parts import AT_ONCE as AT_ONCE
from rvjax.response.parts import Part as Part
from rvjax.response.parts import evaluator as evaluator
from rvjax.response.parts import parts as parts
from rvjax.response.parts import status_without_errors as status_without_errors
from rvjax.response.response import (
    BLOCK as BLOCK,
)
from rvjax.response.response import (
    PLAIN as PLAIN,
)
from rvjax.response.response import (
    PROGRAMS as PROGRAMS,
)
from rvjax.response.response import (
    Outcome,
    Response,
)
from rvjax.response.response import (
    Values as Values,
)
from rvjax.response.response import (
    by_name as by_name,
)
from rvjax.response.response import (
    by_response as by_response,
)
from rvjax.response.response import (
    evaluate as evaluate,
)
from rvjax.response.response import (
    per_response as per_response,
)
from rvjax.response.response import (
    respond as respond,
)
from rvjax.response.response import (
    respond_units as respond_units,
)
from rvjax.response.response import (
    response_names as response_names,
)
from rvjax.response.response import (
    unwrapped as unwrapped,
)

__all__ = ["Outcome", "Response"]
