"""Studies read from TOML with units in strings; an error is one line that names key, value and unit."""

import dataclasses
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from rvjax import models
from rvjax._reducer.deviations import remind_of_precision
from rvjax.base.sections import reader as sections_reader
from rvjax.base.words import meant
from rvjax.outputs import Output
from rvjax.records import IN_ERROR_UNIT, Design, PyTree
from rvjax.running import OF_JOINT
from rvjax.study.design import parse_design
from rvjax.study.identification import Identification, parse_identification
from rvjax.study.origin import given_paths
from rvjax.study.plausible import refuse_impossible
from rvjax.study.study import Study, StudyError, parse_about
from rvjax.study.toleranced import metadata, parse_tolerances, refuse_unplaced
from rvjax.study.values import (
    Metadata,
    Toml,
    choice,
    integer,
    known,
    naming,
    naming_field,
    quantities,
    quantity,
    share,
    subtable,
)
from rvjax.study.variables import parse_objective, parse_variables
from rvjax.tolerances import COSTS, FEWEST, KINDS, Cost, Limits, Middle, Nominal, QuadraticLoss, check_middles
from rvjax.units import point_for, unit_of

TABLES = {"about", "accuracy", "columns", "conditions", "cost", "design", "identify", "middle"}
TABLES |= {"loss", "objective", "requirement", "run", "tolerances", "variable"}
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
        try:
            text = path.read_text("utf-8-sig")  # Windows puts a byte order mark there
        except FileNotFoundError:
            raise FileNotFoundError(f"{source}: no such study file") from None
        except (OSError, UnicodeDecodeError) as error:
            raise StudyError(f"{source}: cannot be read as text in UTF-8 ({error})") from None
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
        try:
            tables = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ValueError(f"not valid TOML: {error}{_decimal_comma(text, str(error))}") from None
        sections = {table: read for table in tables if table not in TABLES and (read := sections_reader(table))}
        known(tables, TABLES | set(sections) | models.tables(), "")
        usual = ("design", "tolerances", *(() if "identify" in tables else ("requirement",)))
        for key in usual if needs is None else needs:
            if not subtable(tables, key):
                raise ValueError(f"[{key}] is missing or empty")
        design = parse_design(subtable(tables, "design"))
        error_record = design.error_record
        tolerances = parse_tolerances(design, subtable(tables, "tolerances"), folder)
        costs = _costs(error_record, tolerances, subtable(tables, "cost"))
        run = subtable(tables, "run")
        known(run, {"seed", "samples", "certificate_samples", "joint_target"}, "run")
        kind = models.kind(design)
        limited, read_in = _requirements(kind.outputs, subtable(tables, "requirement"))
        nominal = {name: item for name, item in limited.items() if isinstance(item, Nominal)}
        requirements = {name: item for name, item in limited.items() if name not in nominal}
        variables = parse_variables(subtable(tables, "variable"), design, given_paths(subtable(tables, "design")))
        objective = parse_objective(subtable(tables, "objective"), kind.outputs)
        losses = _losses(kind.outputs, subtable(tables, "loss"))
        identification, columns = None, subtable(tables, "columns")
        if "identify" in tables:
            identification = parse_identification(subtable(tables, "identify"), columns, design, tolerances, folder)
        elif columns and needs is None:
            raise ValueError("[columns]: names columns of measured data, but there is no [identify]")
        if requirements:
            refuse_unplaced(kind, tuple(dict.fromkeys((*requirements, *losses))), tolerances)
        wanted = tuple(dict.fromkeys((*limited, *objective, *losses)))
        study = Study(
            name=name,
            text=text,
            design=design,
            conditions=_conditions(design, wanted, identification, tables),
            tolerances=tolerances,
            costs=costs,
            requirements=requirements,
            read_in=read_in,
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
            columns=columns,
            variables=variables,
            objective=objective,
            nominal=nominal,
            losses=losses,
        )
        for path in variables:
            if (field := path.rpartition(".")[2]) in study.middles:
                raise ValueError(f'variable."{path}": [middle.{field}] moves the same number; give only one')
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


def _decimal_comma(text: str, error: str) -> str:
    """Hint for a line of TOML that is invalid because of a decimal comma, else ""."""
    place = re.search(r"at line (\d+)", error)
    line = text.splitlines()[int(place[1]) - 1] if place else ""
    number = re.search(r"=\s*([-+]?\d+,\d+)", line)
    return point_for(number[1]) if number else ""


def _conditions(
    design: Design, outputs: tuple[str, ...], identification: Identification | None, tables: Toml
) -> PyTree:
    kind = models.kind(design)
    fields = {f.name: f.metadata for f in dataclasses.fields(kind.conditions)}
    given = subtable(tables, "conditions")
    known(given, {name for name, about in fields.items() if not about["columns"]}, "conditions")
    given = given | {name: tables[name] for name in models.tables() if name in tables}
    read = set(kind.conditions_of(outputs)) if outputs or identification else set(fields)  # of a design alone
    if getattr(design, "friction", None) is not None:
        read |= set(OF_JOINT)  # `rvjax export`
    if any(map(kind.costly, outputs)):  # a loaded study lists what it does not limit
        read |= set(kind.conditions_of(tuple(kind.usual)))
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


def _condition(value: object, about: Metadata, key: str) -> PyTree:
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


def _costs(error_record: PyTree, tolerances: PyTree, table: Toml) -> dict[str, Cost]:
    costs: dict[str, Cost] = {}
    for field in table:
        where, entry = f"cost.{field}", dict(subtable(table, field))
        if field not in {f.name for f in dataclasses.fields(error_record)} or getattr(tolerances, field) is None:
            raise ValueError(f"{where}: there is no [tolerances.{field}] for it")
        law = COSTS[choice(entry.pop("model", "reciprocal_power"), COSTS, f"{where}.model")]
        declared = {f.name: f for f in dataclasses.fields(law)}
        known(entry, declared, where)
        units = {name: f.metadata["unit"] for name, f in declared.items()}
        units |= {n: metadata(error_record, field)["unit"] for n, unit in units.items() if unit == IN_ERROR_UNIT}
        for key, f in declared.items():
            if f.default is dataclasses.MISSING and key not in entry:
                raise ValueError(f"{where}.{key} is missing: {f.metadata['meaning']}, in {units[key]}")
        with naming_field(where):
            costs[field] = law(**{key: quantities(value, units[key], f"{where}.{key}") for key, value in entry.items()})
    return costs


def _middles(error_record: PyTree, tolerances: PyTree, table: Toml) -> dict[str, Middle]:
    found = {}
    active = {f.name: t for f in dataclasses.fields(error_record) if (t := getattr(tolerances, f.name)) is not None}
    for name in table:
        where, entry = f"middle.{name}", subtable(table, name)
        if name not in active:
            raise ValueError(f"{where}: there is no [tolerances.{name}] for it")
        known(entry, {"lower", "upper", "cost", "per"}, where)
        unit = metadata(error_record, name)["unit"]
        for key in ("lower", "upper", *(("per",) if "cost" in entry else ())):
            if key not in entry:
                raise ValueError(f"{where}.{key} is missing: a mid-point lies between lower and upper, in {unit}")
        given = {key: quantity(entry[key], "-" if key == "cost" else unit, f"{where}.{key}") for key in entry}
        per = given.get("per", 1.0)
        if per <= 0:
            raise ValueError(f"{where}.per = {entry['per']!r}: must be positive")
        with naming_field(where):
            found[name] = Middle(given["lower"], given["upper"], given.get("cost", 0.0) / per)
            check_middles({name: found[name]}, active)
    return found


def _accuracy(outputs: Mapping[str, Output], requirements: Mapping[str, Limits], table: Toml) -> dict[str, float]:
    found = {}
    for name, value in table.items():
        where = f"accuracy.{name}"
        choice(name, requirements, f"{where}: response")
        found[name] = quantity(value, outputs[name].unit, where)
        if found[name] <= 0:
            raise ValueError(f"{where} = {value!r}: must be positive")
    return found


def _losses(outputs: Mapping[str, Output], table: Toml) -> dict[str, QuadraticLoss]:
    """The tables [loss.OUTPUT] as losses by output."""
    found = {}
    for name, given in table.items():
        where = f"loss.{name}"
        choice(name, outputs, f"{where}: response")
        if not isinstance(given, dict):
            raise ValueError(
                f'{where} = {given!r}: must be a table with price, at = "1 {outputs[name].unit}" and target'
            )
        known(given, ("price", "at", "target"), where)
        for key in ("price", "at"):
            if key not in given:
                raise ValueError(f"{where}.{key} is missing: a deviation of `at` from the target costs the price")
        unit = outputs[name].unit
        price, at = quantity(given["price"], "-", f"{where}.price"), quantity(given["at"], unit, f"{where}.at")
        target = quantity(given["target"], unit, f"{where}.target") if "target" in given else 0.0
        if price < 0:
            raise ValueError(f"{where}.price = {given['price']!r}: must not be negative")
        if at <= 0:
            raise ValueError(f"{where}.at = {given['at']!r}: must be positive")
        found[name] = QuadraticLoss(price, at, target)
    return found


def _together(where: str, given: Toml) -> None:
    """Raise ValueError for keys of different kinds of requirements."""
    kinds = [kind for kind in KINDS if set(given) & set(kind.limit_keys())]
    if not kinds:
        return
    nearest = min(kinds, key=lambda kind: len(set(given) - set(kind.file_keys())))
    alien = next(key for key in given if key not in nearest.file_keys())
    own, ways = [key for key in given if key in nearest.file_keys()], ", ".join(nearest.file_keys())
    raise ValueError(
        f"{where}.{alien} = {given[alien]!r}: must not be given with {', '.join(own)}; "
        f"remove it (keys of such a requirement: {ways})"
    )


def _requirements(outputs: Mapping[str, Output], table: Toml) -> tuple[dict[str, Limits], dict[str, str]]:
    """The requirements, and the unit of the first limit of each response."""
    requirements: dict[str, Limits] = {}
    read_in: dict[str, str] = {}
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
            _together(where, given)
            ways = "; or ".join(", ".join(kind.file_keys()) for kind in KINDS)
            raise ValueError(f"{where}: give upper or lower in {unit} (of these keys: {ways})")
        limits = kinds[0].limit_keys()
        values = {
            field: quantity(given[key], unit if key in limits else "-", f"{where}.{key}")
            for key, field in kinds[0].file_keys().items()
            if key in given
        }
        if {"lower", "upper"} <= set(values) and values["lower"] > values["upper"]:
            low, high = (f"{key} = {given[key]!r}" for key in limits)
            raise ValueError(f"{where}.{low}: must not lie above {high}")
        with naming_field(where):
            requirements[response] = kinds[0](**values)
        if unit != "-":  # limits are texts with units, they have been read before
            read_in[response] = unit_of(str(next(given[key] for key in given if key in limits)), unit)
    return requirements, read_in
