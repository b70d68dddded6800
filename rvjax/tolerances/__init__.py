"""Tolerances: distributions of part errors, the distribution of a response, and the cheapest tolerances.

    Design + Tolerances --sample--> Errors --response--> Statistics --gradient--> new Tolerances

Nothing here knows a gear: a response is any pure function of the errors of one unit.
"""

from rvjax.tolerances.allocation import Allocation, allocate
from rvjax.tolerances.cost import Exponential, ReciprocalPower, Table
from rvjax.tolerances.cost_curve import CostCurve, cost_curve
from rvjax.tolerances.distributions import Tolerance
from rvjax.tolerances.estimates import Estimate
from rvjax.tolerances.failure import FailureProbability, failure_probability
from rvjax.tolerances.grades import it_width
from rvjax.tolerances.monte_carlo import Statistics, monte_carlo
from rvjax.tolerances.requirements import Requirement
from rvjax.tolerances.responses import Outcome
from rvjax.tolerances.rss import Moments, rss
from rvjax.tolerances.sampling import for_design, sample
from rvjax.tolerances.saving import Origin, load, origin, save
from rvjax.tolerances.sobol_indices import SobolIndices, sobol_indices
from rvjax.tolerances.worst_case import WorstCase, worst_case

__all__ = [
    "Allocation",
    "CostCurve",
    "Estimate",
    "Exponential",
    "FailureProbability",
    "Moments",
    "Origin",
    "Outcome",
    "ReciprocalPower",
    "Requirement",
    "SobolIndices",
    "Statistics",
    "Table",
    "Tolerance",
    "WorstCase",
    "allocate",
    "cost_curve",
    "failure_probability",
    "for_design",
    "it_width",
    "load",
    "monte_carlo",
    "origin",
    "rss",
    "sample",
    "save",
    "sobol_indices",
    "worst_case",
]
