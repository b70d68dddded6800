"""Tolerances: distributions of part errors, the distribution of a response, and the cheapest tolerances.

    Design + Tolerances --sample--> Errors --response--> Statistics --gradient--> new Tolerances

Nothing here knows a gear: a response is any pure function of the errors of one unit.
"""

import dataclasses

from rvjax.population import Estimate, MeasuredColumn, MeasuredParts, Tolerance, for_design, it_width, measured, sample
from rvjax.response import Outcome
from rvjax.tolerances.allocation.allocation import FEWEST, KEPT, Allocation, Solved, allocate, allocated, block
from rvjax.tolerances.allocation.cost import COSTS, Cost, Exponential, ReciprocalPower, Table
from rvjax.tolerances.allocation.cost_curve import CostCurve, cost_curve, cost_of_yields, least_yield
from rvjax.tolerances.allocation.design_centring import Middle, check_middles
from rvjax.tolerances.batch.checkpoint import versions
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.monte_carlo import Run, Statistics, monte_carlo
from rvjax.tolerances.batch.unit_file import ENDINGS, UnitFile, joined
from rvjax.tolerances.failure.failure import FailureProbability, failure_probability
from rvjax.tolerances.fidelity.linearised import Linearised, linearised
from rvjax.tolerances.fidelity.multi_fidelity import MultiFidelity, multi_fidelity
from rvjax.tolerances.moments import Moments, influences, rss
from rvjax.tolerances.requirements.kinds import (
    KINDS,
    CpkAtLeast,
    MeanWithin,
    Requirement,
    SdAtMost,
    Verdict,
    WorstCaseWithin,
)
from rvjax.tolerances.requirements.limits import Limits
from rvjax.tolerances.saving import RESULTS, Origin, load, origin, save
from rvjax.tolerances.sobol_indices import SobolIndices, sobol_indices
from rvjax.tolerances.worst_case import WorstCase, worst_case

RESULTS += [item for item in vars().values() if isinstance(item, type) and dataclasses.is_dataclass(item)]

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
