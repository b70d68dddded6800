"""Numbers and counts that public functions take: checked before JAX sees them, so that errors name the argument."""

import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np

from rvjax.records import Array, Scalar

P = ParamSpec("P")
R = TypeVar("R")


def checked(function: Callable[P, R], of_design: Callable[[object, str], None] | None = None) -> Callable[P, R]:
    """Check the arguments that a function declares as `int`, `Scalar` or arrays of numbers; tracers pass.

    Args:
        function: public function.
        of_design: gets its argument `design` and its name.

    Raises:
        ValueError: where a call gives text, complex numbers, an array for a `Scalar`, or for an `int` anything but a
            whole number of at least 0; it names the argument.
    """
    parameters = inspect.signature(function).parameters
    kinds = {name: kind for name, p in parameters.items() if (kind := _kind(p.annotation)) is not None}
    where = f"{function.__module__.split('.')[1]}.{function.__name__}"
    place_of_design = list(parameters).index("design") if "design" in parameters else None
    places = tuple((place, name) for place, name in enumerate(parameters) if name in kinds)
    counts = [(place, name) for place, name in enumerate(parameters) if _is_count(parameters[name].annotation)]

    @functools.wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        if of_design is not None and place_of_design is not None:
            given = arguments[place_of_design] if place_of_design < len(arguments) else named.get("design")
            of_design(given, where)
        for place, name in places:
            value: Any = arguments[place] if place < len(arguments) else named.get(name, 0.0)
            if type(value) is not float and not isinstance(value, jax.core.Tracer):
                _check(name, value, *kinds[name])
        for place, name in counts:
            count: Any = arguments[place] if place < len(arguments) else named.get(name, 0)
            if count is not None and not (_is_whole(count) and count >= 0):
                raise ValueError(f"{name} = {_short(count)}: must be a whole number of at least 0")
        return function(*arguments, **named)

    return call


def _is_count(annotation: object) -> bool:
    return annotation is int or annotation == int | None


def _is_whole(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _kind(annotation: object) -> tuple[bool, bool] | None:
    """(the argument is one number, None is allowed); None for an argument that is no number."""
    union = isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union
    members = set(typing.get_args(annotation)) if union else {annotation}
    optional = type(None) in members
    members.discard(type(None))
    if members == set(typing.get_args(Scalar)):
        return True, optional
    return (False, optional) if members and members <= {Array, np.ndarray} else None


def _check(name: str, value: object, single: bool, optional: bool) -> None:
    if value is None and optional:
        return
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value)):
        return  # a list of tracers
    wanted = "one real number" if single else "an array of real numbers"
    try:
        array = value if isinstance(value, (jax.Array, np.ndarray, np.generic)) else np.asarray(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {_short(value)}: must be {wanted}") from None
    if np.dtype(array.dtype).kind in "cOSUMmV":
        raise ValueError(f"{name} = {_short(value)}: must be {wanted}")
    if single and array.ndim:
        raise ValueError(f"{name}: shape {array.shape}, must be {wanted}; sweep arrays with jax.vmap")


def _short(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:56]} ..."
