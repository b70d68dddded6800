"""Speed against accuracy, measured: every level of every model against its exact one, and the cheapest that holds."""

from rvjax.levels.choice import Choice, as_given, choose, seconds, sources_of
from rvjax.levels.measure import measure, measure_model, measured
from rvjax.levels.table import (
    Level as Level,
    Model as Model,
    Table,
    advice,
    blocks as blocks,
    measured_on as measured_on,
    stored,
)

__all__ = ["Table", "Choice", "advice", "as_given", "choose", "measure", "measure_model", "measured"]
__all__ += ["seconds", "sources_of", "stored"]
