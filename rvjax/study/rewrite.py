"""The text of a study with other limits; all other text is unchanged."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence

from rvjax.records import PyTree
from rvjax.study.tolerances import FORMS, RING, RING_FORMS
from rvjax.study.values import tables_of
from rvjax.tolerances import Limits

_LIMITS = ("half_width", "lower", "upper", "grade", *FORMS)  # keys that say where the limits of an error are
Parts = list[str | dict[str, PyTree]]
_Gaps = dict[tuple[str, ...], list[tuple[str, int, tuple[str, ...]]]]
"""{names of the header: [(kind of gap, its number, keys that go into it)]}"""


def template(text: str, requirements: Mapping[str, Limits], fields: Sequence[str]) -> Parts | None:
    """A study's text with gaps for limits: strings, and {"field" or "response": number, "own": its own lines}.

    A file that says its tables in another way than with a header each, or a key over several lines, is rewritten.
    None if that fails.

    Args:
        text: of the study.
        requirements: by name of the response.
        fields: names of the errors that may change, in their order.
    """
    tables = tables_of(text)
    ring = tables["tolerances"].get(RING, {})
    gaps: _Gaps = {}
    for k, name in enumerate(fields):
        form = RING_FORMS.get(name)
        ringed = form is not None and form.word in ring
        where = "tolerances", RING if ringed else name
        gaps.setdefault(where, []).append(("field", k, (form.word,) if form is not None and ringed else _LIMITS))
    responses = list(requirements)
    for key, entry in tables["requirement"].items():
        if (name := entry.get("response", key)) not in requirements:
            continue  # of the nominal design: no unit decides it
        keys = tuple(requirements[name].prefix + end for end in ("lower", "upper"))
        gaps["requirement", key] = [("response", responses.index(name), keys)]
    for written in (text, canonical(tables)):
        parts = _with_gaps(written, gaps)
        if _fits(parts, tables, gaps):
            return parts
    return None


def _with_gaps(text: str, gaps: _Gaps) -> Parts:
    parts: Parts = []
    here: dict[str, tuple[str, int]] = {}  # kind and number of the gap of each key in this table
    made: dict[tuple[str, int], dict[str, PyTree]] = {}
    for line in (f"{line}\n" for line in text.removesuffix("\n").split("\n")):
        if line.lstrip().startswith("["):
            here = {key: (kind, number) for kind, number, keys in gaps.get(_header(line), []) for key in keys}
            made = {}
        key = re.match(r"\s*([\w-]+)\s*=", line)
        if key and key[1] in here:
            kind, number = here[key[1]]
            if (kind, number) not in made:
                made[kind, number] = {kind: number, "own": ""}
                parts.append(made[kind, number])
            made[kind, number]["own"] += line
        elif parts and isinstance(last := parts[-1], str):
            parts[-1] = last + line
        else:
            parts.append(line)
    return parts


def _header(line: str) -> tuple[str, ...]:
    """Names of the header of a table; none for another line that begins so."""
    try:
        table: PyTree = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return ()
    names = []
    while isinstance(table, dict) and table:
        name, table = next(iter(table.items()))
        names.append(name)
    return tuple(names)


def _fits(parts: Parts, tables: Mapping[str, PyTree], gaps: _Gaps) -> bool:
    """True if every gap occurs once and filling it replaces only the limits."""
    if sum(not isinstance(part, str) for part in parts) != sum(map(len, gaps.values())):
        return False
    try:
        written = (p if isinstance(p, str) else f"{_filled(*next(iter(p.items())))} = 0\n" for p in parts)
        filled = tomllib.loads("".join(written))
    except tomllib.TOMLDecodeError:
        return False
    for (table, name), own in gaps.items():
        entry = tables[table].get(name)
        if entry is None:
            return False
        moved = {key for _, _, keys in own for key in keys}
        expected = {key: value for key, value in entry.items() if key not in moved}
        if filled.get(table, {}).get(name) != expected | {_filled(kind, number): 0 for kind, number, _ in own}:
            return False
        filled[table][name] = entry
    return filled == tables


def _filled(kind: str, number: int) -> str:
    return f"filled-{kind}-{number}"


def canonical(tables: Mapping[str, PyTree]) -> str:
    """Tables of a study as TOML, a header for each table of two names."""
    lines = []
    for name, table in tables.items():
        if isinstance(table, list):
            for row in table:
                lines += [f"[[{name}]]", *(f"{_key(key)} = {_value(value)}" for key, value in row.items()), ""]
            continue
        plain = {key: value for key, value in table.items() if name in ("design", "run") or not isinstance(value, dict)}
        if plain:
            lines += [f"[{name}]", *(f"{_key(key)} = {_value(value)}" for key, value in plain.items()), ""]
        for key, entry in table.items():
            if key not in plain:
                lines += [f"[{name}.{_key(key)}]", *(f"{_key(k)} = {_value(v)}" for k, v in entry.items()), ""]
    return "\n".join(lines)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name)


def _value(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, (str, bool)):  # JSON's escapes are TOML's, but for the one below
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
