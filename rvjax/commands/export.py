"""`rvjax export`: the joint model of a reducer as a file for a simulator."""

import dataclasses
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import rvjax
from rvjax import running, study
from rvjax._jax.programs import QUICK
from rvjax.base import progress
from rvjax.base.files import check_writable
from rvjax.commands import (
    READING,
    WRITING,
    Inputs,
    argument,
    flag_of,
    option,
    quiet_option,
    study_argument,
    whole_number,
)
from rvjax.population import Population, drawn, root_key
from rvjax.records import PyTree, Record, field, record, text
from rvjax.render import Note, Report, Table, Text
from rvjax.response import per_response
from rvjax.running import FORMATS, Header, Joint
from rvjax.status import MEANING, SUCCESS, Status
from rvjax.study import StudyError, naming

UNITS = 256
"""Random units of a statistic without --samples."""
STATISTICS = {"median": 0.5, "p99": 0.99}


@dataclass(kw_only=True)
class ExportInputs(Inputs):
    """Compute backlash, stiffness, friction and inertia of the joint that a reducer makes, and write them as a file for
    a simulator. The study needs [design.friction], [design.stiffness] and [design.contact]. Existing files are never
    overwritten.

    examples:
      rvjax export my-study.toml joint.xml
      rvjax export my-study.toml joint.mo --rated-torque "412 N m" --damping "50 N m s/rad"
      rvjax export my-study.toml joint.json --unit p99 --samples 1000
      rvjax export my-study.toml joint.urdf --unit unit-17.toml

    The ending of FILE chooses the format: .xml (MJCF), .mo (Modelica), .urdf, .json. A unit is "nominal" (no
    errors), a .toml file with the table [errors] of a measured unit, or a statistic of random units: with "median"
    or "p99" every number is the median, or the unfavourable 99 % quantile. MJCF and Modelica need both inertias.
    """

    source: str = study_argument()
    file: Path = argument("new file", "FILE", type=Path, ends="")
    form: str = option(
        "format of the file (default: by its ending)",
        default="",
        choices=["mjcf", "modelica", "urdf", "json"],
        flag="--as",
    )
    unit: str = option(
        "nominal (default), median, p99, or a .toml file with the table [errors]", "UNIT", default="nominal"
    )
    rated_torque: float | None = option(
        "torque of stiffness and losses, such as '412 N m' (default: conditions.rated_torque)",
        "TORQUE",
        unit="N m",
        sign="positive",
    )
    damping: float | None = option(
        "damping of the elastic train at the output, such as '50 N m s/rad' (default: none)",
        "DAMPING",
        unit="N m s/rad",
        sign="nonnegative",
    )
    input_inertia: float | None = option(
        "of input shaft and motor, such as '1e-4 kg m2' (default: from design.inertia)",
        "INERTIA",
        unit="kg m2",
        sign="positive",
    )
    output_inertia: float | None = option(
        "of all that turns with the output (default: from design.inertia)", "INERTIA", unit="kg m2", sign="positive"
    )
    samples: int | None = option("random units of median and p99 (default: 256)", "N", type=whole_number)
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the study and the unit, and check what a joint model needs.

        Raises:
            ValueError: one line that names the option or the key.
        """
        statistic = self.unit in STATISTICS
        endings = {form.ending: name for name, form in FORMATS.items()}
        self.form = self.form or endings.get(self.file.suffix, "")
        if not self.form:
            raise ValueError(f"{self.file}: must end with one of {', '.join(endings)}, or give --as")
        if self.file.exists():
            raise ValueError(f"{self.file}: exists already; name a new file")
        check_writable(self.file)
        if self.samples is not None and not statistic:
            raise ValueError(f"--samples {self.samples}: needs --unit {' or '.join(STATISTICS)}")
        needs = ("design", "tolerances") if statistic else ("design",)
        self.study = study.load(self.source, solve=False, needs=needs)
        self.torque = self._checked()
        self.errors = None if statistic else _errors(self.unit, self.study.design)
        self.units = self.samples or UNITS

    def _checked(self) -> float:
        """The rated torque; the design and the options allow a joint model."""
        name, design = self.study.name, self.study.design
        if not hasattr(design, "friction"):
            raise StudyError(f"{name}: {study.kind_of(design).name} has no model of its friction")
        if design.friction is None:
            raise StudyError(f"{name}: design.friction is missing: rvjax export needs it")
        torque = getattr(self.study.conditions, "rated_torque", None)
        torque = torque if self.rated_torque is None else self.rated_torque
        if torque is None:
            raise StudyError(f"{name}: conditions.rated_torque is missing; give it or --rated-torque")
        if torque <= 0:
            raise ValueError(f"conditions.rated_torque = {torque:g}: must be positive")
        if FORMATS[self.form].inertias and getattr(design, "inertia", None) is None:
            for key in ("input_inertia", "output_inertia"):
                if getattr(self, key) is None:
                    raise StudyError(
                        f"{name}: design.inertia is missing: {self.form} needs both inertias; give {flag_of(key)}"
                    )
        return torque


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


SOLVING = "joint model"
LOW = ("stiffness", "mu_dif")
"""Numbers of which the low values are unfavourable."""


@record
class _Joined(Record):
    """The joint model of one unit."""

    design: PyTree = field("-", "the reducer", kind="record")
    ways: tuple[tuple[str, Any], ...] = text("arguments of the joint model")

    def __call__(self, errors: PyTree) -> running.Joint:
        return running.joint(errors.stiffened(self.design), errors, **dict(self.ways))


@per_response(options=QUICK)
def _of_unit(unit: _Joined, errors: object) -> running.Joint:
    return unit(errors)


@per_response(options=QUICK)
def _of_units(unit: _Joined, population: Population, z: jax.Array) -> running.Joint:
    """Joint models of the units with random numbers z (numbers, units)."""
    return jax.vmap(lambda z: unit(population.errors(z)), in_axes=-1)(z)


def phases(inputs: ExportInputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return (READING, SOLVING, WRITING)


def compute(inputs: ExportInputs) -> tuple[running.Joint, Header]:
    """The joint model, and its origin.

    Raises:
        StudyError: a unit that cannot be solved, in one line.
    """
    progress.begin(SOLVING)
    study, given = inputs.study, inputs.study.conditions
    ways = dict(
        rated_torque=inputs.torque,
        damping=inputs.damping,
        input_angle=given.input_angle,
        samples=given.running_samples,
        contact=given.pin_contact,
        carrier=given.carrier,
        sun=getattr(given, "sun", "fixed"),
    )
    unit = _Joined(study.design, tuple(ways.items()))
    with naming(study.name):
        if inputs.errors is None:
            found, said = _statistic(unit, inputs)
        else:
            found, said = _of_unit(unit, inputs.errors), inputs.unit
            if (status := Status(int(found.info.status))) not in SUCCESS:
                raise StudyError(f"unit {inputs.unit}: cannot be solved: {status.name} ({MEANING[status]})")
    if inputs.input_inertia is not None:
        found = found.replace(rotor_inertia=inputs.input_inertia * found.ratio**2)
    if inputs.output_inertia is not None:
        found = found.replace(output_inertia=inputs.output_inertia)
    return found, Header(study.name, said, rvjax.__version__)


def _statistic(unit: _Joined, inputs: ExportInputs) -> tuple[running.Joint, str]:
    """Each number at its median or its unfavourable quantile; a unit that fails counts as unfavourable in each."""
    study, count, share = inputs.study, inputs.units, STATISTICS[inputs.unit]
    population = Population.of(study.tolerances)
    z = drawn(population, root_key(study.seed), jnp.uint32(0), count=count)
    found = jax.device_get(_of_units(unit, population, z))
    good = np.isin(found.info.status, [int(status) for status in SUCCESS])
    if np.ceil(share * (count - 1)) >= good.sum():
        raise StudyError(f"unit {inputs.unit}: {count - good.sum()} of {count} units cannot be solved")

    def quantile(name: str, values: np.ndarray) -> np.float64:
        values = np.broadcast_to(np.asarray(values, float), count)
        sign = -1 if name in LOW else 1
        return np.float64(sign * np.quantile(np.where(good, sign * values, np.inf), share))

    numbers = {name: getattr(found, name) for name in running.units(found)}
    settled = {name: quantile(name, value) for name, value in numbers.items() if value is not None}
    info = jax.tree.map(lambda x: x[0], found.info)
    what = "median" if inputs.unit == "median" else "unfavourable 99 % quantile"
    said = f"{inputs.unit}, no single unit: each number is the {what} of {count} random units, seed {study.seed}"
    said += f"; {count - good.sum()} of them cannot be solved and count as unfavourable" if not good.all() else ""
    return found.replace(info=info, **settled), said


def report(inputs: ExportInputs, found: tuple[Joint, Header]) -> Report:
    """The report on a joint model.

    Args:
        inputs: inputs of the command.
        found: the joint model, and its origin.
    """
    joint, header = found
    content = FORMATS[inputs.form].write(joint, header).encode()
    fields = [f for f in dataclasses.fields(joint) if f.name != "info"]
    numbers = {f.name: None if (value := getattr(joint, f.name)) is None else float(value) for f in fields}
    rows = [
        [
            f.name.replace("_", " "),
            None if (value := numbers[f.name]) is None else f"{value:.6g}",
            unit,
            f.metadata["meaning"],
        ]
        for f in fields
        for unit in ("" if f.metadata["unit"] == "-" else f.metadata["unit"],)
    ]
    columns = [Text("number"), Text("value"), Text("unit"), Text("meaning", wraps=True)]
    said = f"Joint model of {header.study}, unit: {header.unit}. All numbers refer to the output."
    return Report(
        title=f"Joint model of {header.study}",
        content=(Note(said), Table("joint", columns, rows)),
        data={"study": header.study, "unit": header.unit, "format": inputs.form} | numbers,
        exports={inputs.file: content},
        told={"file": str(inputs.file)},
        closing=(f"{inputs.file}: {inputs.form}", *filter(None, [FORMATS[inputs.form].remark(joint)])),
    )
