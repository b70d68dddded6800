"""Population of units: distributions of part errors, correlation, random numbers and the statistics of samples."""

from rvjax.population.central_moments import CentralMoments as CentralMoments
from rvjax.population.central_moments import Pairwise as Pairwise
from rvjax.population.correlation import Correlation
from rvjax.population.correlation import batch_correlation as batch_correlation
from rvjax.population.estimates import (
    Estimate,
)
from rvjax.population.estimates import (
    deviate_of as deviate_of,
)
from rvjax.population.estimates import (
    of_groups as of_groups,
)
from rvjax.population.estimates import (
    rare as rare,
)
from rvjax.population.estimates import (
    score_interval as score_interval,
)
from rvjax.population.estimates import (
    share_error as share_error,
)
from rvjax.population.estimates import (
    skewed as skewed,
)
from rvjax.population.estimates import (
    student as student,
)
from rvjax.population.estimates import (
    wilson as wilson,
)
from rvjax.population.grades import GRADES as GRADES
from rvjax.population.grades import it_width
from rvjax.population.measured import MeasuredColumn, MeasuredParts, measured
from rvjax.population.population import Population as Population
from rvjax.population.population import drawn as drawn
from rvjax.population.population import root_key as root_key
from rvjax.population.sample_statistics import Sampled as Sampled
from rvjax.population.sampling import check_method as check_method
from rvjax.population.sampling import for_design, sample
from rvjax.population.sobol import SCRAMBLES as SCRAMBLES
from rvjax.population.sobol import SobolPoints as SobolPoints
from rvjax.population.tolerance import COMMON as COMMON
from rvjax.population.tolerance import DISTRIBUTIONS as DISTRIBUTIONS
from rvjax.population.tolerance import Tolerance

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
