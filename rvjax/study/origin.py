"""Origin of each value of a design: the study, the published reducer it begins with, or other numbers."""

import dataclasses
import re

from rvjax import catalogue
from rvjax._reducer.plausible import walk
from rvjax.records import PyTree
from rvjax.study.kinds import kind_of, number_at
from rvjax.study.values import Toml


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of a design.

    Attributes:
        path: in the design, such as "cycloid.pin_count".
        value: SI, or a count.
        unit: SI unit, "-" for none.
        meaning: of the field.
        origin: where it comes from, in words.
        assumed: true if its source, or the study, marks it as not published.
    """

    path: str
    value: PyTree
    unit: str
    meaning: str
    origin: str
    assumed: bool


def design_numbers(design: PyTree, given: Toml, text: str) -> list[Number]:
    """Numbers of a design with their origin.

    Args:
        design: the reducer.
        given: the table [design] of its study.
        text: of the study, whose comments may say that a number is assumed.
    """
    base = str(given.get("base", ""))
    sources, own = catalogue.sources(base), comments(text)
    published = catalogue.BASES.get(base)
    kind, found, stated = kind_of(design), [], given_paths(given)
    for path, value, about in walk(design):
        # A number that is neither given nor the published one has followed from others.
        kept = published is not None and path in sources and _same(value, number_at(published, path))
        if path in stated:
            origin, said = "this study", own.get(path, "")
        elif (derived := kind.derivation(design, path, value)) and not (kept and stated.isdisjoint(kind.derived_from)):
            origin, said = derived, ""
        elif kept:
            said = sources[path]
            origin = f"{base}: {said}" if said else base
        else:
            origin, said = "default", ""
        found.append(Number(path, value, about["unit"], about["meaning"], origin, is_assumed(said)))
    return found


def comments(text: str, table: str = "design") -> dict[str, str]:
    """The comment at each key of a table in a study file, by its path; that of its header if it says "assumed".

    Args:
        text: of the study.
        table: such as "design" or "requirement".
    """
    found, section, heading = dict[str, str](), "", ""
    for line in text.splitlines():
        if header := re.match(r"\s*\[([^\]]*)\]\s*(?:#\s*(.*))?", line):
            section, heading = header[1].strip(), header[2] or ""
        elif section.split(".")[0] == table and (key := re.match(r"\s*([\w.-]+)\s*=[^#]*(?:#\s*(.*))?$", line)):
            path = ".".join([*section.split(".")[1:], key[1]])
            found[path] = "; ".join(filter(None, [key[2], heading if heading.startswith("assumed") else ""]))
    return found


def is_assumed(text: str) -> bool:
    """True if a comment marks a value as not published."""
    return bool(catalogue.ASSUMED.search(text))


def _same(value: PyTree, other: PyTree) -> bool:
    return other is not None and bool((value == other) if not hasattr(value, "shape") else (value == other).all())


def given_paths(table: Toml, prefix: str = "") -> set[str]:
    """Paths of the numbers that a table [design] gives."""
    found = set[str]()
    for key, value in table.items():
        found |= given_paths(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found
