"""Lines of the table [design]: every number with its unit and meaning, and what is assumed with its reason."""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from rvjax import catalogue
from rvjax.records import PyTree
from rvjax.study import (
    BASES,
    KINDS,
    Assumed,
    Kind,
    Known,
    Metadata,
    choice,
    comments,
    fields_of_kind,
    given_numbers,
    in_unit,
    kind_of,
    naming,
    quantity,
    subtable,
    walk,
)

FILE_PARTS = {"design", "conditions", "about"}


def known(base: str) -> Known:
    """A known reducer by its name, or the reducer of a drawing.

    Args:
        base: name, or path of a TOML file with a table [design].

    Raises:
        ValueError: an unknown name, a wrong value, or a number that is missing; one line.
    """
    if base.endswith(".toml"):
        return _drawn(Path(base))
    design: PyTree = BASES[choice(base, BASES, "--base")]
    numbers = {path: value for path, value, _ in walk(design)}
    said = dict.fromkeys(catalogue.assumed(base), "assumed")
    kind = kind_of(design)
    torque = Assumed(kind.rated[base], "rated torque of the catalogue") if base in kind.rated else None
    return Known(base, kind, numbers, said, torque)


def _drawn(path: Path) -> Known:
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"--base {path}: cannot be read ({error})") from None
    with naming(str(path)):
        try:
            tables = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ValueError(f"not valid TOML: {error}") from None
        table = subtable(tables, "design")
        drawn = {kind.word: kind for kind in KINDS.values() if kind.needed}
        if not table:
            words = " or ".join(f'"{name}"' for name in drawn)
            raise ValueError(f"[design] is missing or empty: a drawing has kind = {words} and its numbers")
        if (base := table.get("base")) is None:
            kind = drawn[choice(table.get("kind"), drawn, "design.kind")]
        else:
            bases = {name: kind for kind in drawn.values() for name in kind.bases}
            kind = bases[choice(base, bases, "design.base")]
        numbers = given_numbers(table)
        if missing := _lacking(kind, numbers):
            raise ValueError(f"[design] lacks {'; '.join(missing)}")
        said = dict.fromkeys(catalogue.assumed(str(base)), "assumed") if base else {}
        said |= comments(text)
        torque = _torque(subtable(tables, "conditions")) or kind.torque(numbers)
        return Known(str(path), kind, numbers, said, torque, True, tuple(sorted(set(tables) - FILE_PARTS)))


def _lacking(kind: Kind, numbers: Mapping[str, PyTree]) -> list[str]:
    """Numbers that a drawing must have and that these lack, with their meaning, a line each."""
    about = {path: metadata for path, metadata, _ in fields_of_kind(kind.design)}
    units = {path: "" if about[path]["unit"] == "-" else f", in {about[path]['unit']}" for path in kind.needed}
    return [f"{path} ({about[path]['meaning']}{units[path]})" for path in kind.needed if path not in numbers]


def _torque(conditions: Mapping[str, object]) -> Assumed | None:
    for key in ("rated_torque", "output_torque"):
        if key in conditions:
            value = quantity(conditions[key], "N m", f"conditions.{key}")
            if value <= 0:
                raise ValueError(f"conditions.{key} = {conditions[key]!r}: must be positive")
            return Assumed(value, "as in the drawing")
    return None


def lines(given: Known, more: Mapping[str, Assumed], parts: Collection[str], *, only: bool = False) -> Iterator[str]:
    """`key = value # meaning` of every number, with an empty line between parts.

    Args:
        given: numbers with a source.
        more: assumed numbers.
        parts: that are written.
        only: only parts with assumed numbers, as changes of a base.
    """
    numbers = {**given.numbers, **{path: item.value for path, item in more.items()}}
    implied, last, changed = given.kind.implied(numbers), "", {path.rpartition(".")[0] for path in more}
    for path, about, _ in fields_of_kind(given.kind.design):
        part = path.rpartition(".")[0]
        if (path.split(".")[0] not in parts and part) or path not in numbers or numbers[path] is None:
            continue
        if (only and part not in changed) or path in implied:
            continue
        if part != last:
            last = part
            yield ""
        item = more.get(path)
        meaning = str(about["meaning"])
        reason = item.why if item is not None else given.said.get(path, "").removeprefix(meaning).removeprefix("; ")
        value = _text(numbers[path], about, exact=item is None)
        yield f"{path} = {value} # {'; '.join(filter(None, [meaning, reason]))}"


def _text(value: PyTree, about: Metadata, *, exact: bool) -> str:
    if about["kind"] == "count":
        return str(value)
    if about["kind"] == "text":
        return f'"{value}"'
    if np.ndim(value):
        return f"[{', '.join(_text(float(item), about, exact=exact) for item in value)}]"
    if about["unit"] == "-":
        return str(value)
    return f'"{in_unit(float(value), about["unit"], 12 if exact else 4)}"'
