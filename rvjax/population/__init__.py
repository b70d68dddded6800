"""Population of units: distributions of part errors, correlation, random numbers and the statistics of samples."""

from rvjax.population import periodic as periodic
from rvjax.population.estimates import (
    Estimate,
    clopper_pearson as clopper_pearson,
    deviate_of as deviate_of,
    of_groups as of_groups,
    one_decides as one_decides,
    rare as rare,
    score_interval as score_interval,
    share_error as share_error,
    skewed as skewed,
    student as student,
    unknown_share as unknown_share,
    wilson as wilson,
)
from rvjax.population.grades import (
    GRADES as GRADES,
    coarsest_grade as coarsest_grade,
    it_width,
    tolerance_unit as tolerance_unit,
)
from rvjax.population.measured import MeasuredColumn, MeasuredParts, measured
from rvjax.population.population import (
    TURN as TURN,
    Correlation,
    Given as Given,
    Population as Population,
    batch_correlation as batch_correlation,
    drawn as drawn,
    key_of as key_of,
    root_key as root_key,
)
from rvjax.population.sample_statistics import (
    CentralMoments as CentralMoments,
    Pairwise as Pairwise,
    Sampled as Sampled,
)
from rvjax.population.sampling import (
    SCRAMBLES as SCRAMBLES,
    SobolPoints as SobolPoints,
    check_method as check_method,
    first_points as first_points,
    for_design,
    sample,
)
from rvjax.population.tolerance import (
    COMMON as COMMON,
    DISTRIBUTIONS as DISTRIBUTIONS,
    Distribution as Distribution,
    Tolerance,
    grows_from_lower as grows_from_lower,
)

__all__ = ["Correlation", "Estimate", "MeasuredColumn", "MeasuredParts", "Tolerance", "for_design", "it_width"]
__all__ += ["measured", "sample"]
