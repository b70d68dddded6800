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
    rated = kind_of(design).rated.get(base)
    torque = None if rated is None else Assumed(rated, "rated torque of the catalogue")
    return Known(base, design.kind, numbers, said, torque)


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
        drawn = {kind.design.kind: kind for kind in KINDS.values() if kind.needed}  # type: ignore[attr-defined]
        if not table:
            words = " or ".join(f'"{name}"' for name in drawn)
            raise ValueError(f"[design] is missing or empty: a drawing has kind = {words} and its numbers")
        if (base := table.get("base")) is None:
            name = choice(table.get("kind"), drawn, "design.kind")
        else:
            bases = {base: name for name, kind in drawn.items() for base in kind.bases}
            name = bases[choice(base, bases, "design.base")]
        numbers, kind = given_numbers(table), drawn[name]
        if missing := _lacking(kind, numbers):
            raise ValueError(f"[design] lacks {'; '.join(missing)}")
        said = dict.fromkeys(catalogue.assumed(str(base)), "assumed") if base else {}
        said |= comments(text)
        torque = _torque(subtable(tables, "conditions")) or kind.torque(numbers)
        return Known(str(path), name, numbers, said, torque, True, _unread(tables))


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


def _unread(tables: Mapping[str, object]) -> tuple[str, ...]:
    return tuple(sorted(set(tables) - FILE_PARTS))


def lines(
    kind: Kind, given: Known, more: Mapping[str, Assumed], parts: Collection[str], *, only: bool = False
) -> Iterator[str]:
    """`key = value # meaning` of every number, with an empty line between parts.

    Args:
        kind: of the design.
        given: numbers with a source.
        more: assumed numbers.
        parts: that are written.
        only: only parts with assumed numbers, as changes of a base.
    """
    numbers = {**given.numbers, **{path: item.value for path, item in more.items()}}
    implied, last, changed = kind.implied(numbers), "", {path.rpartition(".")[0] for path in more}
    for path, about, _ in fields_of_kind(kind.design):
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
    if np.ndim(value):
        return f"[{', '.join(_text(float(item), about, exact=exact) for item in value)}]"
    if about["unit"] == "-":
        return str(value)
    return f'"{in_unit(float(value), about["unit"], 12 if exact else 4)}"'
