"""Lines of the table [design]: every number with its unit and meaning, and what is assumed with its reason."""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rvjax import catalogue
from rvjax.designs import InvoluteStage, RVReducer
from rvjax.records import PyTree
from rvjax.study import (
    BASES,
    RATED,
    Assumed,
    Metadata,
    choice,
    comments,
    fields_of_kind,
    given_numbers,
    lacking,
    naming,
    quantity,
    rated_torque,
    shown,
    subtable,
    walk,
)
from rvjax.units import KNOWN

FOLLOWS = ("centre_distance", "sun_radius", "sun_base_radius", "planet_base_radius")  # of standard gears
FILE_PARTS = {"design", "conditions", "about"}


@dataclass(frozen=True)
class Known:
    """The reducer of a new study, as its source gives it.

    Attributes:
        name: of the known reducer, or of the file of the drawing.
        kind: of the design, as study files name it.
        numbers: given ones by path, SI.
        said: further comment of a number by its path, such as "assumed".
        torque: rated torque, N m, with its reason; None: of no catalogue.
        drawing: the numbers are those of a file.
        unread: tables of the file that are not taken over.
    """

    name: str
    kind: str
    numbers: Mapping[str, PyTree]
    said: Mapping[str, str]
    torque: Assumed | None
    drawing: bool = False
    unread: tuple[str, ...] = field(default_factory=tuple)


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
    rated = RATED.get(base.removesuffix("-whole"))
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
        if not table:
            raise ValueError('[design] is missing or empty: a drawing has kind = "rv" and its numbers')
        base, kind = table.get("base"), RVReducer.kind
        if base is None:
            choice(table.get("kind"), [kind], "design.kind")
        else:
            choice(base, [name for name, one in BASES.items() if isinstance(one, RVReducer)], "design.base")
        numbers = given_numbers(table)
        if missing := lacking(numbers):
            raise ValueError(f"[design] lacks {'; '.join(missing)}")
        said = dict.fromkeys(catalogue.assumed(str(base)), "assumed") if base else {}
        said |= comments(text)
        return Known(
            str(path), kind, numbers, said, _torque(subtable(tables, "conditions"), numbers), True, _unread(tables)
        )


def _torque(conditions: Mapping[str, object], numbers: Mapping[str, PyTree]) -> Assumed:
    for key in ("rated_torque", "output_torque"):
        if key in conditions:
            value = quantity(conditions[key], "N m", f"conditions.{key}")
            if value <= 0:
                raise ValueError(f"conditions.{key} = {conditions[key]!r}: must be positive")
            return Assumed(value, "as in the drawing")
    return rated_torque(numbers["cycloid.pin_circle_radius"])


def _unread(tables: Mapping[str, object]) -> tuple[str, ...]:
    return tuple(sorted(set(tables) - FILE_PARTS))


def lines(
    cls: type, given: Known, more: Mapping[str, Assumed], parts: Collection[str], *, only: bool = False
) -> Iterator[str]:
    """`key = value # meaning` of every number, with an empty line between parts.

    Args:
        cls: class of the design.
        given: numbers with a source.
        more: assumed numbers.
        parts: that are written.
        only: only parts with assumed numbers, as changes of a base.
    """
    numbers = {**given.numbers, **{path: item.value for path, item in more.items()}}
    standard, last, changed = _standard(numbers), "", {path.rpartition(".")[0] for path in more}
    for path, about, _ in fields_of_kind(cls):
        part = path.rpartition(".")[0]
        if (path.split(".")[0] not in parts and part) or path not in numbers or numbers[path] is None:
            continue
        if (only and part not in changed) or (standard and part == "involute" and path.split(".")[1] in FOLLOWS):
            continue
        if part != last:
            last = part
            yield ""
        item = more.get(path)
        meaning = str(about["meaning"])
        reason = item.why if item is not None else given.said.get(path, "").removeprefix(meaning).removeprefix("; ")
        value = _text(numbers[path], about, exact=item is None)
        yield f"{path} = {value} # {'; '.join(filter(None, [meaning, reason]))}"


def _standard(numbers: Mapping[str, PyTree]) -> bool:
    """True if the radii of the gears follow from teeth and module."""
    own = {path.partition(".")[2]: value for path, value in numbers.items() if path.startswith("involute.")}
    if not own:
        return False
    gears = own["module"], own["pressure_angle"]
    due = InvoluteStage.from_teeth(own["sun_teeth"], own["planet_teeth"], module=gears[0], pressure_angle=gears[1])
    return all(abs(own[name] / getattr(due, name) - 1) < 1e-3 for name in FOLLOWS)


def _text(value: PyTree, about: Metadata, *, exact: bool) -> str:
    if about["kind"] == "count":
        return str(value)
    if np.ndim(value):
        return f"[{', '.join(_text(float(item), about, exact=exact) for item in value)}]"
    if about["unit"] == "-":
        return str(value)
    return f'"{in_unit(float(value), about["unit"], 12 if exact else 4)}"'


def in_unit(value: float, unit: str, digits: int = 4) -> str:
    """A value in the unit in which it is at least one; a torsional stiffness per rad.

    Args:
        value: SI.
        unit: SI unit.
        digits: that are written.
    """
    name = unit if unit == "N m/rad" else shown(value, unit).split(" ", 1)[1]
    return f"{float(f'{value / KNOWN.get(unit, {}).get(name, 1.0):.{digits}g}'):.12g} {name}"
