"""`rvjax allocate`: the cheapest tolerances that meet the requirements of a study."""

from rvjax.commands.allocate.answer import (
    Answer as Answer,
    Side as Side,
)
from rvjax.commands.allocate.figures import figures as figures
from rvjax.commands.allocate.forecast import (
    expected as expected,
    phases_of as phases_of,
    seconds_of_units as seconds_of_units,
    shown_values as shown_values,
)
from rvjax.commands.allocate.influence import influence_tables as influence_tables
from rvjax.commands.allocate.kept import FILE as FILE, restored_from as restored_from
from rvjax.commands.allocate.report import (
    headline as headline,
    limits_of_the_answer as limits_of_the_answer,
    report_on as report_on,
    requirement_table as requirement_table,
    tolerance_tables as tolerance_tables,
)
from rvjax.commands.allocate.shortfall import shortfall_text as shortfall_text, shortfalls as shortfalls
from rvjax.commands.allocate.whole import (
    unlimited_tables as unlimited_tables,
    unlimited_texts as unlimited_texts,
)
