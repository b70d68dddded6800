"""`rvjax budget`: the contribution of every error to the variance of a curve, by error, part, stage and order."""

from rvjax.commands.budget.compute import Budget, error_budget
from rvjax.commands.budget.regression import budget_if_any
from rvjax.commands.budget.report import report_on, section_on

__all__ = ["Budget", "budget_if_any", "error_budget", "report_on", "section_on"]
