"""Population of units: distributions of part errors, correlation, random numbers and the statistics of samples."""

from rvjax.population.central_moments import CentralMoments as CentralMoments, Pairwise as Pairwise
from rvjax.population.correlation import Correlation, batch_correlation as batch_correlation
from rvjax.population.estimates import (
    Estimate,
    deviate_of as deviate_of,
    of_groups as of_groups,
    rare as rare,
    score_interval as score_interval,
    share_error as share_error,
    skewed as skewed,
    student as student,
    wilson as wilson,
)
from rvjax.population.grades import GRADES as GRADES, it_width
from rvjax.population.measured import MeasuredColumn, MeasuredParts, measured
from rvjax.population.population import (
    Given as Given,
    Population as Population,
    drawn as drawn,
    root_key as root_key,
)
from rvjax.population.sample_statistics import Sampled as Sampled
from rvjax.population.sampling import check_method as check_method, for_design, sample
from rvjax.population.sobol import SCRAMBLES as SCRAMBLES, SobolPoints as SobolPoints
from rvjax.population.tolerance import COMMON as COMMON, DISTRIBUTIONS as DISTRIBUTIONS, Tolerance

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
