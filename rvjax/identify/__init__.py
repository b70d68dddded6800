"""Identification: errors of the parts from measurements, with the combinations that the data do not determine.

This package is independent of gears: a model is any pure function of values to an observation. A prior is a record or
dict of tolerances.
"""

from rvjax.identify.batch import Batch, Process, solve_many
from rvjax.identify.elements import Direction, Identifiability, mapped_values as mapped_values
from rvjax.identify.goodness_of_fit import MOST_PARETO as MOST_PARETO, Fit as Fit
from rvjax.identify.observation import Noise, Orders, orders, svd as svd
from rvjax.identify.planning import Ranking, identifiability, rank_measurements
from rvjax.identify.posterior import Mode, Posterior
from rvjax.identify.sampler import Draws, sample
from rvjax.identify.search import FAINT as FAINT
from rvjax.identify.unit import predict, solve

__all__ = ["Batch", "Direction", "Draws", "Identifiability", "Mode", "Noise", "Orders", "Posterior", "Process"]
__all__ += ["Ranking", "identifiability", "orders", "predict", "rank_measurements", "sample", "solve", "solve_many"]
