"""`Tolerance`: limits of one manufacturing error; `Distribution`: the base class of what parts follow between them.

Every variate is a map e = q(Phi(z)) of standard normal numbers z, which belong to the sample while
the tolerance only shapes and scales them: the same z serve every tolerance (common random numbers).

A new distribution is one class: `@record class Mine(Distribution)` with `name`, its own parameters as fields, `deviate`
and `moments`. Tolerances, studies, saved files and checkpoints take it from `DISTRIBUTIONS`.
"""

import dataclasses
import hashlib
import math
import operator
import warnings
from collections.abc import Mapping
from typing import Any, ClassVar, Self, cast

import jax
import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.words import meant
from rvjax.population.grades import it_width
from rvjax.records import IN_ERROR_UNIT, Array, Record, Scalar, concrete, field, record, text
from rvjax.units import parse

Moments = tuple[Any, Any, Any, Any]
"""Mean, variance, third and fourth central moment of an error: floats, or arrays of the shape of its field."""

DISTRIBUTIONS: dict[str, type["Distribution"]] = {}
"""Every distribution by its name."""


class Distribution(Record):
    """Distribution of parts between limits; its fields are its specific parameters.

    A distribution may hold more in class variables: `shifts` (it honours `Tolerance.shift`), `capable` (and
    `Tolerance.cp`), `of_vectors` (a field of pairs [radial, tangential] gets vectors, not independent numbers) and
    `couples` (the errors along the last axis, as the two components of a vector, depend on each other: `correlation`).
    """

    name: ClassVar[str] = ""
    shifts: ClassVar[bool] = False
    capable: ClassVar[bool] = True
    of_vectors: ClassVar[bool] = False
    couples: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        DISTRIBUTIONS[cls.name] = cls

    def deviate(self, tolerance: "Tolerance", z: jax.Array) -> Scalar:
        """Errors q(Phi(z)).

        Args:
            tolerance: whose distribution this is.
            z: standard normal (*shape, *batch) or, outside vectors, any shape.
        """
        raise NotImplementedError

    def moments(self, tolerance: "Tolerance") -> Moments:
        """Moments of a concrete tolerance, on the host."""
        raise NotImplementedError

    def is_normal(self, tolerance: "Tolerance") -> bool:
        """Return true where the errors are linear in z."""
        return False

    def scaled(self, tolerance: "Tolerance", half_width: Scalar) -> dict[str, Scalar]:
        """Changed fields of a tolerance with another half-width; here its limits, about their mid-point.

        Args:
            tolerance: whose distribution this is.
            half_width: the new one, unit of the error.
        """
        return dict(lower=tolerance.middle - half_width, upper=tolerance.middle + half_width)

    def correlation(self, tolerance: "Tolerance") -> np.ndarray:
        """Correlation of the errors along the last axis, where the distribution couples them."""
        raise NotImplementedError

    def check(self, tolerance: "Tolerance") -> None:
        """Raise a ValueError for limits or parameters that do not fit; numbers may be tracers."""

    def check_field(self, name: str, tolerance: "Tolerance") -> None:
        """Raise a ValueError for a field that this distribution does not fit, once its shape is known.

        Args:
            name: of the field.
            tolerance: whose distribution this is.
        """

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Names of the parameters that only this distribution has."""
        return tuple(f.name for f in dataclasses.fields(cls))

    @classmethod
    def parsed(cls, key: str, value: object, unit: str) -> object:
        """Parse a parameter of a study file; a ValueError if it is not in its unit.

        Args:
            key: its name.
            value: as read.
            unit: of the error.
        """
        about = next(f.metadata for f in dataclasses.fields(cls) if f.name == key)
        wanted = unit if about["unit"] == IN_ERROR_UNIT else about["unit"]
        try:
            if isinstance(value, list):
                numbers = [parse(item, wanted) for item in value]
                return tuple(numbers) if about["kind"] == "text" else np.array(numbers)
            return parse(value, wanted)
        except ValueError as error:
            raise ValueError(f"{key} = {error}") from None

    def described(self) -> dict[str, object]:
        """Parameters as plain values, exact to the last bit."""
        values = {name: getattr(self, name) for name in self.parameters()}
        return {n: v if isinstance(v, (tuple, str, type(None))) else np.asarray(v).tolist() for n, v in values.items()}


def distribution_of(distribution: object, parameters: Mapping[str, object]) -> Distribution:
    """Make a distribution from its name, class or an instance; a ValueError names a parameter of another one."""
    if isinstance(distribution, str) and distribution in DISTRIBUTIONS:
        distribution = DISTRIBUTIONS[distribution]
    given = {name: value for name, value in parameters.items() if value is not None}
    if isinstance(distribution, Distribution):
        return distribution.replace(**given) if given else distribution
    if not (isinstance(distribution, type) and issubclass(distribution, Distribution)):
        near = meant(distribution, DISTRIBUTIONS)
        raise bad("distribution", distribution, f"unknown{near}, choose from {', '.join(DISTRIBUTIONS)}")
    for f in dataclasses.fields(distribution):
        if f.default is dataclasses.MISSING and f.name not in given:
            raise bad(f.name, None, f"give {f.metadata['meaning']} with distribution={distribution.name!r}")
    for name, value in given.items():
        if name not in distribution.parameters():
            owners = [law for law, cls in DISTRIBUTIONS.items() if name in cls.parameters()]
            if not owners:
                raise TypeError(f"Tolerance got an unexpected argument {name!r}")
            known = next(f.metadata["meaning"] for f in dataclasses.fields(DISTRIBUTIONS[owners[0]]) if f.name == name)
            raise bad(name, value, f"give {known} with distribution={owners[0]!r}, and only there")
    return distribution(**given)


def bad(name: str, value: object, reason: str) -> ValueError:
    """Return the error that names a field of a tolerance and its value."""
    shown = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return ValueError(f"Tolerance.{name} = {shown}: {reason}")


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
    def grade(cls, grade: str, size: Scalar, **options: object) -> Self:
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
    def middle(self) -> Scalar:
        """Mid-point of the limits, unit of the error."""
        return (self.lower + self.upper) / 2

    @property
    def centre(self) -> Scalar:
        """Mid-point of the error: 0 of a vector, else that of the limits."""
        return 0.0 if self.law.of_vectors else self.middle

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


def grows_from_lower(tolerance: Tolerance) -> bool:
    """True if a larger half-width does not move the lower limit."""
    return float(tolerance.scaled(2 * tolerance.half_width).lower) == float(tolerance.lower)
