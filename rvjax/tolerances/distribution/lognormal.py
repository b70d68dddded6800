"""The lognormal law: an error that cannot fall below its lower limit and has a long upper tail."""

import math
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.records import Scalar, field, record
from rvjax.tolerances.distribution.law import Law, Moments, stretched


@record
class Lognormal(Law):
    """lower + 2 h exp(log_sd (z - 3 cp)), so that P(e > upper) = Phi(-3 cp) as for a centred normal law."""

    name = "lognormal"
    log_sd: Scalar = field("-", "the standard deviation of the logarithm of the error above `lower`", sign="positive")

    def deviate(self, tolerance: Any, z: jax.Array) -> jax.Array:
        """The upper limit lies at z = 3 cp."""
        return tolerance.lower + 2 * tolerance.half_width * jnp.exp(self.log_sd * (z - 3 * tolerance.cp))

    def moments(self, tolerance: Any) -> Moments:
        """E exp(k s z) = exp(k^2 s^2/2)."""
        s, cp = float(self.log_sd), float(tolerance.cp)
        w = math.expm1(s**2)  # central moments from w: differences of raw ones lose all digits of a small s
        mean = math.exp(s**2 / 2)
        third = mean**3 * w**2 * (w + 3)
        q = 1 + w
        fourth = mean**4 * w**2 * (q**4 + 2 * q**3 + 3 * q**2 - 3)
        scale = 2 * float(tolerance.half_width) * math.exp(-3 * cp * s)
        return stretched((mean, mean**2 * w, third, fourth), float(tolerance.lower), scale)

    def scaled(self, tolerance: Any, half_width: Scalar) -> dict[str, Any]:
        """About the lower limit, which is a bound of nature."""
        return dict(upper=tolerance.lower + 2 * half_width)
