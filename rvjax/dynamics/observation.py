"""Bench observations of the dynamic model: natural frequencies."""

from rvjax.designs import RVReducer
from rvjax.dynamics.modes import modes
from rvjax.errors import RVErrors
from rvjax.outputs import Observation
from rvjax.records import Array


def _frequencies(design: RVReducer, errors: RVErrors, given: object) -> tuple[Array, Array]:
    """Frequencies (n,) Hz, ascending, and mass-normalised shapes (n, n), one in each column."""
    found = modes(errors.stiffened(design))
    return found.frequency, found.shape


FREQUENCIES = Observation("frequencies", _frequencies, ("inertia", "stiffness"))
