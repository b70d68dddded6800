"""Inputs of `rvjax export`: a study, a unit of it, the numbers that no study has, and a new file."""

import argparse
import dataclasses
import tomllib
from pathlib import Path

import numpy as np

from rvjax import study
from rvjax.base.files import check_writable
from rvjax.commands.speak import check_files
from rvjax.records import PyTree
from rvjax.running import FORMATS
from rvjax.study import Study, StudyError, quantity

UNITS = 256
"""Random units of a statistic without --samples."""
STATISTICS = {"median": 0.5, "p99": 0.99}


@dataclasses.dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: design, conditions and tolerances.
        file: new one.
        form: key of `FORMATS`.
        unit: as named.
        errors: of the unit; None for a statistic.
        units: random units of a statistic.
        rated_torque: N m.
        damping: N m s/rad, or None.
        rotor_inertia: kg m2 on the input shaft, or None for that of the design.
        output_inertia: kg m2, or None for that of the design.
    """

    study: Study
    file: Path
    form: str
    unit: str
    errors: PyTree
    units: int
    rated_torque: float
    damping: float | None
    rotor_inertia: float | None
    output_inertia: float | None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    file, statistic = Path(options.file), options.unit in STATISTICS
    form = options.form or next((name for name, own in FORMATS.items() if own.ending == file.suffix), None)
    if form is None:
        endings = ", ".join(own.ending for own in FORMATS.values())
        raise ValueError(f"{file}: must end with one of {endings}, or give --as")
    check_files(options, file="")
    if file.exists():
        raise ValueError(f"{file}: exists already; name a new file")
    check_writable(file)
    if options.samples is not None and not statistic:
        raise ValueError(f"--samples {options.samples}: needs --unit {' or '.join(STATISTICS)}")

    found = study.load(options.study, solve=False, needs=("design", *(("tolerances",) if statistic else ())))
    design = found.design
    if not hasattr(design, "friction"):
        raise StudyError(f"{found.name}: {study.kind_of(design).name} has no model of its friction")
    if design.friction is None:
        raise StudyError(f"{found.name}: design.friction is missing: rvjax export needs it")
    torque = getattr(found.conditions, "rated_torque", None)
    if options.rated_torque is not None:
        torque = quantity(options.rated_torque, "N m", "--rated-torque")
    if torque is None:
        raise StudyError(f"{found.name}: conditions.rated_torque is missing; give it or --rated-torque")
    positive = {"rated_torque": torque}
    sizes = {"input_inertia": "kg m2", "output_inertia": "kg m2", "damping": "N m s/rad"}
    given = {name: _size(options, name, unit) for name, unit in sizes.items()}
    positive |= {name: value for name, value in given.items() if value is not None and name != "damping"}
    for name, value in positive.items():
        if value <= 0:
            option = getattr(options, name)
            said = f"conditions.{name} = {value:g}" if option is None else f"{_flag(name)} = {option!r}"
            raise ValueError(f"{said}: must be positive")
    if given["damping"] is not None and given["damping"] < 0:
        raise ValueError(f"--damping = {options.damping!r}: must not be negative")
    if FORMATS[form].inertias and getattr(design, "inertia", None) is None:
        for name in ("input_inertia", "output_inertia"):
            if given[name] is None:
                raise StudyError(
                    f"{found.name}: design.inertia is missing: {form} needs both inertias; give {_flag(name)}"
                )
    return Inputs(
        study=found,
        file=file,
        form=form,
        unit=options.unit,
        errors=None if statistic else _errors(options.unit, design),
        units=options.samples or UNITS,
        rated_torque=torque,
        damping=given["damping"],
        rotor_inertia=given["input_inertia"],
        output_inertia=given["output_inertia"],
    )


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _size(options: argparse.Namespace, name: str, unit: str) -> float | None:
    given = getattr(options, name)
    return None if given is None else quantity(given, unit, _flag(name))


def _errors(unit: str, design: PyTree) -> PyTree:
    """Errors of the unit without errors, or of a measured one.

    Raises:
        ValueError: the file names no errors of such a design.
    """
    record = design.error_record
    if unit == "nominal":
        return record.for_design(design)
    if not unit.endswith(".toml"):
        raise ValueError(f"--unit {unit}: must be nominal, {', '.join(STATISTICS)}, or a .toml file with [errors]")
    try:
        tables = tomllib.loads(Path(unit).read_text("utf-8-sig"))
    except FileNotFoundError:
        raise FileNotFoundError(f"--unit {unit}: no such file") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"--unit {unit}: not valid TOML ({error})") from None
    study.known(tables, ("errors",), "")
    if not (given := study.subtable(tables, "errors")):
        raise ValueError(f"--unit {unit}: [errors] is missing or empty")
    fields = {f.name: f.metadata for f in dataclasses.fields(record)}
    study.known(given, fields, "errors")
    values = {}
    for name, value in given.items():
        where = f"errors.{name}"
        numbers = study.quantities(value, fields[name]["unit"], where)
        try:
            values[name] = np.asarray(numbers, float)
        except ValueError:
            raise ValueError(f"{where}: lists of different length") from None
    return record.for_design(design, **values)
