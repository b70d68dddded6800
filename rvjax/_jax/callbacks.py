"""Python functions that a traced program calls back, as text: the text of a program only says that there is one.

Two functions have one text only where they compute the same in another process too: equal code, constants, defaults,
closures and globals. A function that uses what this cannot see has none.
"""

import builtins
import dis
import functools
import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr

_KNOWN = ("builtins", "math", "cmath", "functools", "itertools", "operator", "numpy", "scipy", "jax", "jaxlib")
"""Packages whose functions the name and version determine."""

_UNSEEN = {"open", "exec", "eval", "compile", "input", "globals", "locals", "vars", "getattr", "__import__", "memmap"}
_UNSEEN |= {"load", "loadtxt", "genfromtxt", "fromfile", "loadmat"}
"""Names of what reads files, or finds things by names that the code does not show."""

_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(...), range)
_FLAGS = ("co_argcount", "co_posonlyargcount", "co_kwonlyargcount", "co_flags", "co_code", "co_exceptiontable")
_NAMES = ("co_names", "co_varnames", "co_freevars", "co_cellvars")


class UnseenFunction(ValueError):
    """A function that uses what no text of it contains."""


def called_back(jaxpr: ClosedJaxpr) -> str:
    """Text of all Python functions whose values a program uses, in its order; empty without any.

    Args:
        jaxpr: of the program.

    Raises:
        UnseenFunction: a function that cannot be compared with that of another process.
    """
    return "".join(_text_of(function) for function in _functions(jaxpr.jaxpr))


def _functions(jaxpr: Jaxpr) -> Iterator[Callable[..., Any]]:
    for equation in jaxpr.eqns:
        if equation.primitive.name in ("pure_callback", "io_callback"):  # what only prints changes no value
            yield equation.params["callback"].callback_func
        for item in equation.params.values():
            for inner in item if isinstance(item, (tuple, list)) else [item]:
                if isinstance(inner, (Jaxpr, ClosedJaxpr)):
                    yield from _functions(inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner)


def _text_of(function: Callable[..., Any]) -> str:
    try:
        return _text(function, {})
    except UnseenFunction as error:
        name = getattr(function, "__qualname__", type(function).__name__).rpartition(".")[2]
        raise UnseenFunction(f"jax.pure_callback of {name} uses {error}") from None


def _text(value: Any, seen: dict[int, tuple[Any, str]]) -> str:
    """Text of a value.

    Args:
        value: any.
        seen: values that have a text, by `id`; kept, so that no other one gets their `id`.

    Raises:
        UnseenFunction: names what has no text.
    """
    kind = type(value)
    if kind in _PLAIN or isinstance(value, (np.generic, np.dtype)):
        return f"{kind.__name__} {value!r};"
    if id(value) not in seen:
        seen[id(value)] = value, "within itself;"
        text = _text_of_parts(value, lambda item: _text(item, seen))
        seen[id(value)] = value, f"{kind.__name__} {hashlib.sha256(text.encode()).hexdigest()};"
    return seen[id(value)][1]


def _text_of_parts(value: Any, again: Callable[[Any], str]) -> str:
    kind = type(value)
    if (kind is np.ndarray or isinstance(value, jax.Array)) and value.dtype != object:
        array = np.ascontiguousarray(value)
        return f"{array.dtype.str} {array.shape} {array.tobytes().hex()}"
    if kind in (tuple, list):
        return "".join(map(again, value))
    if kind is dict:
        return "".join(again(item) for pair in value.items() for item in pair)
    if kind in (set, frozenset):
        return "".join(sorted(map(again, value)))
    if kind is types.CodeType:
        return _code(value, again)
    if kind is functools.partial:
        return again(value.func) + again(value.args) + again(value.keywords)
    if kind is types.MethodType:
        return again(value.__func__) + again(value.__self__)
    if kind is types.BuiltinFunctionType and not isinstance(value.__self__, (types.ModuleType, types.NoneType)):
        return value.__name__ + again(value.__self__)
    name = value.__name__ if kind is types.ModuleType else getattr(value, "__module__", None)
    if _root(name) in _KNOWN and hasattr(value, "__name__"):
        if value.__name__ in _UNSEEN:
            raise UnseenFunction(value.__name__)
        version = getattr(sys.modules.get(_root(name)), "__version__", "")
        return f"{name} {getattr(value, '__qualname__', '')} {version}"
    if kind is types.FunctionType:
        return _function(value, again)
    if _root(kind.__module__) in _KNOWN and hasattr(value, "__wrapped__"):  # jax.jit, functools.cache
        return again(value.__wrapped__)
    what = f"module {value.__name__}" if kind is types.ModuleType else f"an object of type {kind.__name__}"
    raise UnseenFunction(what)


def _root(name: object) -> str:
    return str(name).partition(".")[0]


def _function(function: types.FunctionType, again: Callable[[Any], str]) -> str:
    own: list[Any] = [function.__code__, function.__defaults__, function.__kwdefaults__]
    for cell in function.__closure__ or ():
        try:
            own.append(cell.cell_contents)
        except ValueError:  # not bound yet
            own.append(None)
    for name in sorted(_all_names(function.__code__)):
        if name in function.__globals__:
            own += [name, function.__globals__[name]]
        elif name in _UNSEEN and hasattr(builtins, name):
            raise UnseenFunction(name)
    return "".join(map(again, own))


def _code(code: types.CodeType, again: Callable[[Any], str]) -> str:
    for step in dis.get_instructions(code):
        if step.opname == "IMPORT_NAME" and _root(step.argval) not in _KNOWN:
            raise UnseenFunction(f"module {step.argval}")
    if unseen := sorted(_UNSEEN & set(code.co_names)):
        raise UnseenFunction(unseen[0])
    own = [*(getattr(code, name) for name in (*_FLAGS, *_NAMES)), *code.co_consts]
    return "".join(map(again, own))


def _all_names(code: types.CodeType) -> set[str]:
    """Names that a code and those inside it look up: globals, and attributes that may be called like some."""
    inner = (item for item in code.co_consts if isinstance(item, types.CodeType))
    return set(code.co_names).union(*map(_all_names, inner))
