"""Studies read from TOML with units in strings, and their text with other limits.

An error is one line that names key, value and unit. All text but that of the limits is unchanged.
"""

import dataclasses
import importlib
import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path

from rvjax import models
from rvjax._jax.checks import remind_of_precision
from rvjax.base.words import meant
from rvjax.records import Design, PyTree
from rvjax.running import OF_JOINT
from rvjax.study.design import given_paths, parse_design, refuse_impossible
from rvjax.study.goals import (
    parse_accuracy,
    parse_costs,
    parse_losses,
    parse_middles,
    parse_objective,
    parse_requirements,
    parse_variables,
)
from rvjax.study.identification import Identification, parse_identification
from rvjax.study.study import Study
from rvjax.study.tolerances import FORMS, RING, RING_FORMS, parse_tolerances, refuse_unplaced
from rvjax.study.values import (
    Toml,
    field_value,
    integer,
    known,
    naming,
    parse_about,
    share,
    subtable,
    tables_of,
    text_of,
)
from rvjax.tolerances import FEWEST, Limits, Nominal

TABLES = {"about", "accuracy", "columns", "conditions", "cost", "design", "identify", "middle"}
TABLES |= {"loss", "objective", "requirement", "run", "tolerances", "variable"}
RUN = {"seed": (0, 2**32 - 1), "samples": (FEWEST, 2**32), "certificate_samples": (16, 2**32)}
"""Least and largest value of each integer of the table [run]."""
Reader = Callable[[Mapping[str, object], Study], object]
"""Reads a table that only one command has."""
EMBEDDED = resources.files("rvjax.study") / "embedded"


def load(source: str, *, solve: bool = True, needs: Sequence[str] | None = None) -> Study:
    """A study from a TOML file, or an embedded one by name ("rv-40e").

    Args:
        source: path, or name.
        solve: also check that the unit without errors can be solved, which compiles the response; with outputs of
            `rvjax.loaded` at the first call of `Study.response`.
        needs: tables that must be there; None: [design], [tolerances], and [requirement] or [identify].

    Raises:
        StudyError: one line that names the key, its value and the unit.
        FileNotFoundError: neither a file nor an embedded study.
    """
    path = Path(source)
    if path.suffix == ".toml":
        text = text_of(path, source, "study")
        return parse_study(text, name=path.stem, folder=path.parent, solve=solve, needs=needs)
    embedded = EMBEDDED / f"{source}.toml"
    if not embedded.is_file() and path.is_dir():
        own = path / "study.toml"
        found = f"its study is {own}" if own.is_file() else "it contains no study.toml"
        raise FileNotFoundError(f"{source}: is a folder; {found}")
    if not embedded.is_file():
        names = embedded_names()
        near = meant(source, [*names, *([f"{source}.toml"] if Path(f"{source}.toml").is_file() else [])])
        raise FileNotFoundError(f"{source}{near}: neither a .toml file nor an embedded study ({', '.join(names)})")
    return parse_study(embedded.read_text("utf-8"), name=source, solve=solve, needs=needs)


def embedded_names() -> list[str]:
    """Names of the studies that come with rvjax."""
    return sorted(Path(file.name).stem for file in EMBEDDED.iterdir() if file.name.endswith(".toml"))


def parse_study(
    text: str, *, name: str, folder: Path = Path(), solve: bool = True, needs: Sequence[str] | None = None
) -> Study:
    """A study from TOML text.

    Args:
        text: TOML.
        name: short name for messages and result folders.
        folder: that files named in the study are relative to.
        solve: also check that the unit without errors can be solved, which compiles the response; with outputs of
            `rvjax.loaded` at the first call of `Study.response`.
        needs: tables that must be there; None: [design], [tolerances], and [requirement] or [identify].

    Raises:
        StudyError: one line that names the key, its value and the unit.
    """
    remind_of_precision()
    with naming(name):
        tables = tables_of(text)
        sections = _sections(tables, needs)
        study = _study(name, text, folder, tables)
        if study.columns and study.identification is None and needs is None:
            raise ValueError("[columns]: names columns of measured data, but there is no [identify]")
        own = {table: read(subtable(tables, table), study) for table, read in sections.items()}
        study = dataclasses.replace(study, sections=own)
        refuse_impossible(study.design, study.tolerances, study.costs, study.middles)
        if study.requirements:
            response = study.response()  # raises an error for what these conditions cannot give
            if solve and response.compiler_options:  # takes seconds to compile: at the first `Study.response`
                return dataclasses.replace(study, to_solve=True)
    if study.requirements and solve:
        study.check_nominal()
    return study


def _sections(tables: Mapping[str, object], needs: Sequence[str] | None) -> dict[str, Reader]:
    """Readers of the tables of commands; raises ValueError for an unknown table, or for one that is missing."""
    sections = {table: read for table in tables if table not in TABLES and (read := _of_command(table))}
    known(tables, TABLES | set(sections) | models.tables(), "")
    usual = ("design", "tolerances", *(() if "identify" in tables else ("requirement",)))
    for key in usual if needs is None else needs:
        if not subtable(tables, key):
            raise ValueError(f"[{key}] is missing or empty")
    return sections


def _of_command(table: str) -> Reader | None:
    """Reader of a table; by the name of its module, because an import would be a look upwards."""
    read: Reader | None = importlib.import_module("rvjax.commands").section(table)
    return read


def _study(name: str, text: str, folder: Path, tables: Mapping[str, object]) -> Study:
    """The study of these tables, without those of commands."""
    table = {key: subtable(tables, key) for key in TABLES}
    design = parse_design(table["design"])
    kind = models.kind(design)
    tolerances = parse_tolerances(design, table["tolerances"], folder)
    costs = parse_costs(table["cost"], tolerances)
    run = _run(table["run"])
    limits, read_in = parse_requirements(table["requirement"], kind.outputs)
    nominal = {name: item for name, item in limits.items() if isinstance(item, Nominal)}
    requirements = {name: item for name, item in limits.items() if name not in nominal}
    variables = parse_variables(table["variable"], design, given_paths(table["design"]))
    objective, losses = parse_objective(table["objective"], kind.outputs), parse_losses(table["loss"], kind.outputs)
    identification = None
    if "identify" in tables:
        identification = parse_identification(table["identify"], design, tolerances, folder)
    if requirements:
        refuse_unplaced(kind, tuple(dict.fromkeys((*requirements, *losses))), tolerances)
    outputs = tuple(dict.fromkeys((*limits, *objective, *losses)))
    return Study(
        name=name,
        text=text,
        design=design,
        conditions=_conditions(design, outputs, identification, tables),
        tolerances=tolerances,
        costs=costs,
        requirements=requirements,
        read_in=read_in,
        accuracy=parse_accuracy(table["accuracy"], kind.outputs, requirements),
        middles=parse_middles(table["middle"], tolerances, variables),
        about=parse_about(table["about"]),
        identification=identification,
        columns=table["columns"],
        variables=variables,
        objective=objective,
        nominal=nominal,
        losses=losses,
        **run,
    )


def _run(table: Toml) -> dict[str, PyTree]:
    """Values of the table [run]."""
    known(table, {*RUN, "joint_target"}, "run")
    run: dict[str, PyTree] = {key: integer(table[key], f"run.{key}", *RUN[key]) for key in RUN if key in table}
    return run | ({"joint_target": share(table["joint_target"], "run.joint_target")} if "joint_target" in table else {})


def _conditions(
    design: Design, outputs: tuple[str, ...], identification: Identification | None, tables: Mapping[str, object]
) -> PyTree:
    kind = models.kind(design)
    fields = {f.name: f.metadata for f in dataclasses.fields(kind.conditions)}
    given = subtable(tables, "conditions")
    known(given, {name for name, about in fields.items() if not about["columns"]}, "conditions")
    given = given | {name: tables[name] for name in models.tables() if name in tables}
    read = set(kind.conditions_of(outputs)) if outputs or identification else set(fields)  # of a design alone
    if getattr(design, "friction", None) is not None:
        read |= set(OF_JOINT)  # `rvjax export`
    if kind.costly(outputs):  # a loaded study lists what it does not limit
        read |= set(kind.conditions_of(tuple(kind.usual)))
    if identification:
        read |= {f.name for f in dataclasses.fields(kind.observed[identification.model].conditions)}
    where = {key: key if key in tables else f"conditions.{key}" for key in given}
    for key in sorted(given.keys() - read):
        readers = ", ".join(name for name in kind.outputs if key in kind.conditions_of((name,)))
        named = f"[[{key}]]" if key in tables else f"{where[key]} = {given[key]!r}"
        raise ValueError(f"{named}: no response required here reads it, only {readers or 'those of another design'}")
    return kind.conditions(**{key: field_value(value, fields[key], where[key]) for key, value in given.items()})


_LIMITS = ("half_width", "lower", "upper", "grade", *FORMS)  # keys that say where the limits of an error are
Parts = list[str | dict[str, PyTree]]
_Gaps = dict[tuple[str, ...], tuple[str, int]]
"""{names of the header and of the key: (kind of the gap, its number)}"""


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
        where, keys = (RING, (form.word,)) if form is not None and form.word in ring else (name, _LIMITS)
        gaps |= {("tolerances", where, key): ("field", k) for key in keys}
    responses = list(requirements)
    for key, entry in tables["requirement"].items():
        if (name := entry.get("response", key)) not in requirements:
            continue  # of the nominal design: no unit decides it
        for end in ("lower", "upper"):
            gaps["requirement", key, requirements[name].prefix + end] = "response", responses.index(name)
    for written in (text, canonical(tables)):
        parts = _with_gaps(written, gaps)
        if _fits(parts, tables, gaps):
            return parts
    return None


def _with_gaps(text: str, gaps: _Gaps) -> Parts:
    parts: Parts = []
    header: tuple[str, ...] = ()
    made: dict[tuple[str, int], dict[str, PyTree]] = {}
    for line in (f"{line}\n" for line in text.removesuffix("\n").split("\n")):
        header = _header(line) if line.lstrip().startswith("[") else header
        key = re.match(r"\s*([\w-]+)\s*=", line)
        gap = gaps.get((*header, key[1])) if key else None
        if gap is not None:
            if gap not in made:
                made[gap] = {gap[0]: gap[1], "own": ""}
                parts.append(made[gap])
            made[gap]["own"] += line
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
    if sum(not isinstance(part, str) for part in parts) != len(set(gaps.values())):
        return False
    try:
        written = (p if isinstance(p, str) else f"{_filled(*next(iter(p.items())))} = 0\n" for p in parts)
        filled = tomllib.loads("".join(written))
    except tomllib.TOMLDecodeError:
        return False
    for table, name in {(table, name) for table, name, _ in gaps}:
        entry = tables[table].get(name)
        if entry is None:
            return False
        moved = {key: gap for (*where, key), gap in gaps.items() if where == [table, name]}
        expected = {key: value for key, value in entry.items() if key not in moved}
        if filled.get(table, {}).get(name) != expected | {_filled(*gap): 0 for gap in moved.values()}:
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
