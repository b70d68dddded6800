"""Metadata of the error of a part, and the base of the error records: what other layers need of an error.

A new error is one field, declared with `deviation`; a new kind of reducer is one record that derives from `Errors`.
"""

import contextlib
import dataclasses
import warnings
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import Design, PyTree, Record, Shape, broadcast_fields, field

Sprung = TypeVar("Sprung", bound=Design)

STAGES: dict[str, str] = {}
"""Stage of each part that errors belong to; of an RV reducer as in its design."""


def part(name: str, *, stage: str) -> str:
    """Declare a part of the reducer.

    Args:
        name: of the part.
        stage: that the part belongs to.
    """
    STAGES[name] = stage
    return name


class Bound(NamedTuple):
    """Rule that derives an error without a place from one with a place."""

    placed: str  # name of the error with a place
    size: Callable[[jax.Array], jax.Array]  # its values -> the error without a place


def deviation(
    unit: str,
    meaning: str,
    part: str,
    read_by: tuple[str, ...] = (),
    *,
    of: str = "",
    shape: Shape = (),
    sign: str = "any",
    vector: str = "",
    placed: bool = False,
    bounds: Bound | None = None,
    carried_by: str = "",
    mirrored: tuple[int, ...] = (1,),
    breaks_pitch: bool = False,
    series: bool = False,
) -> Any:
    """Declare an error: a field that defaults to zero, with the metadata that other layers need.

    Args:
        unit: SI unit, "-" for none.
        meaning: one line.
        part: of the reducer, from `part`.
        read_by: models that read the field, such as "four_bar". A share of a stiffness is read by none: see
            `Errors.stiffened`.
        of: what it deviates from, by its path in the design; "" where that is no number of it.
        shape: names or numbers of axes; () is a scalar.
        sign: "positive", "nonnegative" or "any".
        vector: what its last axis is: "xy" in the frame of the housing, "polar" [radial, tangential], or "" (no
            displacement).
        placed: it has a place on its part, and only models with places read it.
        bounds: for an error without a place, the error with a place that it is a bound of.
        carried_by: "disc", "crank" or "carrier" where one part carries it from slot to slot.
        mirrored: factors on the last axis when a disc is turned over; not for "xy".
        breaks_pitch: with it, one turn of the cranks is not like the next.
        series: a Fourier series, which brings its own length.
    """
    about: dict[str, Any] = dict(read_by=read_by, vector=vector, placed=placed, bounds=bounds, carried_by=carried_by)
    about |= dict(mirrored=mirrored, breaks_pitch=breaks_pitch, series=series)
    return field(unit, meaning, shape=shape, default=0.0, sign=sign, of=of, part=part, **about)


def described(errors: PyTree, key: str) -> dict[str, PyTree]:
    """Metadata of the fields that have it, by field: `described(RVErrors, "placed")`.

    Args:
        errors: error record, or its class.
        key: argument of `deviation`.
    """
    return _described(errors if isinstance(errors, type) else type(errors), key)


@lru_cache(maxsize=256)
def _described(cls: type[Record], key: str) -> dict[str, PyTree]:
    return {f.name: f.metadata[key] for f in dataclasses.fields(cls) if f.metadata.get(key)}


def read_by(errors: PyTree, model: str) -> tuple[str, ...]:
    """Names of the errors that a model reads.

    Args:
        errors: error record, or its class.
        model: such as "four_bar".
    """
    return tuple(name for name, models in described(errors, "read_by").items() if model in models)


def placed_by(errors: PyTree, model: str) -> tuple[str, ...]:
    """Names of the errors with a place that a model reads, or has a bound for.

    Args:
        errors: error record, or its class.
        model: such as "lost_motion".
    """
    read = set(read_by(errors, model))
    read |= {bound.placed for name, bound in described(errors, "bounds").items() if name in read}
    return tuple(name for name in described(errors, "placed") if name in read)


_reminded: list[bool] = []


def remind_of_precision() -> None:
    """Warn once, where plain numbers of microns become float32 because float64 is not enabled."""
    if jnp.result_type(float) == jnp.float64 or _reminded:
        return
    _reminded.append(True)
    warnings.warn(
        "rvjax computes in float32: call rvjax.enable_x64() first, or give arrays of float32 on purpose",
        stacklevel=5,  # the caller of the constructor
    )


@contextlib.contextmanager
def unreminded() -> Iterator[None]:
    """Make constants of rvjax inside: they are made when it is imported, before a user may enable float64."""
    _reminded.append(True)
    try:
        yield
    finally:
        _reminded.pop()


class Errors(Record):
    """Base of the error records."""

    of_design: ClassVar[str]  # name of the class of designs whose parts deviate so

    def _check(self) -> None:
        """Plain numbers of microns become float32 wherever they are computed with, unless float64 is enabled."""
        values = [value for value in vars(self).values() if not isinstance(value, Record)]
        on_purpose = any(getattr(value, "dtype", None) == np.float32 for value in values)
        if not on_purpose and any(isinstance(value, (float, np.ndarray)) and np.any(value) for value in values):
            remind_of_precision()

    @classmethod
    def for_design(cls, design: Design, **errors: PyTree) -> Self:
        """Errors with full array shapes; a scalar for an array field is broadcast.

        Args:
            design: gives the counts of the shapes.
            **errors: fields by name; absent ones are zero, those with a place as a plain number.

        Raises:
            ValueError: unknown field, or a shape that does not fit the design.
        """
        own = getattr(design, "error_record", None)
        if not isinstance(own, type) or not (issubclass(cls, own) or issubclass(own, cls)):
            raise ValueError(
                f"{cls.__name__}.for_design: takes a design of kind {cls.of_design}, got {type(design).__name__}"
            )
        full = broadcast_fields(cls, design.counts, errors)
        return cls(**full | {name: 0.0 for name in described(cls, "placed") if name not in errors})

    def stiffened(self, design: Sprung) -> Sprung:
        """The design with the stiffness of this unit, for the models that read it."""
        springs: Any = getattr(design, "stiffness", None)
        if springs is None:
            return design
        paths = {name: path.split(".") for name, path in described(self, "of").items()}
        shares = {path[1]: getattr(self, name) for name, path in paths.items() if path[0] == "stiffness"}
        own = {name: getattr(springs, name) * (1 + share) for name, share in shares.items()}
        return design.replace(stiffness=springs.replace(**own))
