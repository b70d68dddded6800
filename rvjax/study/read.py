"""Studies read from TOML with units in strings; whatever is wrong is one line that names key, value and unit."""

import dataclasses
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

from rvjax import catalogue
from rvjax.study import response as scene
from rvjax.study.question import Study, StudyError
from rvjax.tolerances import Exponential, ReciprocalPower, Tolerance, for_design
from rvjax.tolerances.distribution.tolerance import COMMON, LAWS
from rvjax.tolerances.propagation.requirements import KINDS
from rvjax.units import parse

DESIGNS = {"corr": catalogue.CORR, "rv-20e": catalogue.RV_20E, "rv-40e": catalogue.RV_40E}
COSTS: dict[str, Any] = {"reciprocal_power": ReciprocalPower, "exponential": Exponential}
# Beyond these a program neither compiles in time nor fits into memory.
_MOST = {"angles": 100_000, "count": 64, "disc_count": 64, "gear_teeth": 2000, "teeth": 1_000_000}
EMBEDDED = resources.files("rvjax.study") / "embedded"


def load(source: str) -> Study:
    """A study from a TOML file, or an embedded one by name ("rv-40e").

    Raises:
        StudyError: one line that names the key, its value and the unit.
        FileNotFoundError: neither a file nor an embedded study.
    """
    path = Path(source)
    if path.suffix == ".toml":
        try:
            text = path.read_text("utf-8")
        except FileNotFoundError:
            raise FileNotFoundError(f"{source}: no such study file") from None
        except (OSError, UnicodeDecodeError) as error:
            raise StudyError(f"{source}: cannot be read as text ({error})") from None
        return parse_study(text, name=path.stem)
    embedded = EMBEDDED / f"{source}.toml"
    if not embedded.is_file():
        raise FileNotFoundError(f"{source}: neither a .toml file nor an embedded study ({', '.join(embedded_names())})")
    return parse_study(embedded.read_text("utf-8"), name=source)


def embedded_names() -> list[str]:
    """Names of the studies that come with rvjax."""
    return sorted(Path(file.name).stem for file in EMBEDDED.iterdir() if file.name.endswith(".toml"))


def parse_study(text: str, *, name: str) -> Study:
    """A study from TOML text.

    Args:
        text: TOML.
        name: short name for messages and result folders.

    Raises:
        StudyError: one line that names the key, its value and the unit.
    """
    with _naming(name):
        try:
            tables = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ValueError(f"not valid TOML: {error}") from None
        _known(tables, {"accuracy", "conditions", "cost", "design", "requirement", "run", "tolerances"}, "")
        for key in ("design", "tolerances", "requirement"):
            if not _table(tables, key):
                raise ValueError(f"[{key}] is missing or empty")
        design = _design(_table(tables, "design"))
        error_record = design.error_record
        tolerances = _tolerances(design, _table(tables, "tolerances"))
        costs = _costs(error_record, tolerances, _table(tables, "cost"))
        run = _table(tables, "run")
        _known(run, {"seed", "samples", "certificate_samples"}, "run")
        requirements = _requirements(scene.kind(design).outputs, _table(tables, "requirement"))
        study = Study(
            name=name,
            text=text,
            design=design,
            conditions=_conditions(scene.kind(design).conditions, _table(tables, "conditions")),
            tolerances=tolerances,
            costs=costs,
            requirements=requirements,
            accuracy=_accuracy(scene.kind(design).outputs, requirements, _table(tables, "accuracy")),
            seed=_integer(run.get("seed", 0), "run.seed", 0, 2**32 - 1),
            samples=_integer(run.get("samples", 16384), "run.samples", 16, 2**32),
            certificate_samples=_integer(
                run.get("certificate_samples", 1_000_000), "run.certificate_samples", 16, 2**32
            ),
        )
        scene.check_nominal(study.response(), error_record())
        return study


@contextmanager
def _naming(where: str) -> Iterator[None]:
    """Prefix the messages of errors with where they happened, and keep them to one line."""
    try:
        yield
    except (ValueError, TypeError) as error:
        message = " ".join(str(error).split())
        if len(message) > 400:  # a hostile value is not repeated at length
            message = f"{message[:200]} ... {message[-150:]}"
        raise StudyError(f"{where}: {message}") from None


def _known(table: dict[str, Any], keys: set[str], where: str) -> None:
    for key in table:
        if key not in keys:
            name = f"{where}.{key}" if where else f"[{key}]"
            raise ValueError(f"unknown key {name}; known here: {', '.join(sorted(keys))}")


def _table(parent: dict[str, Any], key: str) -> dict[str, Any]:
    value = parent.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f"{key} = {value!r}: must be a table")
    return value


def _integer(value: Any, where: str, minimum: int, maximum: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        raise ValueError(f"{where} = {value!r}: must be an integer of at least {minimum}")
    if value > maximum:
        raise ValueError(f"{where} = {value}: must be at most {maximum}")
    return value


def _quantity(value: Any, unit: str, where: str) -> float:
    try:
        return parse(value, unit)
    except ValueError as error:
        raise ValueError(f"{where} = {error}") from None


def _count(value: Any, key: str, where: str) -> Any:
    if isinstance(value, int) and value > _MOST.get(key, _MOST["teeth"]):
        raise ValueError(f"{where} = {value}: must be at most {_MOST.get(key, _MOST['teeth'])}")
    return value  # the record judges the rest


def _metadata(record: Any, field: str) -> Any:
    return next(f.metadata for f in dataclasses.fields(record) if f.name == field)


def _design(table: dict[str, Any]) -> Any:
    design: Any = DESIGNS[_choice(table.get("base"), DESIGNS, "design.base")]
    return _override(design, {key: value for key, value in table.items() if key != "base"}, "design")


def _override(record: Any, changes: Any, where: str) -> Any:
    """A record with some fields changed; a field that is a record takes a table."""
    if record is None or not isinstance(changes, dict):
        raise ValueError(f"{where} = {changes!r}: must be a table of changes to a part that the base design has")
    _known(changes, {f.name for f in dataclasses.fields(record)} | ({"base"} if where == "design" else set()), where)
    values = {}
    for key, value in changes.items():
        metadata, name = _metadata(type(record), key), f"{where}.{key}"
        if metadata["kind"] == "record":
            values[key] = _override(getattr(record, key), value, name)
        else:
            is_count = metadata["kind"] == "count"
            values[key] = _count(value, key, name) if is_count else _quantity(value, metadata["unit"], name)
    return record.replace(**values)


def _conditions(kind: Any, table: dict[str, Any]) -> Any:
    fields = {f.name: f for f in dataclasses.fields(kind)}
    _known(table, set(fields), "conditions")
    values: dict[str, Any] = {}
    for key, value in table.items():
        metadata, where = fields[key].metadata, f"conditions.{key}"
        if "unit" in metadata:
            values[key] = _quantity(value, metadata["unit"], where)
        elif "minimum" in metadata:
            values[key] = _integer(value, where, metadata["minimum"], _MOST[key])
        else:
            values[key] = _choice(value, metadata["choices"], where)
    return kind(**values)


def _choice(value: Any, choices: Iterable[str], where: str) -> str:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{where} = {value!r}: must be one of {', '.join(choices)}")
    return value


def _tolerances(design: Any, table: dict[str, Any]) -> Any:
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    _known(table, fields, "tolerances")
    made = {}
    for field in table:
        where = f"tolerances.{field}"
        with _naming_field(where):
            made[field] = _tolerance(_table(table, field), _metadata(design.error_record, field)["unit"], where)
    return for_design(design, **made)


@contextmanager
def _naming_field(where: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise error if where in str(error) else ValueError(f"{where}: {error}") from None


def _tolerance(table: dict[str, Any], unit: str, where: str) -> Tolerance:
    law = LAWS[_choice(table.get("distribution", "normal"), LAWS, f"{where}.distribution")]
    _known(table, {"lower", "upper", "half_width", "grade", "size", "distribution", *COMMON, *law.parameters()}, where)
    options: dict[str, Any] = {"distribution": law}
    options |= {key: _quantity(table[key], "-", f"{where}.{key}") for key in COMMON if key in table}
    options |= {key: law.parsed(key, table[key], unit) for key in law.parameters() if key in table}
    size = _quantity(table["size"], "m", f"{where}.size") if "size" in table else None
    ways = [{"lower", "upper"}, {"half_width"}, {"grade", "size"}]
    given = set(table) & {"lower", "upper", "half_width", "grade"}
    chosen = next((way for way in ways if given and given == way - {"size"}), None)
    if chosen is None or (chosen == ways[2] and size is None):
        raise ValueError(f"{where}: give lower and upper, or half_width, or grade and size")
    if chosen == ways[2] and size is not None:
        if unit != "m":
            raise ValueError(f"{where}.grade = {table['grade']!r}: grades are for lengths, this error is in {unit}")
        return Tolerance.grade(table["grade"], size, **options)
    limits = {key: _quantity(table[key], unit, f"{where}.{key}") for key in sorted(given)}
    if chosen == ways[1]:
        return Tolerance.symmetric(limits["half_width"], size=size, **options)
    return Tolerance(limits["lower"], limits["upper"], size=size, **options)


def _costs(error_record: Any, tolerances: Any, table: dict[str, Any]) -> dict[str, Any]:
    costs = {}
    for field in table:
        where, entry = f"cost.{field}", dict(_table(table, field))
        if field not in {f.name for f in dataclasses.fields(error_record)} or getattr(tolerances, field) is None:
            raise ValueError(f"{where}: there is no [tolerances.{field}] for it")
        unit = _metadata(error_record, field)["unit"]
        model = entry.pop("model", "reciprocal_power")
        _choice(model, COSTS, f"{where}.model")
        units = {"fixed": "-", "scale": "-", "finest": unit, "coarsest": unit}
        units |= {"reference": unit, "power": "-"} if model == "reciprocal_power" else {"decay": unit}
        _known(entry, set(units), where)
        for key in ("finest", "coarsest"):
            if key not in entry:
                raise ValueError(f"{where}.{key} is missing: the range of the process in {unit}")
        with _naming_field(where):
            costs[field] = COSTS[model](
                **{key: _quantity(value, units[key], f"{where}.{key}") for key, value in entry.items()}
            )
    return costs


def _accuracy(
    outputs: Mapping[str, scene.Output], requirements: Mapping[str, Any], table: dict[str, Any]
) -> dict[str, float]:
    found = {}
    for name, value in table.items():
        where = f"accuracy.{name}"
        _choice(name, requirements, f"{where}: response")
        found[name] = _quantity(value, outputs[name].unit, where)
        if found[name] <= 0:
            raise ValueError(f"{where} = {value!r}: must be positive")
    return found


def _requirements(outputs: Mapping[str, scene.Output], table: dict[str, Any]) -> dict[str, Any]:
    requirements = {}
    for name in table:
        where, entry = f"requirement.{name}", _table(table, name)
        _known(entry, {"response", *(key for kind in KINDS for key in kind.file_keys())}, where)
        response = _choice(entry.get("response", name), outputs, f"{where}.response")
        if response in requirements:
            raise ValueError(f"{where}.response = {response!r}: already has a requirement")
        given = {key: value for key, value in entry.items() if key != "response"}
        unit = outputs[response].unit
        kinds = [kind for kind in KINDS if set(given) <= set(kind.file_keys()) and set(given) & set(kind.limit_keys())]
        if not kinds:
            ways = "; or ".join(", ".join(kind.file_keys()) for kind in KINDS)
            raise ValueError(f"{where}: give upper or lower in {unit} (of these keys: {ways})")
        values = {
            field: _quantity(given[key], unit if key in kinds[0].limit_keys() else "-", f"{where}.{key}")
            for key, field in kinds[0].file_keys().items()
            if key in given
        }
        with _naming_field(where):
            requirements[response] = kinds[0](**values)
    return requirements
