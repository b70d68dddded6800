"""Checked values of a study file: an error is one line that names key, value and unit."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rvjax._reducer.plausible import shown
from rvjax.base.words import UnknownWord, choose, unknown
from rvjax.units import KNOWN, parse

Toml = dict[str, object]
"""A table of a study file."""

Metadata = Mapping[str, Any]
"""Of a field of a record: unit, meaning, shape, kind ..."""

Numbers = float | list["Numbers"]


class StudyError(ValueError):
    """Invalid study; the message names file, key, value and rule."""


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Prefix the messages of errors with where they happened, in one line."""
    try:
        yield
    except (ValueError, TypeError) as error:
        message = " ".join(str(error).split())
        if len(message) > 400 and not isinstance(error, UnknownWord):  # a hostile value is not repeated at length
            message = f"{message[:200]} ... {message[-150:]}"
        raise StudyError(f"{where}: {message}") from None


@contextmanager
def naming_field(where: str) -> Iterator[None]:
    """Prefix messages that do not name the key yet."""
    try:
        yield
    except ValueError as error:
        kind = UnknownWord if isinstance(error, UnknownWord) else ValueError
        raise error if where in str(error) else kind(f"{where}: {error}") from None


def known(table: Iterable[str], keys: Iterable[str], where: str) -> None:
    """Raise an error for keys that are not read.

    Args:
        table: as written.
        keys: that are read.
        where: name of the table, for the message.
    """
    for key in table:
        if key not in keys:
            name = f"{where}.{key}" if where else f"[{key}]"
            raise unknown(f"unknown key {name}", key, sorted(keys), "; known here:")


def subtable(parent: Mapping[str, object], key: str) -> Toml:
    """A table, empty where it is missing.

    Args:
        parent: table that holds it.
        key: its name.
    """
    value = parent.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f"{key} = {value!r}: must be a table")
    return value


def share(value: object, where: str) -> float:
    """A share of units, between 0 and 1."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise ValueError(f"{where} = {value!r}: must lie between 0 and 1, such as 0.9973")
    return float(value)


def integer(value: object, where: str, minimum: float, maximum: float) -> int:
    """A whole number within limits.

    Args:
        value: as written.
        where: key, for the message.
        minimum: smallest value.
        maximum: largest value.
    """
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        raise ValueError(f"{where} = {value!r}: must be an integer of at least {minimum}")
    if value > maximum:
        raise ValueError(f"{where} = {value}: must be at most {maximum}")
    return value


def quantity(value: object, unit: str, where: str) -> float:
    """A number in SI.

    Args:
        value: text with a unit, or a plain number where `unit` is "-".
        unit: SI unit.
        where: key or option, for the message.
    """
    try:
        return parse(value, unit)
    except ValueError as error:
        raise ValueError(f"{where} = {error}") from None


def quantities(value: object, unit: str, where: str) -> Numbers:
    """A number in SI, or a list of them, nested as written.

    Args:
        value: as for `quantity`, or a list.
        unit: SI unit.
        where: key, for the message.
    """
    return (
        [quantities(item, unit, where) for item in value] if isinstance(value, list) else quantity(value, unit, where)
    )


def choice(value: object, choices: Iterable[str], where: str) -> str:
    """One of several words.

    Args:
        value: as written.
        choices: that are allowed.
        where: key, for the message.
    """
    return choose(where, value, choices)


def in_unit(value: float, unit: str, digits: int = 4) -> str:
    """Text of a value in the unit in which it is at least one; a torsional stiffness per rad.

    Args:
        value: SI.
        unit: SI unit.
        digits: that are written.
    """
    name = unit if unit == "N m/rad" else shown(value, unit).split(" ", 1)[1]
    return f"{float(f'{value / KNOWN.get(unit, {}).get(name, 1.0):.{digits}g}'):.12g} {name}"
