"""Population of units: distributions of part errors, correlation, random numbers and the statistics of samples."""

from rvjax.population.central_moments import CentralMoments, Pairwise
from rvjax.population.correlation import Correlation, batch_correlation
from rvjax.population.estimates import (
    Estimate,
    deviate_of,
    of_groups,
    rare,
    score_interval,
    share_error,
    skewed,
    student,
    wilson,
)
from rvjax.population.grades import GRADES, it_width
from rvjax.population.measured import MeasuredColumn, MeasuredParts, measured
from rvjax.population.population import Population, drawn, root_key
from rvjax.population.sample_statistics import Sampled
from rvjax.population.sampling import check_method, for_design, sample
from rvjax.population.sobol import SCRAMBLES, SobolPoints
from rvjax.population.tolerance import COMMON, DISTRIBUTIONS, Tolerance

__all__ = [
    "Correlation",
    "Estimate",
    "MeasuredColumn",
    "MeasuredParts",
    "Tolerance",
    "for_design",
    "it_width",
    "measured",
    "sample",
]
