"""The distributions of part errors: importing them puts each into `DISTRIBUTIONS`."""

from rvjax.population.distributions import classic, empirical, periodic

__all__ = ["classic", "empirical", "periodic"]
