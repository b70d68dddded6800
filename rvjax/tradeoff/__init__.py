"""Speed against accuracy, measured: every level of every model against its exact one, side by side in one run."""

from rvjax.tradeoff.advice import advice, markdown, report
from rvjax.tradeoff.measure import measure, measure_model
from rvjax.tradeoff.subjects import Subject, Way, subjects

__all__ = ["Subject", "Way", "advice", "markdown", "measure", "measure_model", "report", "subjects"]
