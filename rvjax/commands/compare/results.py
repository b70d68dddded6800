"""Results of `rvjax allocate`: what differs between two, and tolerances of one certified under another study."""

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.records import PyTree
from rvjax.response import BLOCK
from rvjax.study import Study
from rvjax.tolerances import Statistics, monte_carlo

Result = dict[str, PyTree]
"""Content of a result.json, as `rvjax allocate` writes it."""

Topics = dict[str, dict[str, dict[str, PyTree]]]
"""{topic: {name: {"unit", "a", "b", "same"}}}."""

Rows = Mapping[str, Mapping[str, PyTree]]

HALF, MIDDLE = "half-width", "middle"
_DAMAGE = (OSError, ValueError, RecursionError)


def result(path: str, *, designs: bool = False) -> Result:
    """Read the content of a results folder.

    Args:
        path: of the folder, or of the result.json in it.
        designs: whether a result of `rvjax design` is read, too.

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
    needed = {"study", "status", "seed", "versions", "cost", "tolerances", "certificate"}
    own = ({"shares"}, {"values"}) if designs else ({"shares"},)
    if not (isinstance(found, dict) and any(needed | more <= set(found) for more in own)):
        raise ValueError(f"{path}: no result of rvjax allocate{' or rvjax design' if designs else ''}")
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


def _same(a: object, b: object) -> bool:
    """Equal, but for rounding."""
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isclose(a, b, rel_tol=1e-9))


def _at(found: object, *keys: str) -> PyTree:
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


def _form(limits: dict[str, object] | None) -> str:
    """Words of the drawing, "" for limits."""
    return str(limits.get("form", "")) if limits else ""


def _half(limits: dict[str, float] | None) -> float | None:
    return (limits["upper"] - limits["lower"]) / 2 if limits else None


def _middle(limits: dict[str, float]) -> float:
    return (limits["upper"] + limits["lower"]) / 2


def answered(path: str, *, designs: bool = False) -> tuple[Study, PyTree]:
    """The study of a results folder, and the tolerances that it found, with their distributions.

    Args:
        path: of the folder, or of the result.json in it.
        designs: whether a result of `rvjax design` is read, too.

    Raises:
        ValueError: no results folder of `rvjax allocate`, or its study and its result do not fit each other.
    """
    found = result(path, designs=designs)
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    try:
        written = (folder / "study.toml").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        raise ValueError(f"{folder}: there is no study.toml next to the result, which has the distributions") from None
    loaded = study.parse_study(written, name=str(found["study"]), folder=folder, solve=False)
    try:
        limits = {name: (one["after"]["lower"], one["after"]["upper"]) for name, one in found["tolerances"].items()}
        tolerances = {
            name: getattr(loaded.tolerances, name).replace(lower=lower, upper=upper)
            for name, (lower, upper) in limits.items()
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: no result of the study next to it ({error!r})") from None
    return loaded, loaded.tolerances.replace(**tolerances)


@dataclass(frozen=True)
class Crossed:
    """Result certified under another study.

    Attributes:
        study: with the requirements.
        tolerances: that are certified, a record with a Tolerance or None in each field.
        taken: fields with the tolerance of the result.
        own: fields without a tolerance in the result: they keep the tolerance of the study.
        left: fields without a tolerance in the study: they are excluded from its statistics.
        cost: in the costs of the study.
        statistics: of independent units, with the yield of each requirement and of all at once.
    """

    study: Study
    tolerances: PyTree
    taken: tuple[str, ...]
    own: tuple[str, ...]
    left: tuple[str, ...]
    cost: float
    statistics: Statistics


def crossed(study: Study, tolerances: PyTree, *, samples: int | None = None) -> Crossed:
    """Certify tolerances under the requirements, conditions, design and models of a study.

    Args:
        study: with the requirements.
        tolerances: of the result of another study, a record with a Tolerance or None in each field.
        samples: independent units; by default as many as the study certifies with.

    Raises:
        ValueError: tolerances of another kind of reducer, or none that the study has.
    """
    together = put_into(study, tolerances)
    given = [f.name for f in dataclasses.fields(tolerances) if getattr(tolerances, f.name) is not None]
    taken = tuple(name for name in given if name in study.fields)
    return Crossed(
        study=study,
        tolerances=together,
        taken=taken,
        own=tuple(name for name in study.fields if name not in taken),
        left=tuple(name for name in given if name not in taken),
        cost=cost_of(study, together),
        statistics=monte_carlo(
            study.at_few(study.response(), together),
            together,
            samples=study.certificate_samples if samples is None else samples,
            seed=study.seed + 1,  # the allocation uses that of the study
            chunk=BLOCK,
            requirements=study.requirements,
        ),
    )


def put_into(study: Study, tolerances: PyTree) -> PyTree:
    """Replace the tolerances of a study by those of a result, where both have one.

    Limits, distribution and capability of an error are kept as deviations from the nominal values of the study's
    design.

    Args:
        study: whose other tolerances stay.
        tolerances: of the result, a record with a Tolerance or None in each field.

    Raises:
        ValueError: tolerances of another kind of reducer, or none that the study has.
    """
    if type(tolerances) is not type(study.tolerances):
        theirs, ours = (type(record).__name__ for record in (tolerances, study.tolerances))
        raise ValueError(f"study {study.name}: has requirements on {ours}, the result is about {theirs}")
    found = {name: one for name in study.fields if (one := getattr(tolerances, name)) is not None}
    if not found:
        raise ValueError(f"study {study.name}: has none of the errors of the result")
    for name, one in found.items():
        if one.shape != (shape := getattr(study.tolerances, name).shape):
            raise ValueError(f"tolerances.{name}: {one.shape} elements in the result, {shape} in study {study.name}")
    return study.tolerances.replace(**found)


def cost_of(study: Study, tolerances: object) -> float:
    """Cost of tolerances in the costs of a study.

    Args:
        study: whose costs count.
        tolerances: a record with a Tolerance in each field that has a cost.
    """
    return sum(float(cost(getattr(tolerances, name).half_width)) for name, cost in study.costs.items())
