"""Arguments of public functions: checked before JAX sees them, so that errors name the argument."""

import contextlib
import functools
import inspect
import types
import typing
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import unknown
from rvjax.records import Array, Scalar

P = ParamSpec("P")
R = TypeVar("R")


def checked(function: Callable[P, R], of_design: Callable[[object, str], None] | None = None) -> Callable[P, R]:
    """Check the arguments that a function declares as numbers, arrays, counts, switches or functions; tracers pass.

    Without `of_design` also those that it declares as other classes; with it the function names the kinds of design.

    Args:
        function: public function.
        of_design: gets its argument `design` and its name.

    Raises:
        TypeError: an argument by its place that has to be named, or a name that the function does not have.
        ValueError: where a call gives something else, such as text, a complex number, or an array for a `Scalar`; it
            names the argument.
    """
    given_by_name = inspect.signature(function).parameters
    parameters = {name: p for name, p in given_by_name.items() if p.kind is not p.VAR_KEYWORD}
    kinds = {name: kind for name, p in parameters.items() if (kind := _kind(p.annotation)) is not None}
    where = f"{function.__module__.split('.')[1]}.{function.__name__}"
    known = {} if of_design else {name: p for name, p in parameters.items() if name not in kinds}
    classes = {name: found for name, p in known.items() if (found := _classes(p.annotation)) is not None}
    by_place = [name for name, p in parameters.items() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    takes_all = len(parameters) < len(given_by_name)
    counts = {name: p.annotation == int | None for name, p in parameters.items() if p.annotation in (int, int | None)}

    @functools.wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        if len(arguments) > len(by_place):  # before the checks, which would take it for the argument at that place
            raise TypeError(f"{where}: {_misplaced(arguments[len(by_place)], parameters, by_place, named)}")
        given: dict[str, Any] = dict(zip(parameters, arguments)) | named
        if of_design is not None and "design" in parameters:
            of_design(given.get("design"), where)
        for name, kind in kinds.items():
            value = given.get(name, 0.0)  # one that is absent passes
            if type(value) is not float and not isinstance(value, jax.core.Tracer):
                _check(name, value, kind)
        for name, optional in counts.items():
            count = given.get(name, 0)
            if not (_is_whole(count) and count >= 0) and not (optional and count is None):
                raise ValueError(f"{name} = {_short(count)}: must be a whole number of at least 0")
        for name, wanted in classes.items():
            if name in given and (not isinstance(given[name], wanted) or _is_number(given[name])):
                raise ValueError(f"{name} = {_short(given[name])}: must be {_named(wanted)}")
        if not takes_all and not named.keys() <= parameters.keys():
            wrong = next(name for name in named if name not in parameters)
            free = [name for name in parameters if name not in by_place[: len(arguments)]]
            raise TypeError(str(unknown(f"{where}: has no argument {wrong!r}", wrong, free, "; it has")))
        return function(*arguments, **named)

    return call


def _misplaced(
    value: object, parameters: Mapping[str, inspect.Parameter], by_place: Sequence[str], named: Mapping[str, object]
) -> str:
    """Message that names an argument given by its place: those of its type, first those that are missing."""
    left = {name: p for name, p in parameters.items() if name not in by_place and name not in named}
    fitting = [name for name, p in left.items() if _fits(value, p.annotation)]
    fitting = fitting or [name for name, p in left.items() if p.annotation in (object, Any)]
    missing = [name for name in fitting if left[name].default is inspect.Parameter.empty]
    names = missing or fitting
    if not names:
        only = ", ".join(name for name in parameters if name not in by_place)
        more = f"; keyword-only: {only}" if only else ""
        return f"{_short(value)} is one too many, by their places it takes {', '.join(by_place)}{more}"
    written = " or ".join(f"{name}=..." for name in names)
    return f"{' and '.join(names)} {'are' if names[1:] else 'is'} keyword-only; write {written} for {_short(value)}"


def _fits(value: object, annotation: object) -> bool:
    """True if a value has the type that an argument declares; False where it declares none."""
    members, optional = _members(annotation)
    if value is None or members == {int}:
        return optional if value is None else _is_whole(value)
    if (kind := _kind(annotation)) is not None:
        try:
            _check("", value, kind)
        except ValueError:
            return False
        return True
    classes = (str,) if members == {str} else _classes(annotation)
    if classes is None or not isinstance(value, classes):
        return False
    inside = [typing.get_args(member) for member in members if typing.get_origin(member) is Mapping]
    if not inside or not isinstance(value, Mapping):
        return True
    plain = [typing.get_origin(kind) or kind for kind in inside[0]]
    return all(isinstance(one, kind) for item in value.items() for one, kind in zip(item, plain) if kind is not Any)


def _is_whole(value: object) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    """An array of one number has `__iter__`, too."""
    return isinstance(value, (jax.Array, np.ndarray)) and value.ndim == 0


class _Kind(NamedTuple):
    """Kind of a number, or of an array of numbers."""

    single: bool = False
    optional: bool = False
    sequence: bool = False  # never one number


_ANY = {int, float, object, np.ndarray, Array, Any, inspect.Parameter.empty}  # checked elsewhere, or not at all
_UNNAMED = (np.bool_, np.ndarray, type(None))
_WORDS = {
    bool: "True or False",
    Callable: "a function",
    Mapping: "a dictionary",
    Iterable: "a sequence",
    Sequence: "a sequence",
}


def _members(annotation: object) -> tuple[set[object], bool]:
    """(kinds of a union, None is one of them)."""
    union = isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union
    members = set(typing.get_args(annotation)) if union else {annotation}
    return members - {type(None)}, type(None) in members


def _kind(annotation: object) -> _Kind | None:
    """Of an argument that is a number or an array of numbers; None of others."""
    members, optional = _members(annotation)
    if members in (set(typing.get_args(Scalar)), {float}):
        return _Kind(True, optional)
    sequences = {member for member in members if typing.get_args(member)[:1] == (float,)}
    arrays = members - sequences <= {Array, np.ndarray}
    return _Kind(False, optional, bool(sequences)) if members and arrays else None


def _classes(annotation: object) -> tuple[type, ...] | None:
    """Classes of which an argument must be an instance; None if no check is possible."""
    members, optional = _members(annotation)
    found: list[Any] = []
    for member in members:
        kind: Any = typing.get_origin(member) or member
        if kind is Callable or (getattr(kind, "_is_protocol", False) and "__call__" in vars(kind)):
            kind = Callable
        if not isinstance(kind, type) or (getattr(kind, "_is_protocol", False) and kind is not Callable):
            return None
        found += [Sequence, np.ndarray] if kind in (Sequence, tuple, list) else [Mapping if kind is dict else kind]
    if not found or members == {str} or not _ANY.isdisjoint(members):
        return None  # words have messages of their own
    return (*found, *((np.bool_,) if bool in found else ()), *((type(None),) if optional else ()))


def _named(classes: tuple[type, ...]) -> str:
    words = [_WORDS.get(kind, "text" if kind is str else f"of kind {kind.__name__}") for kind in classes]
    return " or ".join(dict.fromkeys(word for kind, word in zip(classes, words) if kind not in _UNNAMED))


def numbers(name: str, value: object, dtype: type = float) -> np.ndarray:
    """An array of numbers on the host.

    Args:
        name: of the argument.
        value: number, sequence or array.
        dtype: float or complex.

    Raises:
        ValueError: text, objects, or complex numbers for real ones; it names the argument.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind not in ("iufc" if dtype is complex else "iuf"):
            raise TypeError
        return given.astype(dtype)
    except (TypeError, ValueError):
        what = "numbers" if dtype is complex else "real numbers"
        raise ValueError(f"{name} = {_short(value)}: must be {what}") from None


def number(name: str, value: object) -> float:
    """One real number.

    Args:
        name: of the argument.
        value: given.

    Raises:
        ValueError: something else; it names the argument.
    """
    _check(name, value, _Kind(True))
    return float(value)  # type: ignore[arg-type]


def _check(name: str, value: object, kind: _Kind) -> None:
    if value is None and kind.optional:
        return
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value)):
        return  # a list of tracers
    wanted = "one real number" if kind.single else "an array of real numbers"
    try:
        array = value if isinstance(value, (jax.Array, np.ndarray, np.generic)) else np.asarray(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {_short(value)}: must be {wanted}") from None
    if np.dtype(array.dtype).kind in "cOSUMmV" or (kind.sequence and not array.ndim):
        raise ValueError(f"{name} = {_short(value)}: must be {wanted}")
    if kind.single and array.ndim:
        raise ValueError(f"{name}: shape {array.shape}, must be {wanted}; sweep arrays with jax.vmap")


def _short(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:56]} ..."


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
