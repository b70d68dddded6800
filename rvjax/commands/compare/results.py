"""Two results folders side by side: what each found, and what differs."""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from rvjax.records import PyTree

Result = dict[str, PyTree]
"""Content of a result.json, as `rvjax allocate` writes it."""

Topics = dict[str, dict[str, dict[str, PyTree]]]
"""{topic: {name: {"unit", "a", "b", "same"}}}."""

Rows = Mapping[str, Mapping[str, PyTree]]

HALF, MIDDLE = "half-width", "middle"
_DAMAGE = (OSError, ValueError, RecursionError)


def result(path: str) -> Result:
    """Read the content of a results folder.

    Args:
        path: of the folder, or of the result.json in it.

    Raises:
        ValueError: there is none, or it is no result of `rvjax allocate`.
    """
    file = Path(path) / "result.json" if Path(path).is_dir() else Path(path)
    try:
        found = json.loads(file.read_text("utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path}: there is no results folder with a result.json") from None
    except _DAMAGE as error:
        raise ValueError(f"{path}: cannot be read as a result ({error})") from None
    needed = {"study", "status", "seed", "versions", "cost", "tolerances", "shares", "certificate"}
    if not isinstance(found, dict) or not needed <= set(found):
        raise ValueError(f"{path}: no result of rvjax allocate")
    return found


def compared(first: Result, second: Result) -> Topics:
    """Both results by topic: {topic: {name: {"unit", "a", "b", "same"}}}; SI, None for what one does not have.

    Args:
        first: a result, as `result` reads it.
        second: another one.

    Raises:
        ValueError: something in them is not what `rvjax allocate` writes.
    """
    found: Topics = {}
    try:
        for topic, name, unit, a, b in _rows(first, second):
            found.setdefault(topic, {})[name] = {"unit": unit, "a": a, "b": b, "same": _same(a, b)}
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"not both are results of rvjax allocate ({error!r})") from None
    return found


def _rows(first: Result, second: Result) -> Iterator[tuple[str, str, str, PyTree, PyTree]]:
    """(topic, name, unit, a, b) of everything that is compared; units are SI, "share", "number" or "text"."""

    def both(topic: str, name: str, unit: str, *keys: str) -> tuple[str, str, str, PyTree, PyTree]:
        return topic, name, unit, _at(first, *keys), _at(second, *keys)

    yield both("run", "study", "text", "study")
    yield both("run", "verdict", "text", "status")
    yield both("run", "seed", "text", "seed")
    yield both("run", "samples", "text", "samples")
    yield both("run", "units certified", "text", "certificate", "samples")
    yield both("run", "seed of the certificate", "text", "certificate", "seed")
    for name in _names(first, second, "versions"):
        yield both("run", f"version of {name}", "text", "versions", name)
    yield both("cost", "before", "number", "cost", "before")
    yield both("cost", "after", "number", "cost", "after")
    if _at(first, "cost", "middles") or _at(second, "cost", "middles"):
        yield both("cost", "moved middles, after", "number", "cost", "middles")
    yield both("cost", "with ISO 286 grades", "number", "graded", "cost")
    for name in _names(first, second, "tolerances"):
        unit = (first["tolerances"].get(name) or second["tolerances"][name])["unit"]
        for when in ("before", "after"):
            a, b = (_at(side, "tolerances", name, when) for side in (first, second))
            if form := _form(a) == _form(b) and _form(a):
                yield f"tolerances {when}", f"{name}, {form}", unit, a["drawing"], b["drawing"]
            yield f"tolerances {when}", f"{name}, {HALF}", unit, _half(a), _half(b)
            if any(one and abs(_middle(one)) > 1e-9 * abs(_half(one) or 1.0) for one in (a, b)):
                yield f"tolerances {when}", f"{name}, {MIDDLE}", unit, a and _middle(a), b and _middle(b)
    for name in _names(first, second, "certificate", "verdicts"):
        yield both("requirements", f"{name}, limits", "text", "limits", name)
        yield both("requirements", f"{name}, required", "text", "certificate", "verdicts", name, "wanted")
        yield both("requirements", f"{name}, met", "text", "certificate", "verdicts", name, "met")
        yield both("requirements", f"{name}, yield", "share", "certificate", "yield_", name, "value")
        yield both("requirements", f"{name}, Cpk", "number", "certificate", "cpk", name)
    yield both("requirements", "all at once, yield", "share", "certificate", "joint_yield", "value")
    for name in _names(first, second, "shares", "after"):
        for field in _names(first, second, "shares", "after", name):
            yield both(f"variance of {name}, after", field, "share", "shares", "after", name, field)


def _same(a: PyTree, b: PyTree) -> bool:
    """Equal, but for rounding."""
    numbers = isinstance(a, float) and isinstance(b, float)
    return a == b or (numbers and math.isclose(a, b, rel_tol=1e-9))


def _at(found: PyTree, *keys: str) -> PyTree:
    for key in keys:
        found = found.get(key) if isinstance(found, dict) else None
    return found


def _names(first: Result, second: Result, *keys: str) -> list[str]:
    """Names in either, those of the first in its order."""
    return list(dict.fromkeys([*(_at(first, *keys) or ()), *(_at(second, *keys) or ())]))


def shown(topic: str, rows: Rows) -> Rows:
    """The rows of a topic that a person reads: without half-width and middle of what a drawing states otherwise."""
    if not topic.startswith("tolerances"):
        return rows
    parts = {name: name.rpartition(", ") for name in rows}
    stated = {field for field, _, what in parts.values() if what not in (HALF, MIDDLE)}
    return {n: row for n, row in rows.items() if parts[n][2] not in (HALF, MIDDLE) or parts[n][0] not in stated}


def only(first: Result, second: Result, *keys: str) -> list[str]:
    """Names that the first result has and the second has not.

    Args:
        first: a result.
        second: another one.
        *keys: of the table of names.
    """
    return [name for name in _at(first, *keys) or () if name not in (_at(second, *keys) or ())]


def _form(limits: dict[str, PyTree] | None) -> str:
    """Words of the drawing, "" for limits."""
    return str(limits.get("form", "")) if limits else ""


def _half(limits: dict[str, float] | None) -> float | None:
    return (limits["upper"] - limits["lower"]) / 2 if limits else None


def _middle(limits: dict[str, float]) -> float:
    return (limits["upper"] + limits["lower"]) / 2
