"""`rvjax allocate`: the cheapest tolerances that meet the requirements of a study."""

from rvjax.commands.allocate.figures import figures
from rvjax.commands.allocate.kept import restored_from
from rvjax.commands.allocate.report import (
    headline,
    influence_tables,
    limits_of_the_answer,
    report_on,
    requirement_table,
    shortfall_text,
    tolerance_tables,
    tolerance_text,
)

__all__ = [
    "figures",
    "headline",
    "influence_tables",
    "limits_of_the_answer",
    "report_on",
    "requirement_table",
    "restored_from",
    "shortfall_text",
    "tolerance_tables",
    "tolerance_text",
]
