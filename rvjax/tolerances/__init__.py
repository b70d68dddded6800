"""Tolerances: distributions of part errors, the distribution of a response, and the cheapest tolerances.

    Design + Tolerances --sample--> Errors --response--> Statistics --gradient--> new Tolerances

Nothing here knows a gear: a response is any pure function of the errors of one unit.
"""

from rvjax.tolerances.allocation.allocation import Allocation, allocate
from rvjax.tolerances.allocation.cost import Exponential, ReciprocalPower, Table
from rvjax.tolerances.allocation.cost_curve import CostCurve, cost_curve
from rvjax.tolerances.allocation.middles import Middle
from rvjax.tolerances.distribution.grades import it_width
from rvjax.tolerances.distribution.tolerance import Tolerance
from rvjax.tolerances.population.sampling import for_design, sample
from rvjax.tolerances.propagation.estimates import Estimate
from rvjax.tolerances.propagation.failure import FailureProbability, failure_probability
from rvjax.tolerances.propagation.linearised import Linearised, linearised
from rvjax.tolerances.propagation.measured import MeasuredColumn, MeasuredParts, measured
from rvjax.tolerances.propagation.monte_carlo import Statistics, monte_carlo
from rvjax.tolerances.propagation.multi_fidelity import MultiFidelity, multi_fidelity
from rvjax.tolerances.propagation.requirements import (
    CpkAtLeast,
    MeanWithin,
    Requirement,
    SdAtMost,
    Verdict,
    WorstCaseWithin,
)
from rvjax.tolerances.propagation.responses import Outcome
from rvjax.tolerances.propagation.rss import Moments, rss
from rvjax.tolerances.propagation.sobol_indices import SobolIndices, sobol_indices
from rvjax.tolerances.propagation.unit_file import UnitFile
from rvjax.tolerances.propagation.worst_case import WorstCase, worst_case
from rvjax.tolerances.saving import Origin, load, origin, save

__all__ = [
    "Allocation",
    "CostCurve",
    "CpkAtLeast",
    "Estimate",
    "Exponential",
    "FailureProbability",
    "Linearised",
    "MeanWithin",
    "MeasuredColumn",
    "MeasuredParts",
    "Middle",
    "Moments",
    "MultiFidelity",
    "Origin",
    "Outcome",
    "ReciprocalPower",
    "Requirement",
    "SdAtMost",
    "SobolIndices",
    "Statistics",
    "Table",
    "Tolerance",
    "UnitFile",
    "Verdict",
    "WorstCase",
    "WorstCaseWithin",
    "allocate",
    "cost_curve",
    "failure_probability",
    "for_design",
    "it_width",
    "linearised",
    "load",
    "measured",
    "monte_carlo",
    "multi_fidelity",
    "origin",
    "rss",
    "sample",
    "save",
    "sobol_indices",
    "worst_case",
]
