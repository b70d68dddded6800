"""Checked values of a study file: an error is one line that names key, value and unit."""

import dataclasses
import functools
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rvjax.base.words import UnknownWord, choose, unknown
from rvjax.catalogue import shown
from rvjax.records import PyTree
from rvjax.units import KNOWN, parse, point_for, with_unit

Toml = dict[str, object]
"""A table of a study file."""

Metadata = Mapping[str, Any]
"""Of a field of a record: unit, meaning, shape, kind ..."""

Numbers = float | list["Numbers"]


class StudyError(ValueError):
    """Invalid study; the message names file, key, value and rule."""


def text_of(path: Path, where: str, what: str = "") -> str:
    """Text of a file in UTF-8, with or without the byte order mark of Windows.

    Args:
        path: of the file.
        where: file or option, for the message.
        what: kind of the file, for the message.

    Raises:
        StudyError: it cannot be read.
        FileNotFoundError: there is no such file.
    """
    try:
        return path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(f"{where}: no such {what} file".replace("  ", " ")) from None
    except (OSError, UnicodeDecodeError) as error:
        raise StudyError(f"{where}: cannot be read as text in UTF-8 ({error})") from None


@functools.lru_cache(maxsize=8)
def tables_of(text: str) -> Mapping[str, PyTree]:
    """Tables of a TOML text; they are read only, since equal texts share them.

    Raises:
        ValueError: it is not valid; with a hint for a decimal comma.
    """
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        place = re.search(r"at line (\d+)", str(error))
        line = text.splitlines()[int(place[1]) - 1] if place else ""
        comma = re.search(r"=\s*([-+]?\d+,\d+)", line)
        raise ValueError(f"not valid TOML: {error}{point_for(comma[1]) if comma else ''}") from None


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


def needed(table: Iterable[str], keys: Iterable[str], where: str, why: str) -> None:
    """Raise an error for keys that are missing.

    Args:
        table: as written.
        keys: that it must have.
        where: name of the table, for the message.
        why: what they are, for the message.
    """
    for key in keys:
        if key not in table:
            raise ValueError(f"{where}.{key} is missing: {why}")


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


def positive(value: object, unit: str, where: str) -> float:
    """A positive number in SI; arguments as of `quantity`."""
    number = quantity(value, unit, where)
    if number <= 0:
        raise ValueError(f"{where} = {value!r}: must be positive")
    return number


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


def field_value(value: object, about: Metadata, where: str) -> PyTree:
    """A value of a field of a record or of conditions, as the field is declared.

    Args:
        value: as written.
        about: metadata of the field: kind, unit, choices, minimum and maximum, or columns of a table.
        where: key, for the message.
    """
    if about.get("columns"):
        return rows(value, about["columns"], where)
    if about.get("choices"):
        return choice(value, about["choices"], where)
    least, most, unit = (about.get(key) for key in ("minimum", "maximum", "unit"))
    if about.get("kind") == "count" or unit is None:
        return integer(value, where, about["minimum"], about["maximum"])
    if "shape" in about:  # of a record: a list, too
        return quantities(value, unit, where)
    number = quantity(value, unit, where)
    if least is not None and number < least:
        raise ValueError(f"{where} = {value!r}: must be at least {with_unit(least, unit)}")
    if most is not None and number > most:
        raise ValueError(f"{where} = {value!r}: must be at most {with_unit(most, unit)}")
    return number


def rows(value: object, columns: Mapping[str, str], where: str) -> tuple[tuple[float, ...], ...]:
    """Rows of tables [[where]], SI, in the order of their columns.

    Args:
        value: as written.
        columns: SI unit of each.
        where: name of the tables.
    """
    if not isinstance(value, list) or not value or not all(isinstance(row, dict) for row in value):
        raise ValueError(f"{where}: must be one or more tables [[{where}]] with {', '.join(columns)}")
    found = []
    for number, row in enumerate(value):
        known(row, columns, f"{where}[{number}]")
        for key, unit in columns.items():
            needed(row, [key], f"{where}[{number}]", f"every phase has one, in {unit}")
        found.append(tuple(quantity(row[key], unit, f"{where}[{number}].{key}") for key, unit in columns.items()))
    return tuple(found)


def in_unit(value: float, unit: str, digits: int = 4) -> str:
    """Text of a value in the unit in which it is at least one; a torsional stiffness per rad.

    Args:
        value: SI.
        unit: SI unit.
        digits: that are written.
    """
    name = unit if unit == "N m/rad" else shown(value, unit).split(" ", 1)[1]
    return f"{float(f'{value / KNOWN.get(unit, {}).get(name, 1.0):.{digits}g}'):.12g} {name}"


INITIALLY = re.compile(r"\binitially ([^;#]+)")  # in the comment of an assumed value: the value


def is_initial(text: object, note: str) -> bool:
    """True if a comment gives no assumed value, or the one that the file has.

    Args:
        text: as the file has it.
        note: its comment.
    """
    given = INITIALLY.search(note)
    return given is None or given[1].strip() == text


def is_replaced(value: PyTree, about: Metadata, note: str) -> bool:
    """True if a comment gives the assumed value, and the number is another one: the user has replaced it.

    Args:
        value: of the number, SI.
        about: metadata of its field.
        note: its comment.
    """
    given = INITIALLY.search(note)
    if given is None:
        return False
    text: object = given[1].strip()
    try:
        if about["unit"] == "-":
            text = int(given[1]) if about["kind"] == "count" else float(given[1])
        return not np.isclose(field_value(text, about, ""), value, rtol=1e-9, atol=0)
    except ValueError:  # words of the user
        return False


LONGEST = 200  # characters of a line of [about]


@dataclass(frozen=True)
class About:
    """Title, author and revision of a study for the head of reports; "" for a missing entry.

    Attributes:
        title: of the report; "" for the name of the study.
        author: person responsible for the values.
        revision: of the study or of the drawing.
    """

    title: str = ""
    author: str = ""
    revision: str = ""

    def line(self) -> str:
        """Join all entries in one line; "" without any."""
        said = [self.title, self.author, f"revision {self.revision}" if self.revision else ""]
        return "; ".join(filter(None, said))


def parse_about(table: Toml) -> About:
    """The table [about]; the revision may be a number that is counted.

    Raises:
        ValueError: names the key and its value.
    """
    known(table, [f.name for f in dataclasses.fields(About)], "about")
    entries = {}
    for key, value in table.items():
        text = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
        if not isinstance(text, str) or not text.strip() or not text.isprintable() or len(text) > LONGEST:
            raise ValueError(f"about.{key} = {text!r}: must be a text of one line, at most {LONGEST} characters")
        entries[key] = text.strip()
    return About(**entries)
