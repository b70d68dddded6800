"""Tolerances: distributions of part errors, the distribution of a response, and the cheapest tolerances.

    Design + Tolerances --sample--> Errors --response--> Statistics --gradient--> new Tolerances

This package is independent of gears: a response is any pure function of the errors of one unit.
"""

import dataclasses

from rvjax.population import Estimate, MeasuredColumn, MeasuredParts, Tolerance, for_design, it_width, measured, sample
from rvjax.response import Outcome
from rvjax.tolerances.allocation.allocate import CostCurve, allocate, cost_curve
from rvjax.tolerances.allocation.certificate import least_yield as least_yield, units_of as units_of
from rvjax.tolerances.allocation.cost import (
    COSTS as COSTS,
    Cost as Cost,
    Exponential,
    QuadraticLoss,
    ReciprocalPower,
    Table,
    expected_losses as expected_losses,
)
from rvjax.tolerances.allocation.problem import FEWEST as FEWEST, KEPT as KEPT, QUICK as QUICK
from rvjax.tolerances.allocation.result import Allocation
from rvjax.tolerances.allocation.variable import Middle, Variable, check_middles as check_middles
from rvjax.tolerances.allocation.whole_sample import Nominal
from rvjax.tolerances.batch import monte_carlo
from rvjax.tolerances.batch.checkpoint import Memo as Memo
from rvjax.tolerances.batch.run import Run as Run
from rvjax.tolerances.batch.shares import Folder as Folder, Processes as Processes, take as take
from rvjax.tolerances.batch.statistics import Statistics
from rvjax.tolerances.batch.unit_file import ENDINGS as ENDINGS, UnitFile
from rvjax.tolerances.failure import FailureProbability, failure_probability
from rvjax.tolerances.influence import (
    COSTLY_UNITS as COSTLY_UNITS,
    Influence as Influence,
    influences as influences,
)
from rvjax.tolerances.limits import KINDS as KINDS, Limits as Limits, Verdict
from rvjax.tolerances.minimise import Minimum, minimise
from rvjax.tolerances.moments import Moments, rss
from rvjax.tolerances.requirements import CpkAtLeast, MeanWithin, Requirement, SdAtMost, WorstCaseWithin
from rvjax.tolerances.saving import RESULTS as RESULTS, Origin, load, origin, save
from rvjax.tolerances.sobol_indices import SobolIndices, sobol_indices
from rvjax.tolerances.worst_case import WorstCase, slopes_change_sign as slopes_change_sign, worst_case

RESULTS += [item for item in vars().values() if isinstance(item, type) and dataclasses.is_dataclass(item)]

__all__ = [
    "Allocation",
    "CostCurve",
    "CpkAtLeast",
    "Estimate",
    "Exponential",
    "FailureProbability",
    "MeanWithin",
    "MeasuredColumn",
    "MeasuredParts",
    "Middle",
    "Minimum",
    "Moments",
    "Nominal",
    "Origin",
    "Outcome",
    "QuadraticLoss",
    "ReciprocalPower",
    "Requirement",
    "SdAtMost",
    "SobolIndices",
    "Statistics",
    "Table",
    "Tolerance",
    "UnitFile",
    "Variable",
    "Verdict",
    "WorstCase",
    "WorstCaseWithin",
    "allocate",
    "cost_curve",
    "failure_probability",
    "for_design",
    "it_width",
    "load",
    "measured",
    "minimise",
    "monte_carlo",
    "origin",
    "rss",
    "sample",
    "save",
    "sobol_indices",
    "worst_case",
]
