"""Published reducers, with the source of every number beside it in `catalogue.toml`."""

import dataclasses
import re
import tomllib
import typing
from importlib import resources
from typing import Any

from rvjax.designs import CamRollerReducer, RVReducer
from rvjax.errors import RVErrors
from rvjax.units import parse


def part_class(cls: type, name: str) -> Any:
    """The class of a field that is a record, optional or not.

    Args:
        cls: of the record that has it.
        name: of the field.
    """
    hint = typing.get_type_hints(cls)[name]
    return next(item for item in (*typing.get_args(hint), hint) if item is not type(None))


def _record(cls: Any, table: dict[str, Any]) -> Any:
    about, values = {f.name: f.metadata for f in dataclasses.fields(cls)}, dict[str, Any]()
    for name, value in table.items():
        if isinstance(value, dict):
            values[name] = _record(part_class(cls, name), value)
        else:
            values[name] = value if about[name]["kind"] == "count" else parse(value, about[name]["unit"])
    return cls(**values)


_TEXT = (resources.files("rvjax") / "catalogue.toml").read_text("utf-8")
_PUBLISHED = tomllib.loads(_TEXT)


def assumed(reducer: str) -> list[str]:
    """Numbers of a published reducer that nobody printed, by their path in the design.

    Args:
        reducer: as this module names it, such as "RV_40E".
    """
    found, section = [], ""
    for line in _TEXT.splitlines():
        if header := re.fullmatch(r"\[(.*)\].*", line):
            section = header[1]
        owner, _, part = section.partition(".")
        key, _, rest = line.partition(" = ")
        if owner == reducer and "# assumed" in rest:
            found.append(f"{part}.{key}" if part else key)
    return found


CORR: CamRollerReducer = _record(CamRollerReducer, _PUBLISHED["CORR"])
RV_40E: RVReducer = _record(RVReducer, _PUBLISHED["RV_40E"])
RV_20E: RVReducer = _record(RVReducer, _PUBLISHED["RV_20E"])
RV_20E_ERRORS: RVErrors = _record(RVErrors, _PUBLISHED["RV_20E_ERRORS"])
RV_80E: RVReducer = _record(RVReducer, _PUBLISHED["RV_80E"])
RV_320E: RVReducer = _record(RVReducer, _PUBLISHED["RV_320E"])
