"""Published reducers, and a warning for a design that is far from every known one.

`catalogue.toml` gives the source of every value.
"""

import dataclasses
import functools
import math
import re
import tomllib
import typing
import warnings
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping
from importlib import resources
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import jax
import numpy as np

from rvjax import flank
from rvjax._jax import checks
from rvjax._jax.programs import ONCE, quick
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import CamRollerReducer, CycloidStage, RVReducer
from rvjax.errors import RVErrors
from rvjax.records import PyTree, Record, Scalar, concrete
from rvjax.units import parse, rpm, suited, with_unit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = ParamSpec("P")
R = TypeVar("R")
Read = TypeVar("Read", bound=Record)


def part_class(cls: type, name: str, given: Collection[str] = (), own: object = None, where: str = "") -> type[Record]:
    """The class of a field that is a record, optional or not; of several classes, that of the keys of a table.

    The first field of a class (`rollers`, `balls`) decides, without it the most keys, then the record of the base.

    Args:
        cls: of the record.
        name: of its field.
        given: keys of the table of the part.
        own: record of the base.
        where: name of the table, for the message.

    Raises:
        ValueError: keys that decide for two classes.
    """
    hint = typing.get_type_hints(cls)[name]
    options = [item for item in (*typing.get_args(hint), hint) if item is not type(None)]
    classes: list[type[Record]] = [item for item in options[:-1] or options if isinstance(item, type)]
    if len(classes) < 2:
        return options[0]
    fields = {each: [f.name for f in dataclasses.fields(each)] for each in classes}
    deciding = [each for each in classes if fields[each][0] in given]
    if len(deciding) > 1:
        raise ValueError(f"{where}: {' and '.join(fields[each][0] for each in deciding)}: give one of them")
    return max(deciding or classes, key=lambda each: (len({*given} & {*fields[each]}), isinstance(own, each)))


def _number(value: object, unit: str) -> object:
    return [_number(item, unit) for item in value] if isinstance(value, list) else parse(value, unit)


def _record(cls: type[Read], table: Mapping[str, object]) -> Read:
    about, values = {f.name: f.metadata for f in dataclasses.fields(cls)}, dict[str, Any]()
    for name, value in table.items():
        if isinstance(value, dict):
            values[name] = _record(part_class(cls, name, value), value)
        else:
            values[name] = value if about[name]["kind"] == "count" else _number(value, about[name]["unit"])
    return cls(**values)


_TEXT = (resources.files("rvjax") / "catalogue.toml").read_text("utf-8")
_PUBLISHED = tomllib.loads(_TEXT)


ASSUMED = re.compile(r"\bassumed\b")  # in the comment of an unpublished value


def _named(base: str) -> str:
    return base.upper().replace("-", "_")


def sources(base: str) -> dict[str, str]:
    """Source of each value of a published reducer, by its path in the design.

    Args:
        base: as studies name it, such as "rv-40e".
    """
    text = re.sub(r"\n#   (?=\S)", " ", _TEXT)  # a comment may go on in the next line
    tables = dict.fromkeys((_named(base).removesuffix("_WHOLE"), _named(base)))
    return {path: note or heading for table in tables for path, note, heading in noted(text, table)}


def noted(text: str, table: str) -> Iterator[tuple[str, str, str]]:
    """(path, its comment, comment of its header) of every key of a table of a TOML text, and of the tables in it.

    Args:
        text: TOML with a key on each line.
        table: such as "design" or "requirement".
    """
    section, heading = [""], ""
    for line in text.splitlines():
        if header := re.match(r"\s*\[([^\]]*)\]\s*(?:#\s*(.*))?", line):
            section, heading = header[1].strip().split("."), header[2] or ""
        elif section[0] == table and (key := re.match(r"\s*([\w.-]+)\s*=[^#]*(?:#\s*(.*))?$", line)):
            yield ".".join([*section[1:], key[1]]), key[2] or "", heading


def assumed(base: str) -> list[str]:
    """Paths of the unpublished values of a published reducer."""
    return [path for path, said in sources(base).items() if ASSUMED.search(said)]


def citation(base: str) -> str:
    """The source of a published reducer: the comment above its tables."""
    before = re.split(rf"^\[{_named(base)}[.\]]", _TEXT, maxsplit=1, flags=re.MULTILINE)[0]
    above = re.findall(r"(?:^# .*\n)+\Z", before, flags=re.MULTILINE)
    return " ".join(line.removeprefix("# ") for line in "".join(above).splitlines())


CORR: CamRollerReducer = _record(CamRollerReducer, _PUBLISHED["CORR"])
RV_40E: RVReducer = _record(RVReducer, _PUBLISHED["RV_40E"])
RV_40E_WHOLE: RVReducer = _record(
    RVReducer, {**_PUBLISHED["RV_40E"], **_PUBLISHED["RV_40E_WHOLE"]}
)  # RV-40E with assumed stiffnesses, contact and masses
RV_20E: RVReducer = _record(RVReducer, _PUBLISHED["RV_20E"])
with checks.unreminded():
    RV_20E_ERRORS: RVErrors = _record(RVErrors, _PUBLISHED["RV_20E_ERRORS"])
RV_80E: RVReducer = _record(RVReducer, _PUBLISHED["RV_80E"])
RV_320E: RVReducer = _record(RVReducer, _PUBLISHED["RV_320E"])
CYCLOIDAL_15: CycloidalReducer = _record(CycloidalReducer, _PUBLISHED["CYCLOIDAL_15"])
CYCLOIDAL_17: CycloidalReducer = _record(CycloidalReducer, _PUBLISHED["CYCLOIDAL_17"])
CYCLOIDAL_29: CycloidalReducer = _record(CycloidalReducer, _PUBLISHED["CYCLOIDAL_29"])

BASES: dict[str, PyTree] = {
    "corr": CORR,
    "rv-20e": RV_20E,
    "rv-40e": RV_40E,
    "rv-40e-whole": RV_40E_WHOLE,
    "rv-80e": RV_80E,
    "rv-320e": RV_320E,
    "cycloidal-15": CYCLOIDAL_15,
    "cycloidal-17": CYCLOIDAL_17,
    "cycloidal-29": CYCLOIDAL_29,
}
"""Known reducers of every kind, by the name that study files give them."""

FAR = 30.0  # factor from every known reducer beyond which a number is doubted
FAR_STIFFNESS = 600.0  # in Python, where calibrations move it: less than the thousand between N/mm and N/m
STIFFNESS = ("N/m", "N m/rad")
FAR_INERTIA = 1000.0  # grows with the fifth power of a length: 50 between the sizes 20 and 320
KNOWN_DESIGNS = tuple(BASES.values())


class ImplausibleDesign(UserWarning):
    """Design with values far from those of every known reducer; mostly a wrong unit."""


_seen: "dict[int, weakref.ref[object]]" = {}  # designs by identity: records of arrays have no hash


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of a model as `checks.checked` does, and doubt its design."""
    return checks.checked(function, doubt_once)


def doubt_once(design: object, where: str) -> None:
    """Warn of a design whose lengths or stiffnesses are far from every known reducer, once for each; tracers pass.

    Calibrations move stiffnesses, so their range is wider than in studies. Only studies list inertias.

    Args:
        design: as given.
        where: the function, for the message.
    """
    known = _seen.get(id(design))
    new = known is None or known() is not design
    if not (new and type(design) in _spans() and accept(design)):
        return
    if found := steep(design) + doubtful(design, ("m",)) + doubtful(design, STIFFNESS, FAR_STIFFNESS):
        more = f" (and {len(found) - 1} more values)" if len(found) > 1 else ""
        warnings.warn(f"{where}: design.{found[0]}{more}", ImplausibleDesign, stacklevel=3)


def accept(design: object) -> bool:
    """Take note of a design, so that `doubt_once` does not warn of it; False for one of tracers, which is not noted.

    Args:
        design: such as a study has read and checked.
    """
    if not concrete(*jax.tree.leaves(design)):
        return False
    key = id(design)
    _seen[key] = weakref.ref(design, lambda _: _seen.pop(key, None))
    return True


def doubtful(design: object, units: tuple[str, ...] = (), far: float = FAR) -> list[str]:
    """Values of a design that are far from those of every known reducer, a line each.

    Args:
        design: any; one of a class without known reducers gives none.
        units: of the values that are checked; all without one.
        far: factor from every known reducer beyond which a value is listed.
    """
    spans = _spans().get(type(design), {})
    return [
        line
        for name, (value, unit) in numbers(design)
        if value and name in spans and (not units or unit in units)
        for line in doubt(name, abs(value), unit, *spans[name], far=far)
    ]


def steep(design: object) -> list[str]:
    """A line for harmonics of a profile modification that are too steep for models of first order, else nothing.

    Args:
        design: numbers, not traced.
    """
    cycloid = getattr(design, "cycloid", None)
    slope = 0.0 if cycloid is None else flank.steepest(cycloid)
    if slope <= 1.001 * flank.STEEPEST:  # optima are at the limit
        return []
    found = "the flank is undercut" if math.isnan(slope) else f"slope of the flank {slope:.2g}"
    return [f"cycloid.profile_modification: {found}; the models are of first order, up to a slope of {flank.STEEPEST}"]


@quick(options=ONCE)  # one program instead of one for each operation
def _room(cycloid: CycloidStage) -> jax.Array:
    return flank.Ground.of(cycloid).least_convex(cycloid.pin_count)


def sharp_from(cycloid: CycloidStage) -> float:
    """Pin radius from which on the flank of a disc with these modifications is undercut, m; <= 0: with all pins.

    Args:
        cycloid: numbers, not traced.
    """
    return float(cycloid.pin_radius) + float(_room(cycloid))


def undercut(design: object) -> list[str]:
    """A line for pins that cut into the flank of the discs, else nothing.

    Args:
        design: numbers, not traced.
    """
    cycloid = getattr(design, "cycloid", None)
    if cycloid is None or cycloid.pin_radius < (least := sharp_from(cycloid)):
        return []
    limit = f"from {shown(least, 'm')} on" if least > 0 else "of any radius"
    found = f"pins {limit} cut into the flank of the discs (undercut)"
    return [f"cycloid.pin_radius = {shown(cycloid.pin_radius, 'm')}: {found}"]


@functools.cache
def _spans() -> dict[type, dict[str, tuple[float, float]]]:
    """Smallest and largest value of each quantity in known reducers, by class of the design.

    What may have either sign, such as a modification, has no smallest value.
    """
    found: dict[type, dict[str, tuple[float, float]]] = {}
    for design in KNOWN_DESIGNS:
        spans = found.setdefault(type(design), {})
        signed = {path for path, _, about in walk(design) if about.get("sign") == "any"}
        for name, (value, _) in numbers(design):
            if size := abs(value):
                least, most = spans.get(name, (size, size))
                spans[name] = 0.0 if name in signed else min(least, size), max(most, size)
    return found


def doubt(name: str, value: float, unit: str, least: float, most: float, *, far: float = FAR) -> list[str]:
    """Return a line for a value that is far outside a range, else nothing.

    Args:
        name: of the value.
        value: SI, positive.
        unit: SI.
        least: smallest known value; 0 for none.
        most: largest known value.
        far: factor beyond which it is far; larger for inertias.
    """
    far = FAR_INERTIA if unit == "kg m2" else far
    if least / far <= value <= far * most:
        return []
    span = f"{shown(least, unit)} to {shown(most, unit)}" if least else f"up to {shown(most, unit)}"
    return [f"{name} = {shown(value, unit)}: known reducers have {span}; check the unit"]


def numbers(design: PyTree) -> Iterator[tuple[str, tuple[float, str]]]:
    """(path, (value of the largest size, SI unit)) of every quantity with a unit in a design."""
    for path, value, about in walk(design):
        if about["kind"] != "count" and about["unit"] not in ("-", "rad"):
            flat = np.ravel(np.asarray(value, float))
            yield path, (float(flat[np.argmax(np.abs(flat))]), about["unit"])


def walk(record: "DataclassInstance", prefix: str = "") -> Iterator[tuple[str, PyTree, Mapping[str, Any]]]:
    """(path, value, metadata of the field) of every given value of a design, such as "cycloid.pin_count".

    Args:
        record: a record of numbers and records.
        prefix: of the paths.
    """
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if f.metadata["kind"] == "record" and value is not None:
            yield from walk(value, f"{prefix}{f.name}.")
        elif value is not None:
            yield prefix + f.name, value, f.metadata


def fields_of(record: PyTree, prefix: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """(path, metadata) of every number of a design, also of those without a value."""
    for f in dataclasses.fields(record):
        value, about = getattr(record, f.name), f.metadata
        if about["kind"] == "record":
            yield from fields_of(value, f"{prefix}{f.name}.") if value is not None else ()
        else:
            yield prefix + f.name, about


def fields_of_kind(
    cls: type, prefix: str = "", given: Collection[str] = ()
) -> Iterator[tuple[str, Mapping[str, Any], object]]:
    """(path, metadata, default) of every number that a design may have.

    Args:
        cls: of designs, or of a part.
        prefix: of the paths.
        given: paths of known numbers, which decide between classes of a part, see `part_class`.
    """
    for f in dataclasses.fields(cls):
        if f.metadata["kind"] == "record":
            own = f"{prefix}{f.name}."
            keys = [path.removeprefix(own) for path in given if path.startswith(own)]
            yield from fields_of_kind(part_class(cls, f.name, keys), own, given)
        else:
            yield prefix + f.name, f.metadata, f.default


def shown(value: Scalar, unit: str) -> str:
    """A number with the largest unit in which it is at least one; a speed in revolutions per minute.

    Args:
        value: SI.
        unit: its SI unit.
    """
    name, size = ("r/min", rpm) if unit == "rad/s" else suited(float(value), unit)
    return with_unit(float(value) / size, name)
