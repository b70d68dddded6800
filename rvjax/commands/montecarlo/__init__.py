"""`rvjax montecarlo`: statistics of a sample of units, any size."""

from rvjax.commands.montecarlo.report import report_on as report_on
