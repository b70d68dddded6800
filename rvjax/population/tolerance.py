"""`Tolerance`: limits of one manufacturing error and the distribution that parts follow between them.

Every variate is a map e = q(Phi(z)) of standard normal numbers z, which belong to the sample while
the tolerance only shapes and scales them: the same z serve every tolerance (common random numbers).

Standard tolerance grades of ISO 286-1: the width of a tolerance zone by grade and nominal size.
"""

import dataclasses
import hashlib
import math
import operator
import warnings
from typing import Any, Self, cast

import jax
import numpy as np

from rvjax._jax.checks import checked
from rvjax.population.distribution import DISTRIBUTIONS, Distribution, Moments, bad, distribution_of
from rvjax.population.distributions import classic, empirical, spectrum, von_mises
from rvjax.records import Array, Record, Scalar, concrete, field, quantity, record, text
from rvjax.units import mm, um

GRADES = tuple(f"IT{number}" for number in ("01", "0", *range(1, 12)))
"""Finest first."""

# ISO 286-1, Table 1, widths in um. The standard rounds its own formula unevenly, so the table counts.
_WIDTHS = {  # sizes up to and including, in mm
    3: (0.3, 0.5, 0.8, 1.2, 2, 3, 4, 6, 10, 14, 25, 40, 60),
    6: (0.4, 0.6, 1, 1.5, 2.5, 4, 5, 8, 12, 18, 30, 48, 75),
    10: (0.4, 0.6, 1, 1.5, 2.5, 4, 6, 9, 15, 22, 36, 58, 90),
    18: (0.5, 0.8, 1.2, 2, 3, 5, 8, 11, 18, 27, 43, 70, 110),
    30: (0.6, 1, 1.5, 2.5, 4, 6, 9, 13, 21, 33, 52, 84, 130),
    50: (0.6, 1, 1.5, 2.5, 4, 7, 11, 16, 25, 39, 62, 100, 160),
    80: (0.8, 1.2, 2, 3, 5, 8, 13, 19, 30, 46, 74, 120, 190),
    120: (1, 1.5, 2.5, 4, 6, 10, 15, 22, 35, 54, 87, 140, 220),
    180: (1.2, 2, 3.5, 5, 8, 12, 18, 25, 40, 63, 100, 160, 250),
    250: (2, 3, 4.5, 7, 10, 14, 20, 29, 46, 72, 115, 185, 290),
    315: (2.5, 4, 6, 8, 12, 16, 23, 32, 52, 81, 130, 210, 320),
    400: (3, 5, 7, 9, 13, 18, 25, 36, 57, 89, 140, 230, 360),
    500: (4, 6, 8, 10, 15, 20, 27, 40, 63, 97, 155, 250, 400),
}


@checked
def it_width(grade: str, size: Scalar) -> float:
    """Width of the tolerance zone, m; the limits of a centred zone are +- half of it.

    ISO 286-1, Table 1.

    Args:
        grade: "IT01", "IT0", "IT1" ... "IT11".
        size: nominal size, m, above 0 and up to 500 mm; a size step includes its upper end.

    Raises:
        ValueError: unknown grade, or a size outside the table.
    """
    if not isinstance(grade, str) or grade not in GRADES:
        raise ValueError(f"grade = {grade!r}: unknown, the table holds {', '.join(GRADES)}")
    in_mm = float(size) / mm
    if not 0 < in_mm <= 500 * (1 + 1e-12):
        raise ValueError(f"size = {quantity(size, 'm')}: the table of grades covers sizes above 0 and up to 0.5 m")
    # 0.03 m / mm is 30.000000000000004 in floating point and still belongs to the step "up to 30 mm".
    step = next(end for end in _WIDTHS if in_mm <= end or math.isclose(in_mm, end, rel_tol=1e-12))
    return _WIDTHS[step][GRADES.index(grade)] * um


__all__ = ["DISTRIBUTIONS", "Distribution", "Tolerance", "classic", "empirical", "spectrum", "von_mises"]

COMMON = ("cp", "shift", "batch")
"""Plain numbers that every distribution may be given."""


@record
class Tolerance(Record):
    """Limits of an error and its distribution between them; the unit is that of the error.

    Mid-point m = (lower + upper)/2, half-width h = (upper - lower)/2, mean m + shift h, and for the
    normal distribution sigma = h/(3 cp), so that the capability of the process is Cp = cp and
    Cpk = cp (1 - |shift|). h = 0 is a constant error m.

    - "normal": N(m + shift h, sigma^2), not cut at the limits.
    - "truncated_normal": the same, cut at the limits and renormalised.
    - "uniform": between the limits; no shift.
    - "triangular": between the limits, mode m + shift h.
    - "beta": lower + 2 h B(p, q) with `beta=(p, q)`; no shift.
    - "lognormal": from lower upwards, lower + 2 h exp(log_sd (z - 3 cp)) with `log_sd`; no shift.
    - "rayleigh": a magnitude with scale s = upper/(3 cp); lower and shift are 0. Where the last axis of
      the field holds [radial, tangential], the vector of this magnitude and random direction, which is
      two independent N(0, s^2).
    - "von_mises": such a vector with a preferred `direction`, rad, and the `concentration` about it.
    - "spectrum": normal errors round a circle (the last axis) with the relative sizes of their waves in `spectrum`.
    - "empirical": measured `values`, unit of the error, with linear interpolation between them.

    `batch` correlates the elements of one field by a shared factor, z_j = sqrt(batch) z_0 +
    sqrt(1 - batch) e_j, as in parts made in one set-up; each component of a vector has a
    separate factor, so that its direction stays random.
    """

    lower: Scalar = field("-", "lower limit, unit of the error")
    upper: Scalar = field("-", "upper limit, unit of the error")
    law: Distribution = field("-", "distribution between the limits, with its parameters", kind="record")
    cp: Scalar = field("-", "process capability", sign="positive")
    shift: Scalar = field("-", "mean or mode off the mid-point, in half-widths")
    batch: float = text("correlation of the elements of one field, 0 to below 1")
    size: Scalar | None = field("m", "nominal size of the part, for grades", sign="positive")
    shape: tuple[int, ...] = text("shape of the error, () is a scalar")
    vector: bool | None = text("last axis is [radial, tangential]; None: if its length is 2")
    clearance: bool = text("a clearance, which cannot be negative")

    def __init__(
        self,
        lower: Scalar,
        upper: Scalar,
        *,
        distribution: str | Distribution | type[Distribution] = "normal",
        cp: Scalar = 1.0,
        shift: Scalar = 0.0,
        batch: float = 0.0,
        size: Scalar | None = None,
        shape: tuple[int, ...] = (),
        vector: bool | None = None,
        clearance: bool = False,
        **parameters: object,
    ) -> None:
        """Limits and a distribution.

        Args:
            lower: lower limit, unit of the error.
            upper: upper limit, unit of the error.
            distribution: name of a distribution, or a `Distribution`.
            cp: process capability (normal, truncated_normal, lognormal, rayleigh, von_mises).
            shift: mean or mode off the mid-point, in half-widths.
            batch: correlation of the elements of one field, 0 to below 1.
            size: nominal size of the part, m, for grades.
            shape: of the error, () is a scalar.
            vector: whether the last axis is [radial, tangential]; None: if its length is 2.
            clearance: whether the error is a clearance; a half-width that makes it negative gives a warning.
            **parameters: that belong to the distribution alone: `beta`, `log_sd`, `concentration`, `direction`,
                `spectrum`, `values`.

        Raises:
            ValueError: limits, distribution or parameters that do not fit each other.
        """
        law = distribution_of(distribution, parameters)
        values = dict(lower=lower, upper=upper, law=law, cp=cp, shift=shift)
        given = dict(batch=batch, size=size, shape=shape, vector=vector, clearance=clearance)
        for name, value in (values | given).items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @classmethod
    @checked
    def symmetric(cls, half_width: Scalar, **options: Any) -> Self:
        """Limits on both sides alike.

        Args:
            half_width: of the limits, unit of the error.
            **options: as in `Tolerance`.
        """
        return cls(-half_width, half_width, **options)

    @classmethod
    def grade(cls, grade: str, size: Scalar, **options: Any) -> Self:
        """Limits +-IT/2 of an ISO 286 grade.

        Args:
            grade: such as "IT6".
            size: nominal, m.
            **options: as in `Tolerance`.
        """
        return cls.symmetric(it_width(grade, size) / 2, size=size, **options)

    def replace(self, **changes: object) -> Self:
        """Copy with some arguments changed, checked like a new tolerance; another distribution needs its parameters."""
        kept = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        law = kept.pop("law")
        return type(self)(**(kept | dict(distribution=law) | changes))

    @property
    def distribution(self) -> str:
        """Name of the distribution."""
        return self.law.name

    @property
    def beta(self) -> tuple[float, float] | None:
        """Shape (p, q) of the beta distribution, None for the others."""
        return getattr(self.law, "beta", None)

    @property
    def middle(self) -> Scalar:
        """Mid-point of the limits, unit of the error."""
        return (self.lower + self.upper) / 2

    @property
    def half_width(self) -> Scalar:
        """Half the distance of the limits, unit of the error."""
        return (self.upper - self.lower) / 2

    @property
    def is_vector(self) -> bool:
        """True for a field of vectors (distributions rayleigh and von_mises), False for one of numbers."""
        last_is_pair = bool(self.shape) and self.shape[-1] == 2
        return self.law.of_vectors and (last_is_pair if self.vector is None else self.vector)

    def with_half_width(self, half_width: Scalar) -> Self:
        """The same distribution scaled about the mid-point of its limits, or about its start; shift and cp stay.

        Warns of a clearance that would be negative.
        """
        made = self.scaled(half_width)
        if self.clearance and concrete(made.lower, made.upper) and made.lower < -1e-12 * made.half_width:
            limits = f"limits from {made.lower:.6g} on, but a clearance cannot be negative"
            warnings.warn(f"Tolerance.half_width = {half_width:.6g}: {limits}", stacklevel=2)
        return made

    def scaled(self, half_width: Scalar) -> Self:
        """As `with_half_width`, without a warning: for what is only looked at."""
        return self.replace(**self.law.scaled(self, half_width))

    def deviate(self, z: jax.Array) -> Array:
        """Return the errors that belong to standard normal numbers z (any shape; of vectors (*shape, *batch))."""
        return cast(Array, self.law.deviate(self, z))  # of the kind of z

    def moments(self) -> Moments:
        """Mean, variance, third and fourth central moment, on the host: floats, or arrays of the field's shape."""
        return self.law.moments(self)

    def described(self) -> str:
        """Text of the tolerance, exact to the last bit."""
        shown = f"{self.distribution} {float(self.lower)!r} .. {float(self.upper)!r}, cp {float(self.cp)!r}"
        own = self.law.described()
        own |= {n: hashlib.sha256(repr(v).encode()).hexdigest() for n, v in own.items() if isinstance(v, list)}
        options = dict(shift=float(self.shift), **own, batch=float(self.batch), shape=self.shape)
        shown += "".join(f", {name} {value!r}" for name, value in options.items() if value)
        return shown + (", vectors" if self.is_vector else "")

    def _check(self) -> None:
        try:
            shape = tuple(map(operator.index, self.shape))
        except TypeError:
            raise bad("shape", self.shape, "must be a tuple of sizes") from None
        if min(shape, default=0) < 0:
            raise bad("shape", self.shape, "must be a tuple of sizes")
        object.__setattr__(self, "shape", shape)
        if not isinstance(self.batch, (int, float)) or not 0 <= self.batch < 1:
            raise bad("batch", self.batch, "must be a number from 0 to below 1")
        if concrete(self.lower, self.upper):
            for name in ("lower", "upper"):
                if np.ndim(getattr(self, name)) or not math.isfinite(getattr(self, name)):
                    raise bad(name, getattr(self, name), "must be one finite number")
            if self.lower > self.upper:
                raise bad("lower", self.lower, f"lies above upper = {self.upper:.6g}")
        if concrete(self.shift):
            if not -1 < self.shift < 1:
                raise bad("shift", self.shift, "must lie between -1 and 1, within the limits")
            if self.shift != 0 and not self.law.shifts:
                raise bad("shift", self.shift, f"must be 0 for {self.distribution}")
        if concrete(self.cp) and not math.isfinite(self.cp):
            raise bad("cp", self.cp, "must be finite")
        if self.size is not None and concrete(self.size):
            it_width("IT6", self.size)
        self.law.check(self)
