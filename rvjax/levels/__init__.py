"""Speed against accuracy, measured: every level of every model against its exact one, side by side in one run."""

from rvjax.levels.advice import advice, markdown, report
from rvjax.levels.measure import measure, measure_model
from rvjax.levels.subjects import Subject, Way, subjects

__all__ = ["Subject", "Way", "advice", "markdown", "measure", "measure_model", "report", "subjects"]
