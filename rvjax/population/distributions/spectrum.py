"""Errors round a circle whose waves are known: the pitch of teeth, of which slow waves are the larger ones."""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population.distribution import bad
from rvjax.population.distributions.classic import Normal
from rvjax.records import Scalar, record, text

if TYPE_CHECKING:
    from rvjax.population.tolerance import Tolerance


@record
class Spectrum(Normal):
    """Normal errors along the last axis of a field, closed to a circle, with harmonics of given relative size.

    e_j = sum_h w_h (u_h cos(2 pi h j / n) + v_h sin(2 pi h j / n)), u and v normal, w_h in the ratios of `spectrum`
    and such that every error has the standard deviation h/(3 cp) of the normal distribution. No direction is preferred.
    """

    name = "spectrum"
    shifts = False
    couples = True
    spectrum: tuple[float, ...] = text("the relative sizes of the waves of 1, 2, .. periods in a turn")

    def deviate(self, tolerance: "Tolerance", z: jax.Array) -> Scalar:
        """m + h C z/(3 cp), with the symmetric matrix of rows of length 1 that leaves those waves of white noise."""
        axis = len(tolerance.shape) - 1
        waves = jnp.asarray(self._filter(tolerance.shape[-1]), z.dtype)
        along = jnp.moveaxis(jnp.tensordot(waves, z, (1, axis), precision="highest"), 0, axis)
        return tolerance.middle + tolerance.half_width * along / (3 * tolerance.cp)

    def correlation(self, tolerance: "Tolerance") -> np.ndarray:
        """C C' of the errors round one circle."""
        waves = self._filter(tolerance.shape[-1])
        return waves @ waves.T

    def check(self, tolerance: "Tolerance") -> None:
        """An own correlation leaves no place for a batch."""
        if tolerance.batch:
            raise bad("batch", tolerance.batch, "must be 0 for spectrum, whose errors are correlated by it")

    def check_field(self, name: str, tolerance: "Tolerance") -> None:
        """A circle resolves fewer waves than half its errors."""
        pair = tolerance.vector or tolerance.shape[-1:] == (2,)
        most = (tolerance.shape[-1] - 1) // 2 if tolerance.shape else 0
        if pair or len(self.spectrum) > most:
            raise ValueError(
                f"{name}: spectrum of {len(self.spectrum)} waves, but a field of shape {tolerance.shape} has at most "
                f"{0 if pair else most} round its last axis"
            )

    def _filter(self, count: int) -> np.ndarray:
        """C (n, n): a circulant matrix whose rows have length 1."""
        size = np.zeros(count)
        orders = 1 + np.arange(len(self.spectrum))
        size[orders] = size[-orders] = self.spectrum
        row = np.fft.ifft(size / np.sqrt(np.mean(size**2))).real
        return row[(np.arange(count)[:, None] - np.arange(count)) % count]

    def _check(self) -> None:
        try:
            sizes = tuple(float(number) for number in self.spectrum)
        except (TypeError, ValueError):
            sizes = ()
        if not (sizes and all(0 <= number < np.inf for number in sizes) and any(sizes)):
            raise bad("spectrum", self.spectrum, "must be sizes of waves, zero or positive and not all zero")
        object.__setattr__(self, "spectrum", sizes)
