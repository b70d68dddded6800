"""Published reducers; `catalogue.toml` gives the source of every value."""

import dataclasses
import re
import tomllib
import typing
from collections.abc import Mapping
from importlib import resources
from typing import Any, TypeVar

from rvjax._reducer.deviations import unreminded
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import CamRollerReducer, RVReducer
from rvjax.errors import RVErrors
from rvjax.records import PyTree, Record
from rvjax.units import parse

Read = TypeVar("Read", bound=Record)


def part_class(cls: type, name: str) -> type[Record]:
    """The class of a field that is a record, optional or not."""
    hint = typing.get_type_hints(cls)[name]
    return next(item for item in (*typing.get_args(hint), hint) if item is not type(None))


def _number(value: object, unit: str) -> PyTree:
    return [_number(item, unit) for item in value] if isinstance(value, list) else parse(value, unit)


def _record(cls: type[Read], table: Mapping[str, object]) -> Read:
    about, values = {f.name: f.metadata for f in dataclasses.fields(cls)}, dict[str, Any]()
    for name, value in table.items():
        if isinstance(value, dict):
            values[name] = _record(part_class(cls, name), value)
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
    found, reducer, section, all_of_it = dict[str, str](), _named(base), "", ""
    reducers = {reducer, reducer.removesuffix("_WHOLE")}
    for line in re.sub(r"\n#   (?=\S)", " ", _TEXT).splitlines():  # a comment may go on in the next line
        if header := re.fullmatch(r"\[(.*)\](?:  # )?(.*)", line):
            section, all_of_it = header.groups()
        owner, _, part = section.partition(".")
        key, equals, rest = line.partition(" = ")
        if owner in reducers and equals and not key.startswith("#"):
            found[f"{part}.{key}" if part else key] = rest.partition("# ")[2] or all_of_it
    return found


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
with unreminded():
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
