"""`rvjax report`: the result of a study as one HTML page with sliders."""

from rvjax.commands.report.compute import Shown as Shown
from rvjax.commands.report.live import cost_data as cost_data, script_of as script_of
from rvjax.commands.report.report import page_of as page_of
