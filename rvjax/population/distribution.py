"""Base class of a distribution: a record that maps standard normal numbers to errors, registered by its name.

A new distribution is one class: `@record class Mine(Distribution)` with `name`, its own parameters as fields, `deviate`
and `moments`. Tolerances, studies, saved files and checkpoints take it from `DISTRIBUTIONS`.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import numpy as np

from rvjax.base.words import meant
from rvjax.records import IN_ERROR_UNIT, Record, Scalar
from rvjax.units import parse

if TYPE_CHECKING:
    from rvjax.population.tolerance import Tolerance

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

    def coupling(self, tolerance: "Tolerance") -> float:
        """Correlation of the two components of one vector."""
        return 0.0

    def correlation(self, tolerance: "Tolerance") -> np.ndarray:
        """Correlation of the errors along the last axis, where the distribution couples them."""
        return np.array([[1.0, self.coupling(tolerance)], [self.coupling(tolerance), 1.0]])

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


def central(m1: float, m2: float, m3: float, m4: float) -> Moments:
    """Raw moments to mean and central moments."""
    return m1, m2 - m1**2, m3 - 3 * m1 * m2 + 2 * m1**3, m4 - 4 * m1 * m3 + 6 * m1**2 * m2 - 3 * m1**4


def stretch(moments: Moments, origin: float, scale: float) -> Moments:
    """Moments of origin + scale x from those of x."""
    mean, variance, third, fourth = moments
    return origin + scale * mean, scale**2 * variance, scale**3 * third, scale**4 * fourth


def raw_rayleigh(scale: float) -> list[float]:
    """Raw moments 1 .. 4 of a magnitude with this scale: s^k 2^(k/2) Gamma(1 + k/2)."""
    return [scale**k * 2 ** (k / 2) * math.gamma(1 + k / 2) for k in (1, 2, 3, 4)]
