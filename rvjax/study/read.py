"""Studies read from TOML with units in strings; an error is one line that names key, value and unit."""

import dataclasses
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from rvjax import models
from rvjax.choices import meant
from rvjax.outputs import Output
from rvjax.population import COMMON, DISTRIBUTIONS
from rvjax.records import IN_ERROR_UNIT, Design, Shape, axis_sizes, remind_of_precision
from rvjax.sections import reader as sections_reader
from rvjax.study.about import parse_about
from rvjax.study.design import parse_design
from rvjax.study.identification import Identification, parse_identification
from rvjax.study.placed import refuse_unplaced, spelled
from rvjax.study.plausible import refuse_impossible
from rvjax.study.question import Study, StudyError
from rvjax.study.values import choice, integer, known, naming, naming_field, quantity, share, subtable
from rvjax.tolerances import COSTS, FEWEST, KINDS, Middle, Tolerance, check_middles, for_design
from rvjax.units import unit_of

TABLES = {"about", "accuracy", "columns", "conditions", "cost", "design", "identify", "middle"}
TABLES |= {"requirement", "run", "tolerances"}
EMBEDDED = resources.files("rvjax.study") / "embedded"


def load(source: str, *, solve: bool = True) -> Study:
    """A study from a TOML file, or an embedded one by name ("rv-40e").

    Args:
        source: path, or name.
        solve: also check that the unit without errors can be solved, which compiles the response; with outputs of
            `rvjax.loaded` at the first call of `Study.response`.

    Raises:
        StudyError: one line that names the key, its value and the unit.
        FileNotFoundError: neither a file nor an embedded study.
    """
    path = Path(source)
    if path.suffix == ".toml":
        try:
            text = path.read_text("utf-8-sig")  # Windows puts a byte order mark there
        except FileNotFoundError:
            raise FileNotFoundError(f"{source}: no such study file") from None
        except (OSError, UnicodeDecodeError) as error:
            raise StudyError(f"{source}: cannot be read as text in UTF-8 ({error})") from None
        return parse_study(text, name=path.stem, folder=path.parent, solve=solve)
    embedded = EMBEDDED / f"{source}.toml"
    if not embedded.is_file():
        names = embedded_names()
        near = meant(source, [*names, *([f"{source}.toml"] if Path(f"{source}.toml").is_file() else [])])
        raise FileNotFoundError(f"{source}{near}: neither a .toml file nor an embedded study ({', '.join(names)})")
    return parse_study(embedded.read_text("utf-8"), name=source, solve=solve)


def embedded_names() -> list[str]:
    """Names of the studies that come with rvjax."""
    return sorted(Path(file.name).stem for file in EMBEDDED.iterdir() if file.name.endswith(".toml"))


def parse_study(text: str, *, name: str, folder: Path = Path(), solve: bool = True) -> Study:
    """A study from TOML text.

    Args:
        text: TOML.
        name: short name for messages and result folders.
        folder: that files named in the study are relative to.
        solve: also check that the unit without errors can be solved, which compiles the response; with outputs of
            `rvjax.loaded` at the first call of `Study.response`.

    Raises:
        StudyError: one line that names the key, its value and the unit.
    """
    remind_of_precision()
    with naming(name):
        try:
            tables = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ValueError(f"not valid TOML: {error}") from None
        sections = {table: read for table in tables if table not in TABLES and (read := sections_reader(table))}
        known(tables, TABLES | set(sections) | models.tables(), "")
        for key in ("design", "tolerances", *(() if "identify" in tables else ("requirement",))):
            if not subtable(tables, key):
                raise ValueError(f"[{key}] is missing or empty")
        design = parse_design(subtable(tables, "design"))
        error_record = design.error_record
        tolerances = _tolerances(design, spelled(design, subtable(tables, "tolerances")), folder)
        costs = _costs(error_record, tolerances, subtable(tables, "cost"))
        run = subtable(tables, "run")
        known(run, {"seed", "samples", "certificate_samples", "joint_target"}, "run")
        kind = models.kind(design)
        asked = subtable(tables, "requirement")
        requirements = _requirements(kind.outputs, asked)
        identification = None
        if "identify" in tables:
            identification = parse_identification(
                subtable(tables, "identify"), subtable(tables, "columns"), design, tolerances,
                lambda table, unit, where: _tolerance(table, unit, where, folder),
            )  # fmt: skip
        elif "columns" in tables:
            raise ValueError("[columns]: names columns of measured data, but there is no [identify]")
        if requirements:
            refuse_unplaced(kind, tuple(requirements), tolerances)
        study = Study(
            name=name,
            text=text,
            design=design,
            conditions=_conditions(kind, requirements, identification, tables),
            tolerances=tolerances,
            costs=costs,
            requirements=requirements,
            read_in=_read_in(kind.outputs, asked),
            accuracy=_accuracy(kind.outputs, requirements, subtable(tables, "accuracy")),
            middles=_middles(error_record, tolerances, subtable(tables, "middle")),
            about=parse_about(subtable(tables, "about")),
            seed=integer(run.get("seed", 0), "run.seed", 0, 2**32 - 1),
            samples=integer(run.get("samples", 16384), "run.samples", FEWEST, 2**32),
            certificate_samples=integer(
                run.get("certificate_samples", 1_000_000), "run.certificate_samples", 16, 2**32
            ),
            joint_target=None if "joint_target" not in run else share(run["joint_target"], "run.joint_target"),
            identification=identification,
        )
        own = {table: read(subtable(tables, table), study) for table, read in sections.items()}
        study = dataclasses.replace(study, sections=own)
        refuse_impossible(design, tolerances, costs, study.middles)
        if requirements:
            response = study.response()  # raises an error for what these conditions cannot give
            if solve and response.compiler_options:  # takes seconds to compile: at the first `Study.response`
                return dataclasses.replace(study, to_solve=True)
    if requirements and solve:
        study.check_nominal()
    return study


def _metadata(record: Any, field: str) -> Any:
    return next(f.metadata for f in dataclasses.fields(record) if f.name == field)


def _conditions(
    kind: models.Kind, requirements: Mapping[str, Any], identification: Identification | None, tables: dict[str, Any]
) -> Any:
    fields = {f.name: f.metadata for f in dataclasses.fields(kind.conditions)}
    given = subtable(tables, "conditions")
    known(given, {name for name, about in fields.items() if not about["columns"]}, "conditions")
    given = given | {name: tables[name] for name in models.tables() if name in tables}
    read = set(kind.conditions_of(tuple(requirements)))
    if identification:
        read |= {f.name for f in dataclasses.fields(kind.observed[identification.model].conditions)}
    for key in sorted(given.keys() - read):
        readers = ", ".join(name for name in kind.outputs if key in kind.conditions_of((name,)))
        named = f"[[{key}]]" if key in tables else f"conditions.{key} = {given[key]!r}"
        raise ValueError(f"{named}: no response required here reads it, only {readers or 'those of another design'}")
    return kind.conditions(**{key: _condition(value, fields[key], key) for key, value in given.items()})


def _rows(value: object, columns: Mapping[str, str], where: str) -> tuple[tuple[float, ...], ...]:
    """Rows of a table, SI, in the order of its columns."""
    if not isinstance(value, list) or not value or not all(isinstance(row, dict) for row in value):
        raise ValueError(f"{where}: must be one or more tables [[{where}]] with {', '.join(columns)}")
    rows = []
    for number, row in enumerate(value):
        known(row, columns, f"{where}[{number}]")
        for key, unit in columns.items():
            if key not in row:
                raise ValueError(f"{where}[{number}].{key} is missing: every phase has one, in {unit}")
        rows.append(tuple(quantity(row[key], unit, f"{where}[{number}].{key}") for key, unit in columns.items()))
    return tuple(rows)


def _condition(value: object, about: Mapping[str, Any], key: str) -> Any:
    """A condition as it is declared by `outputs.condition`."""
    if about["columns"]:
        return _rows(value, about["columns"], key)
    where = f"conditions.{key}"
    if about["choices"] is not None:
        return choice(value, about["choices"], where)
    if about["unit"] is None:
        return integer(value, where, about["minimum"], about["maximum"])
    found = quantity(value, about["unit"], where)
    if about["minimum"] is not None and found < about["minimum"]:
        raise ValueError(f"{where} = {value!r}: must be at least {about['minimum']:g} {about['unit']}")
    if about["maximum"] is not None and found > about["maximum"]:
        raise ValueError(f"{where} = {value!r}: must be at most {about['maximum']:g} {about['unit']}")
    return found


def _tolerances(design: Design, table: dict[str, Any], folder: Path) -> Any:
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    known(table, fields, "tolerances")
    made = {}
    for field in table:
        where = f"tolerances.{field}"
        with naming_field(where):
            about, own = _metadata(design.error_record, field), dict(subtable(table, field))
            shape = _series(about["shape"], design.counts, own, where)
            made[field] = _tolerance(own, about["unit"], where, folder, shape)
    return for_design(design, **made)


def _series(axes: Shape, counts: Mapping[str, int], table: dict[str, Any], where: str) -> tuple[int, ...]:
    """Shape of a series, whose number of harmonics is taken out of its table; () where the design defines all sizes."""
    own = [axis for axis in axes if isinstance(axis, str) and axis not in counts]
    if not own:
        return ()
    if "harmonics" not in table:
        raise ValueError(f"{where}.harmonics is missing: an integer, the number of terms of the series")
    harmonics = integer(table.pop("harmonics"), f"{where}.harmonics", 1, 1000)
    return axis_sizes(axes, {**counts, **dict.fromkeys(own, harmonics)}, (0,) * len(axes))


def _tolerance(
    table: dict[str, Any], unit: str, where: str, folder: Path = Path(), shape: tuple[int, ...] = ()
) -> Tolerance:
    law = DISTRIBUTIONS[choice(table.get("distribution", "normal"), DISTRIBUTIONS, f"{where}.distribution")]
    known(table, {"lower", "upper", "half_width", "grade", "size", "distribution", *COMMON, *law.parameters()}, where)
    if "cp" in table and not law.capable:
        raise ValueError(f"{where}.cp = {table['cp']!r}: {law.name} ends at the limits, it has no capability")
    options: dict[str, Any] = {"distribution": law, "shape": shape}
    options |= {key: quantity(table[key], "-", f"{where}.{key}") for key in COMMON if key in table}
    for key in law.parameters():
        if key in table:
            value = table[key]
            if isinstance(value, dict) and isinstance(value.get("file"), str):
                value = value | {"file": str(folder / value["file"])}
            options[key] = law.parsed(key, value, unit)
    size = quantity(table["size"], "m", f"{where}.size") if "size" in table else None
    ways = [{"lower", "upper"}, {"half_width"}, {"grade", "size"}]
    given = set(table) & {"lower", "upper", "half_width", "grade"}
    chosen = next((way for way in ways if given and given == way - {"size"}), None)
    if chosen is None or (chosen == ways[2] and size is None):
        raise ValueError(f"{where}: give lower and upper, or half_width, or grade and size")
    if chosen == ways[2] and size is not None:
        if unit != "m":
            raise ValueError(f"{where}.grade = {table['grade']!r}: grades are for lengths, this error is in {unit}")
        return Tolerance.grade(table["grade"], size, **options)
    if size is not None and unit != "m":
        raise ValueError(f"{where}.size = {table['size']!r}: sizes are for lengths, this error is in {unit}")
    limits = {key: quantity(table[key], unit, f"{where}.{key}") for key in sorted(given)}
    if chosen == ways[1]:
        if limits["half_width"] < 0:
            raise ValueError(f"{where}.half_width = {table['half_width']!r}: must not be negative")
        return Tolerance.symmetric(limits["half_width"], size=size, **options)
    return Tolerance(limits["lower"], limits["upper"], size=size, **options)


def _costs(error_record: Any, tolerances: Any, table: dict[str, Any]) -> dict[str, Any]:
    costs = {}
    for field in table:
        where, entry = f"cost.{field}", dict(subtable(table, field))
        if field not in {f.name for f in dataclasses.fields(error_record)} or getattr(tolerances, field) is None:
            raise ValueError(f"{where}: there is no [tolerances.{field}] for it")
        law = COSTS[choice(entry.pop("model", "reciprocal_power"), COSTS, f"{where}.model")]
        declared = {f.name: f for f in dataclasses.fields(law)}  # type: ignore[arg-type]  # distributions are records
        known(entry, declared, where)
        units = {name: f.metadata["unit"] for name, f in declared.items()}
        units |= {n: _metadata(error_record, field)["unit"] for n, unit in units.items() if unit == IN_ERROR_UNIT}
        for key, f in declared.items():
            if f.default is dataclasses.MISSING and key not in entry:
                raise ValueError(f"{where}.{key} is missing: {f.metadata['meaning']}, in {units[key]}")
        with naming_field(where):
            costs[field] = law(**{key: _numbers(value, units[key], f"{where}.{key}") for key, value in entry.items()})
    return costs


def _numbers(value: object, unit: str, where: str) -> Any:
    """One number, or a list of them."""
    return [quantity(v, unit, where) for v in value] if isinstance(value, list) else quantity(value, unit, where)


def _middles(error_record: Any, tolerances: Any, table: dict[str, Any]) -> dict[str, Middle]:
    found = {}
    active = {f.name: t for f in dataclasses.fields(error_record) if (t := getattr(tolerances, f.name)) is not None}
    for name in table:
        where, entry = f"middle.{name}", subtable(table, name)
        if name not in active:
            raise ValueError(f"{where}: there is no [tolerances.{name}] for it")
        known(entry, {"lower", "upper", "cost", "per"}, where)
        unit = _metadata(error_record, name)["unit"]
        for key in ("lower", "upper", *(("per",) if "cost" in entry else ())):
            if key not in entry:
                raise ValueError(f"{where}.{key} is missing: a middle lies between lower and upper, in {unit}")
        given = {key: quantity(entry[key], "-" if key == "cost" else unit, f"{where}.{key}") for key in entry}
        per = given.get("per", 1.0)
        if per <= 0:
            raise ValueError(f"{where}.per = {entry['per']!r}: must be positive")
        with naming_field(where):
            found[name] = Middle(given["lower"], given["upper"], given.get("cost", 0.0) / per)
            check_middles({name: found[name]}, active)
    return found


def _accuracy(
    outputs: Mapping[str, Output], requirements: Mapping[str, Any], table: dict[str, Any]
) -> dict[str, float]:
    found = {}
    for name, value in table.items():
        where = f"accuracy.{name}"
        choice(name, requirements, f"{where}: response")
        found[name] = quantity(value, outputs[name].unit, where)
        if found[name] <= 0:
            raise ValueError(f"{where} = {value!r}: must be positive")
    return found


def _requirements(outputs: Mapping[str, Output], table: dict[str, Any]) -> dict[str, Any]:
    requirements = {}
    for name in table:
        where, entry = f"requirement.{name}", subtable(table, name)
        known(entry, {"response", *(key for kind in KINDS for key in kind.file_keys())}, where)
        response = choice(entry.get("response", name), outputs, f"{where}.response")
        if response in requirements:
            raise ValueError(f"{where}.response = {response!r}: already has a requirement")
        given = {key: value for key, value in entry.items() if key != "response"}
        unit = outputs[response].unit
        kinds = [kind for kind in KINDS if set(given) <= set(kind.file_keys()) and set(given) & set(kind.limit_keys())]
        if not kinds:
            ways = "; or ".join(", ".join(kind.file_keys()) for kind in KINDS)
            raise ValueError(f"{where}: give upper or lower in {unit} (of these keys: {ways})")
        values = {
            field: quantity(given[key], unit if key in kinds[0].limit_keys() else "-", f"{where}.{key}")
            for key, field in kinds[0].file_keys().items()
            if key in given
        }
        with naming_field(where):
            requirements[response] = kinds[0](**values)
    return requirements


def _read_in(outputs: Mapping[str, Output], table: dict[str, Any]) -> dict[str, str]:
    """The unit of the first limit of each response; limits are texts with units, they have been read before."""
    asked = {}
    for name, entry in table.items():
        response = entry.get("response", name)
        limits = (entry[key] for key in entry if any(key in kind.limit_keys() for kind in KINDS))
        if (unit := outputs[response].unit) != "-":
            asked[response] = unit_of(next(limits), unit)
    return asked
