"""Cells of a text table as programs write it: encoding, comments, the line of the header, what separates the cells."""

import csv
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rvjax.base.text import text_of
from rvjax.units import KNOWN, recognised

DELIMITERS = ";\t,|"
MARKS = ("#", "%", "//", ";", "!", "*")  # of a comment
SHOWN = 12  # texts in a message
COLUMNS = 10_000  # of a table
SEARCHED = 200  # lines in which the header may be
Row = tuple[int, list[str]]
"""Line of the file, cells."""
_BRACKETS = {"[": "]", "(": ")", "{": "}"}
_WIDE: dict[int, int | str] = {code: code - 0xFEE0 for code in range(0xFF01, 0xFF5F)}  # full-width forms of ASCII
_WIDE |= {ord(wide): usual for wide, usual in zip("【〔〖】〕〗\u00a0\u2009\u202f\u3000", "[[[]]]    ")}
UNITS = frozenset([unit for family in KNOWN.values() for unit in family] + ["degC", "count"])


@dataclass(frozen=True)
class Cells:
    """A table of texts.

    Attributes:
        header: names of the columns as written; with the unit of a row of units in square brackets.
        body: rows under it.
        comma: whether a cell may have a decimal comma.
        notes: what was not plain, a sentence each.
    """

    header: list[str]
    body: list[Row]
    comma: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Mode:
    """A way to split lines: at a character, or at white space (" "; "  " for two or more, or a tab)."""

    delimiter: str
    rows: str = ""  # of the body, where it differs
    skip: bool = False  # spaces before a quote

    @property
    def spaced(self) -> bool:
        """True if white space separates the cells."""
        return self.delimiter in ("  ", " ")

    def header(self, lines: Sequence[str]) -> list[str]:
        """Cells of the first line; one in quotes may go on in the next."""
        if self.spaced:
            return _spaced(lines[0], self.delimiter, names=True)
        try:
            return self.names(next(self._reader(f"{line}\n" for line in lines[:5]), []))
        except csv.Error:
            return []

    def names(self, cells: Sequence[str]) -> list[str]:
        """Cells of a header: one such as "disc_bore[0,1] [um]" without quotes is a single one."""
        found, k = list[str](), 0
        while k < len(cells):
            end, opened = k, _open(cells[k])
            while opened > 0 and end + 1 < len(cells):
                end += 1
                opened += _open(cells[end])
            end = end if opened == 0 and end - k + 1 < len(cells) else k
            found.append(self.delimiter.join(cells[k : end + 1]))
            k = end + 1
        return found

    def fits(self, cells: Sequence[str], below: Sequence[str]) -> bool:
        """True if a line below a header has as many cells, one of them a number."""
        rows = [_spaced(x, self.rows or self.delimiter) if self.spaced else self.header([x]) for x in below]
        return any(len(row) == len(cells) and any(map(is_number, row)) for row in rows)

    def table(self, lines: Sequence[str]) -> list[Row]:
        """All rows that are not blank."""
        if self.spaced:
            rows = self.rows or self.delimiter
            return [(k, _spaced(line, rows)) for k, line in enumerate(lines, 1) if line.strip()]
        reader = self._reader(f"{line}\n" for line in lines)
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]

    def _reader(self, lines: Iterator[str]) -> Any:
        return csv.reader(lines, delimiter=self.delimiter, strict=True, skipinitialspace=self.skip)


def _open(text: str) -> int:
    """Brackets that open less those that close."""
    return sum((char in "([{") - (char in ")]}") for char in narrow(text))


def narrow(text: str) -> str:
    """Return a text with its full-width brackets, letters and spaces as those of ASCII."""
    return text.translate(_WIDE)


def listed(texts: Sequence[str]) -> str:
    """Texts of a file in a message: the first ones, each in one line."""
    more = f" and {len(texts) - SHOWN} more" if len(texts) > SHOWN else ""
    return ", ".join(" ".join(text[:60].split()) or "(no name)" for text in texts[:SHOWN]) + more


def is_number(cell: str) -> bool:
    """Return True for a number with a decimal point or comma."""
    try:
        float(cell.strip().replace(",", ".") or "x")
    except ValueError:
        return False
    return True


def read_cells(
    path: str | Path,
    example: str = "angle [deg],error [arcsec]",
    *,
    short: bool = False,
    named: Callable[[str], int] = lambda cell: 0,
    encoding: str | None = None,
) -> Cells:
    """Header and rows of a table, with any separator of the cells.

    The first line is the header, unless a later one has more names that are known.

    Args:
        path: of the file.
        example: of a header, for the message.
        short: rows may lack their last cells, which are empty.
        named: how certainly a cell is the header of a column that is wanted; 0 if it is none.
        encoding: of the file, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: no table.
        FileNotFoundError: there is no such file.
    """
    text, notes = text_of(Path(path), encoding)
    lines = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n").split("\n")
    filled = [k for k, line in enumerate(lines) if line.strip()]
    first = [lines[k] for k in filled[:SEARCHED]]
    widest = max((max(map(line.count, DELIMITERS)) or len(line.split()) - 1 for line in first), default=0)
    if widest >= COLUMNS:
        raise ValueError(f"{path}: {widest + 1} columns, at most {COLUMNS}; a table has a row for each reading")
    if not filled or "\0" in text:
        raise ValueError(f'{path}: no table; the first line must name the columns, such as "{example}"')
    at, head, modes = _header(lines, filled, named)
    if re.search("[，；]", head) and not re.search("[,;\t]", head):  # full-width marks between cells
        lines = [line.replace("，", ",").replace("；", ";") for line in lines]
        at, head, modes = _header(lines, filled, named)
    if at > filled[0]:
        notes += [f"the header is line {at + 1}; the lines before it are not read"]
    rest = [*[""] * at, head, *lines[at + 1 :]]
    for k in filled[filled.index(at) + 1 :][:1]:  # "# deg arcsec" under "# angle error"
        marked = _comment(lines[k]) and not lines[k].startswith(modes[0].delimiter)
        cells = modes[0].header([_unmarked(lines[k])]) if marked else []
        if (
            cells
            and len(cells) == len(modes[0].header([head]))
            and all(recognised(unbracketed(cell), UNITS) for cell in cells)
        ):
            rest[k] = _unmarked(lines[k])
    failure: ValueError | None = None
    for mode in modes:
        try:
            header, body, comments = _fitted(path, mode, rest, short)
        except ValueError as error:
            failure = failure or error
            continue
        merged = _with_units(path, header, body)
        if merged is not None:
            header, body = merged, body[1:]
            notes += ["the row under the header gives the units"]
        notes += [f"lines of the table that are not read: {listed(comments)}"] if comments else []
        if not body:
            raise ValueError(f"{path}: no rows under the header {mode.delimiter.join(header)!r}")
        return Cells(header, body, mode.delimiter != ",", tuple(notes))
    assert failure is not None
    raise failure


def _header(lines: Sequence[str], filled: Sequence[int], named: Callable[[str], int]) -> tuple[int, str, list[_Mode]]:
    """Line of the header, its text, and the ways to split it that find most of the names that are known."""
    found: list[tuple[tuple[int, bool, bool, int], str, _Mode]] = []
    for place, k in enumerate(filled[:SEARCHED]):
        for marked in (False, True) if _comment(lines[k]) else (False,):  # numpy.savetxt puts "# " before its header
            text = _unmarked(lines[k]) if marked else lines[k]
            open_quote = text.count('"') % 2 == 1  # a header of two lines
            for mode in _modes(" ".join([text, *lines[k + 1 : k + 5]]) if open_quote else text):
                cells = [cell.strip() for cell in mode.header([text, *lines[k + 1 : k + 5]])]
                if k > filled[0] and any(map(is_number, cells)):
                    continue  # data
                count = sum(map(named, cells))
                last = k + sum(cell.count("\n") for cell in cells)
                below = [lines[j] for j in filled[place + 1 : place + 8] if j > last][:2]  # perhaps a row of units
                if count:
                    found.append(((-count, not mode.fits(cells, below), marked, k), text, mode))
    if found:
        best, text, _ = min(found, key=lambda one: one[0])
        modes = [mode for rank, _, mode in found if (rank[0], *rank[2:]) == (best[0], *best[2:])]
        return best[-1], text, modes
    plain = [k for k in filled if not _comment(lines[k])] or list(filled)
    for k, after in itertools.pairwise(plain[:SEARCHED]):  # no name is known: as many names as numbers below
        for mode in _modes(lines[k]):
            cells = mode.header(lines[k:])
            if len(cells) > 1 and not any(map(is_number, cells)) and mode.fits(cells, [lines[after]]):
                return k, lines[k], [mode]
    first = lines[plain[0]]
    numbers = [mode for mode in _modes(first) if all(map(is_number, mode.header([first])))]
    return plain[0], first, [*numbers, *_modes(first)][:1]


def _modes(line: str) -> list[_Mode]:
    """Ways to split a line, the most probable first."""
    usual = sorted(DELIMITERS, key=lambda mark: (mark == "|", -line.count(mark)))
    present = [mark for mark in usual if mark in line]
    modes = [_Mode(mark) for mark in (present or usual[:1])]
    modes += [_Mode(mark, skip=True) for mark in present if '"' in line]
    return [*modes, _Mode("  "), _Mode("  ", " "), _Mode(" ")]


def _comment(line: str) -> bool:
    return line.lstrip("\ufeff \t\"'").startswith(MARKS)


def _unmarked(line: str) -> str:
    return line.lstrip("\ufeff \t\"'").lstrip("#%/;!*").strip().rstrip("\"'")


def _spaced(line: str, mode: str, *, names: bool = False) -> list[str]:
    """Cells between white space; quotes and the brackets of a unit hold it together."""
    if mode == "  ":
        return [cell.strip('"') for cell in re.split(r"\s{2,}|\t", line.strip())]
    words = re.findall(r'"[^"]*"|\S+', line if names else re.sub(r"\b([km]?N) m\b", r"\1m", line))
    cells: list[str] = []
    for word in words:
        opened = cells and any(narrow(cells[-1]).count(a) > narrow(cells[-1]).count(b) for a, b in _BRACKETS.items())
        if names and cells and (opened or narrow(word)[0] in _BRACKETS):
            cells[-1] += f" {word}"
        else:
            cells.append(word)
    return [cell.strip('"') if len(cell) > 1 else cell for cell in cells]


def _fitted(path: str | Path, mode: _Mode, lines: Sequence[str], short: bool) -> tuple[list[str], list[Row], list[str]]:
    """Header, rows of as many cells, and the numbers of lines that are comments or follow the last row."""
    try:
        cells = mode.table(lines)
    except csv.Error as error:
        raise ValueError(f"{path}: not a table of cells between {mode.delimiter!r} ({error})") from None
    first = next(line for line in lines if line.strip())
    header = [name.strip() for name in (mode.header([first]) if mode.spaced else mode.names(cells[0][1]))]
    body, comments = [], list[str]()
    ends = 1 + max((k for k, (_, row) in enumerate(cells) if len(row) == len(header)), default=0)
    for k, (number, row) in enumerate(cells[1:], 1):
        if len(row) == len(header):
            body.append((number, row))
            continue
        used = 1 + max(k for k, cell in enumerate(row) if cell.strip())
        row = row[: max(len(header), used)]  # delimiters at the end of a line
        words = used == 1 and not any(char.isdigit() for char in "".join(row))  # "End of data"
        if (_comment(row[0]) and (used == 1 or not short)) or (k >= ends > 1 and words and not short):
            comments.append(str(number))
            continue
        if short or not any(header[len(row) :]):
            row = row + [""] * (len(header) - len(row))
        if len(row) != len(header):
            hint = " (decimal commas? then separate cells by semicolons)" if mode.delimiter == "," else ""
            raise ValueError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}{hint}")
        body.append((number, row))
    return header, body, comments


def _with_units(path: str | Path, header: Sequence[str], body: Sequence[Row]) -> list[str] | None:
    """Header with the units of the row under it; None if that is no row of units."""
    if len(body) < 2:
        return None
    number, row = body[0]
    cells = [unbracketed(cell) for cell in row]
    units = [recognised(cell, UNITS) if cell else None for cell in cells]
    known, filled = sum(unit is not None for unit in units), sum(map(bool, cells))
    if any(map(is_number, cells)) or 2 * filled <= len(cells) or not (known > 1 or known > filled - known):
        return None
    merged = []
    for name, cell, unit in zip(header, cells, units):
        own = re.search(r"[\[(]([^\[\]()]*)[\])]$", narrow(name))
        said = recognised(own[1], UNITS) if own else None
        if said and not unit:
            return None  # a row without readings
        if unit and said and said != unit:
            raise ValueError(f"{path}: column {name!r}: row {number} says {cell!r}; remove one of the two units")
        merged.append(f"{name} [{cell}]" if unit and not said else name)
    return merged


def unbracketed(cell: str) -> str:
    """Return the unit in a cell such as "[deg]" or "(deg)"."""
    return narrow(cell).strip().strip("[](){}").strip()
