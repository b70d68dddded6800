"""Columns of a measured table: which column is which quantity, in which unit, read to SI."""

import difflib
import functools
import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rvjax.base.cells import MARKS, UNITS, Row, listed, narrow, read_cells
from rvjax.base.text import grouping_of, guessed, has_decimal_comma, last_digit, number_of
from rvjax.base.words import unknown
from rvjax.units import intended, recognised, spelling

Units = Mapping[str, Mapping[str, float]]
"""By quantity: what it may be written in, with its size in SI."""

_OF_ARC = {"sec": "arcsec", "min": "arcmin"}  # of time, or of an angle
_BETWEEN = r"\s*(?:[_/,:;.|-]|\s+in\s+|\s)\s*"  # a name and its unit


@dataclass(frozen=True)
class Table:
    """A measured table.

    Attributes:
        source: name of the file, for messages.
        rows: line of each row in the file, (n,).
        numbers: {quantity: values in SI (n,)}; NaN where a cell is empty.
        words: {name: texts (n,)}.
        shown: {quantity: unit that the file is written in}.
        header: names of the columns as written.
        notes: what was read from a form that is not the plain one, a sentence each.
        digits: {quantity: one unit of the last digit that is written, SI}.
    """

    source: str
    rows: np.ndarray
    numbers: dict[str, np.ndarray]
    words: dict[str, list[str]]
    shown: dict[str, str]
    header: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    digits: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Place:
    """Column of a quantity; its unit with the size in SI; whether the header has the plain form "name [unit]"."""

    column: int
    unit: str
    size: float
    plain: bool


def read_table(
    path: str | Path,
    columns: Mapping[str, object] | None = None,
    *,
    units: Units,
    words: Sequence[str] = (),
    enough: Iterable[Collection[str]] = (),
    at: Mapping[str, int] | None = None,
    named: Callable[[str], bool] = lambda header: False,
    encoding: str | None = None,
) -> Table:
    """A table from a text file. Commas, semicolons, tabs or spaces separate cells; decimal commas if no comma does.

    Args:
        path: the file.
        columns: foreign names by quantity: the header of the column, or {column, unit} where it has no unit; with
            the unit count also counts_per_turn.
        units: quantities that are wanted, each with its units.
        words: columns of text that are wanted.
        enough: sets of quantities; if the plain headers have one of them, other spellings are not read.
        at: {quantity: number of its column}, where the caller has chosen it.
        named: further names by which the line of the header is found.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: one line that names the file, the column or the row, its value and the unit.
        FileNotFoundError: there is no such file.
    """
    source, columns = str(path), columns or {}
    given = [about.get("column") if isinstance(about, dict) else about for about in columns.values()]
    asked = {_key(one) for one in given if isinstance(one, str)}

    def known(header: str) -> int:
        head, unit = name_and_unit(header)
        mine = _key(header) in asked or _key(head) in asked or named(header)
        guess = loosely(header, units, words)
        unit = guess[1] if guess else unit
        if not (mine or guess):
            return 0
        return 2 if unit and recognised(unit, UNITS) else 1

    cells = read_cells(path, named=known, encoding=encoding)
    try:
        places, notes = _places(source, cells.header, columns, units, words, [*map(set, enough)], at or {})
    except ValueError as error:
        raise ValueError("; ".join([str(error), *guessed(cells.notes)])) from None
    if any(place.column == 0 and name in units for name, place in places.items()):
        body: list[Row] = [(k, row) for k, row in cells.body if not row[0].lstrip().startswith(MARKS)]
        if marked := [str(k) for k, row in cells.body if row[0].lstrip().startswith(MARKS)]:
            notes = [f"lines of the table that are not read: {listed(marked)}", *notes]
    else:  # words may begin with such a mark
        body = cells.body
    numbers, texts, shown, digits = {}, {}, {}, {}
    measured = [place.column for name, place in places.items() if name in units]
    written = [row[k].strip() for _, row in body for k in measured]
    grouping = grouping_of(source, written)
    comma = cells.comma or (not grouping and any(map(has_decimal_comma, written)))  # quoted, between commas
    for name, place in places.items():
        taken = [(number, row[place.column].strip()) for number, row in body]
        if name in words:
            texts[name] = [cell for _, cell in taken]
        else:
            values = [number_of(source, name, place.unit, *cell, comma, grouping=grouping) for cell in taken]
            numbers[name], shown[name] = np.array(values) * place.size, place.unit
            digits[name] = last_digit([cell for _, cell in taken], comma, grouping) * place.size
    notes = [*cells.notes, *notes, *(["the file has thousands separators"] if grouping else [])]
    return Table(
        source, np.array([k for k, _ in body]), numbers, texts, shown, tuple(cells.header), tuple(notes), digits
    )


def nearest(header: str, names: Iterable[str]) -> str | None:
    """Return the name of which a header is a misspelling; None if there is none.

    Args:
        header: as written.
        names: that are wanted.
    """
    found = difflib.get_close_matches(_key(name_and_unit(header)[0]), list(names), 1, 0.7)
    return found[0] if found else None


def mapping(
    name: str, header: Sequence[str], units: Mapping[str, float], used: Collection[str] = ()
) -> tuple[str, str]:
    """Return a column that may be a quantity, and its line of [columns]: the nearest name, a known unit, or any column.

    Args:
        name: of the quantity.
        header: names of the columns.
        units: of the quantity, the usual one first.
        used: columns of other quantities.
    """
    free = [text for text in header if text and text not in used] or [""]
    keys = [_key(name_and_unit(text)[0]) for text in free]
    near = difflib.get_close_matches(name, keys, 1)
    inside = [key for key in keys if name in key]
    fits = [key for key, text in zip(keys, free) if recognised(name_and_unit(text)[1] or "?", units)]
    column = free[keys.index([*near, *inside, *fits, *keys][0])]
    said = name_and_unit(column)[1]
    unit = recognised(said, [*units, *(["count"] if "turn" in units else [])]) if said else next(iter(units))
    return column, _line(name, column, unit)


def _line(name: str, column: str, unit: str | None) -> str:
    if unit is None:  # of the header, unknown: another one has another size
        return f"{name} = {json.dumps(column, ensure_ascii=False)}"
    counts = ", counts_per_turn = 524288" if unit == "count" else ""
    return f'{name} = {{ column = {json.dumps(column, ensure_ascii=False)}, unit = "{unit}"{counts} }}'


def _places(
    source: str,
    header: Sequence[str],
    columns: Mapping[str, object],
    units: Units,
    words: Sequence[str],
    enough: Sequence[Collection[str]],
    at: Mapping[str, int],
) -> tuple[dict[str, _Place], list[str]]:
    """{quantity: its column}, and what was read that is not plain."""
    wanted, found = [*units, *words], dict[str, _Place]()
    foreign: dict[int, tuple[str, dict[str, object]]] = {k: (name, {}) for name, k in at.items()}
    for name, about in columns.items():
        if name not in wanted:
            raise unknown(f"unknown key columns.{name}", name, sorted(wanted), "; known here:")
        given = _given(name, about)
        k = _matching(source, name, str(given["column"]), header)
        if k in foreign:
            raise ValueError(f"{source}: columns.{name} = {given['column']!r}: is the column of {foreign[k][0]} too")
        foreign[k] = (name, given)
    mapped = [name for name, _ in foreign.values()]
    loose: dict[str, list[tuple[int, str | None]]] = {}
    for k, text in enumerate(header):
        name, unit = split(text)
        if k in foreign:
            name, given = foreign[k]
            unit = _unit_of(f"{source}: column {text!r}", text, name, given.get("unit"), units)
            unit = "count" if unit is None and "counts_per_turn" in given else unit
            found[name] = _placed(source, header, k, name, unit, units, given.get("counts_per_turn"))
        elif (name := name.lower()) not in wanted:
            if (guess := loosely(text, units, words)) is not None:
                loose.setdefault(guess[0], []).append((k, guess[1]))
        elif name not in mapped:  # else [columns] names another column for this quantity
            if name in found:
                raise ValueError(f"{source}: column {text!r}: {name} is in two columns")
            found[name] = _placed(source, header, k, name, unit, units)
    complete = any(set(one) <= found.keys() for one in enough)
    left = []
    for name, places in loose.items():
        texts = [header[k] for k, _ in places]
        if name in found:
            continue
        if complete:
            left += [f"column {text!r} is not read; {name} is read from a header such as "
                     f'"{name} [{next(iter(units[name]), "")}]"' for text in texts if name in units]  # fmt: skip
            continue
        if len(places) > 1:
            own = mapping(name, texts, units.get(name, {"": 1.0}))[1]
            raise ValueError(f"{source}: {name} may be in {listed(texts)}; write one in [columns]: {own}")
        found[name] = _placed(source, header, places[0][0], name, places[0][1], units)
    odd = [f"{header[p.column]!r} as {name} in {p.unit}" for name, p in found.items() if not p.plain and name in units]
    odd += [f"{header[p.column]!r} as {name}" for name, p in found.items() if not p.plain and name not in units]
    others = [text for k, text in enumerate(header) if text and k not in [p.column for p in found.values()]]
    notes = [f"columns are read: {', '.join(odd)}" + (f"; not read: {listed(others)}" if others else "")] if odd else []
    return found, [*notes, *left]


def _given(name: str, about: object) -> dict[str, object]:
    """An entry of [columns]."""
    given = about if isinstance(about, dict) else {"column": about}
    if not isinstance(given.get("column"), str) or not set(given) <= {"column", "unit", "counts_per_turn"}:
        raise ValueError(f'columns.{name} = {about!r}: must be the header of a column, or {{column = "", unit = ""}}')
    if "counts_per_turn" in given:
        counts, unit = given["counts_per_turn"], given.get("unit", "count")
        if isinstance(counts, bool) or not isinstance(counts, int | float) or not 0 < counts < math.inf:
            raise ValueError(f"columns.{name}.counts_per_turn = {counts!r}: must be a positive number")
        if recognised(str(unit), {"count"}) is None:
            raise ValueError(f'columns.{name}.counts_per_turn = {counts!r}: belongs to unit = "count", not {unit!r}')
    return dict(given)


def _unit_of(where: str, header: str, name: str, given: object, units: Units) -> str | None:
    """Unit that [columns] gives, else that of the header; both only with the same size."""
    said, own = name_and_unit(header)[1], units.get(name, {})
    one, other = (recognised(str(unit or ""), own) for unit in (said, given))
    if one and other and own[one] != own[other]:
        raise ValueError(f"{where}: columns.{name}.unit = {given!r}: the header says {said!r}; remove one of the two")
    return said if given is None else str(given)


def _matching(source: str, name: str, column: str, header: Sequence[str]) -> int:
    """Number of the column that [columns] names: as written, else with other capitals, spaces or brackets."""
    matches = [k for k, text in enumerate(header) if column in (text, split(text)[0])]
    if not matches:
        keys = [(_key(text), _key(name_and_unit(text)[0])) for text in header]
        matches = [k for k, own in enumerate(keys) if _key(column) in own]
    if len(matches) != 1:
        why = "no column of the file" if not matches else f"the header of {len(matches)} columns"
        near = difflib.get_close_matches(column, [text for text in header if text], 2)
        hint = f" (did you mean {' or '.join(near)}?)" if near and not matches else ""
        raise ValueError(f"{source}: columns.{name} = {column!r}: {why}{hint}; it has {listed(header)}")
    return matches[0]


def _placed(
    source: str, header: Sequence[str], k: int, name: str, unit: str | None, units: Units, counts: object = None
) -> _Place:
    """Column with the size of its unit."""
    text = header[k]
    head, said = split(text)
    plain = head.lower() == name
    if name not in units:
        return _Place(k, "", 1.0, plain)
    own, meant = units[name], recognised(unit or "", units[name])
    if meant is not None:
        return _Place(k, meant, own[meant], plain and spelling(said or "") in own)
    turn = own.get("turn")
    if unit and turn and recognised(unit, {"count"}):
        if isinstance(counts, int | float):
            return _Place(k, "count", turn / float(counts), False)
        need = f"unit {unit!r} needs the counts per turn"
        raise ValueError(f"{source}: column {text!r}: {need}; write in [columns]: {_line(name, text, 'count')}")
    near = intended(unit or "", own) or _OF_ARC.get((unit or "").casefold())
    near = near if near in own else None
    wrong = f"unit {unit!r} is not known" if unit else "has no unit"
    wrong += f" (did you mean {near}?)" if near else ""
    under = f'"{name} [{next(iter(own))}]" ({", ".join(own)})'
    write = f"write {under}, or in [columns]: {_line(name, text, near or next(iter(own)))}"
    if unit and not near:  # its size is not known
        write = f"write the numbers in another one, under {under}; if it is no unit, give theirs in [columns]"
    raise ValueError(f"{source}: column {text!r}: {wrong}; {write}; the file has the columns {listed(header)}")


@functools.lru_cache(4096)
def _key(text: str) -> str:
    """A name without capitals; spaces, underscores and hyphens are alike."""
    return re.sub(r"[\s_-]+", "_", narrow(text).strip(" _,:/-").casefold())


def name_and_unit(header: str) -> tuple[str, str | None]:
    """Return name and unit of "name [unit]" or "name (unit)", with brackets of any width; None for no unit."""
    match = re.fullmatch(r"(.*?)\s*[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]\s*:?", narrow(header).strip())
    return (match[1], match[2]) if match and (match[2] == "" or not match[2].isdecimal()) else (header, None)


def loosely(header: str, units: Units, words: Iterable[str] = ()) -> tuple[str, str | None] | None:
    """Name and unit of a header such as "Angle_deg", "angle/deg" or "angle（deg）"; None if it is another column.

    Args:
        header: as written.
        units: quantities that are wanted, each with its units.
        words: columns of text that are wanted; they have no unit.
    """
    head, unit = name_and_unit(header)
    key, text = _key(head), narrow(header).strip()
    for name in [*units, *words]:
        if key == _key(name):
            return (name, unit) if unit is None or recognised(unit, UNITS) else None
    for name, own in units.items():
        if not text.casefold().startswith(name.split("_")[0].casefold()):
            continue
        start = r"[\s_-]+".join(map(re.escape, name.split("_")))
        for pattern in (rf"{start}{_BETWEEN}(.+)", rf"{start}\s*([°º′″'\"].*)"):
            match = re.fullmatch(pattern, text, re.IGNORECASE)
            if match and recognised(match[1], [*own, *(["count"] if "turn" in own else [])]):
                return name, match[1]
    return None


def split(header: str) -> tuple[str, str | None]:
    """Name and unit of the plain form "name [unit]"; the name may contain brackets."""
    match = re.fullmatch(r"(.*?)\s*\[\s*([^\[\]]*?)\s*\]", header)
    return (match[1], match[2]) if match else (header, None)
