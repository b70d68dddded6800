"""`rvjax export`: outlines or sizes of the parts for CAD and workshop, or the joint model for a simulator.

Outlines and sizes are those of the design and the tolerances of a study, or of a result. The joint model is that of a
unit, of a measured one, or of a statistic of random ones.
"""

import dataclasses
import hashlib
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rvjax
from rvjax import loaded, running
from rvjax._jax.programs import QUICK
from rvjax.base import progress
from rvjax.commands.cells import sizes_table
from rvjax.commands.compare.results import answered, result
from rvjax.commands.export.inputs import ALL, SIZES, SOLVING, STATISTICS, UNITS as UNITS, ExportInputs as ExportInputs
from rvjax.cycloidal import ReducerErrors
from rvjax.geometry import DRAWINGS, PARTS, Outline, layer, outline
from rvjax.population import Population, drawn, root_key
from rvjax.records import PyTree, Record, field, record, text
from rvjax.render import Note, Report, Table, Text, as_csv
from rvjax.response import per_response
from rvjax.running import FORMATS, Header, Joint
from rvjax.status import MEANING, SUCCESS, Status
from rvjax.study import Size, StudyError, mid_points, naming, sizes_of
from rvjax.units import arcsec, mm, um


def compute(inputs: ExportInputs) -> Any:
    """Outlines, rows of sizes, or the joint model with its origin.

    Raises:
        StudyError: parts or a unit that cannot be, in one line.
    """
    if inputs.form == SIZES:
        return sizes_of(*_built(inputs))
    return _outlines(inputs) if inputs.drawing else _joint(inputs)


def report(inputs: ExportInputs, found: Any) -> Report:
    """The report on the file.

    Args:
        inputs: inputs of the command.
        found: from `compute`.
    """
    if inputs.form == SIZES:
        return _report_on_sizes(inputs, found)
    return _report_on_outlines(inputs, found) if inputs.drawing else _report_on_joint(inputs, found)


CERTIFIED = ("OPTIMAL", "SUBOPTIMAL", "MAX_STEPS")


def _built(inputs: ExportInputs) -> tuple[PyTree, PyTree]:
    """Design and tolerances of the result that an option names, with the numbers that it chose; else of the study.

    Raises:
        StudyError: a result of another design, in one line.
    """
    study, design = inputs.study, inputs.study.design
    if inputs.result is None:
        return design, study.tolerances
    other, tolerances = answered(inputs.result, designs=True)
    leaves, own = jax.tree.leaves(design), jax.tree.leaves(other.design)
    alike = str(jax.tree.structure(design)) == str(jax.tree.structure(other.design))  # counts and kind
    if not (alike and all(map(np.array_equal, leaves, own))):
        raise StudyError(f"--result {inputs.result}: is the result of another design than {study.name}")
    values = result(inputs.result, designs=True).get("values")
    try:
        return (study.design_with(values) if values else design), tolerances
    except (TypeError, AttributeError, ValueError) as error:
        raise StudyError(f"--result {inputs.result}: no result of {study.name} ({error})") from None


def _of_result(inputs: ExportInputs) -> str:
    """Name and status of the result that an option names, in words."""
    assert inputs.result is not None
    status = str(result(inputs.result, designs=True)["status"])
    return f"{inputs.result}, {status}{'' if status in CERTIFIED else ': not certified'}"


def _hint(inputs: ExportInputs) -> list[Note]:
    """Line on a stored result of the study, which no option names."""
    place, taken = inputs.stored, "its tolerances" if inputs.form == SIZES else "the mid-points of its tolerances"
    return [Note(f"{place} is a result of this study: --result {place} takes {taken}.")] if place else []


def _outlines(inputs: ExportInputs) -> dict[str, Outline]:
    """Outlines by part.

    Raises:
        StudyError: parts that do not exist or do not fit, in one line.
    """
    chord, (design, tolerances) = inputs.chord or um, _built(inputs)
    errors = None if inputs.result is None else mid_points(tolerances, design.error_record)
    wanted = PARTS if inputs.part == ALL else (inputs.part,)
    with naming(inputs.study.name):
        return {
            f"disc {inputs.disc}" if part == "disc" else part: outline(
                design, part=part, disc=inputs.disc, chord=chord, errors=errors
            )
            for part in wanted
        }


def _report_on_outlines(inputs: ExportInputs, found: dict[str, Outline]) -> Report:
    """The report on a drawing, of outlines by part."""
    study = inputs.study
    digest = hashlib.sha256(study.text.encode()).hexdigest()[:12]
    sizes = "the design" if inputs.result is None else f"the mid-points of {_of_result(inputs)}"
    missing = [f"{part}: {what}" for part, one in found.items() for what in one.unknown]
    about = [
        f"Outlines of {study.name} (study {digest}), rvjax {rvjax.__version__}; millimetres.",
        f"Sizes of {sizes}; largest distance of flank and line {(inputs.chord or um) / um:.3g} um.",
        *([f"Not in the design, and left out: {'; '.join(missing)}."] if missing else []),
    ]
    rows = list[list[object]]()
    for part, one in found.items():
        if len(one.flank):
            radii = np.hypot(*np.asarray(one.flank).T) / mm
            rows.append([layer(part), f"{len(radii)} points", f"{radii.min():.4f} to {radii.max():.4f}"])
        for name in dict.fromkeys(layer(part, circle.name) for circle in one.circles):
            own = [float(c.radius) / mm for c in one.circles if layer(part, c.name) == name]
            spread = f"{min(own):.4f}" if max(own) - min(own) < 1e-9 else f"{min(own):.4f} to {max(own):.4f}"
            rows.append([name, f"{len(own)} circles", spread])
    columns = [Text("layer"), Text("content"), Text("radius (mm)")]
    return Report(
        title=f"Outlines of {study.name}",
        content=(*map(Note, about), *_hint(inputs), Table("outlines", columns, rows)),
        data={
            "study": study.name,
            "sizes": sizes,
            "layers": {str(row[0]): row[1:] for row in rows},
            "missing": missing,
        },
        exports={inputs.file: DRAWINGS[inputs.file.suffix](found, about)},
        told={"file": str(inputs.file)},
        closing=(f"{inputs.file}: {', '.join(found)}",),
    )


def _report_on_sizes(inputs: ExportInputs, found: list[Size]) -> Report:
    """The report on the sizes for the drawing."""
    study, table = inputs.study, sizes_table(found)
    origin = study.name if inputs.result is None else _of_result(inputs)
    return Report(
        title=f"Sizes of {study.name}",
        content=(Note(f"Tolerances of {origin}."), *_hint(inputs), table),
        data={"study": study.name, "tolerances": origin, "sizes": found},
        exports={inputs.file: table.csv()},
        told={"file": str(inputs.file)},
        closing=(f"{inputs.file}: sizes",),
    )


TIGHT = "warning: the nominal unit has no clearance, but real units have; --unit median has that of random units"
ANGLES = 24  # of a turn of the crank or shaft, on the curve
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


class Exported(NamedTuple):
    """A joint model, its origin, and the transmission error over a turn of the output, (n,) rad, or None."""

    joint: Joint
    header: Header
    error: np.ndarray | None


def _joint(inputs: ExportInputs) -> Exported:
    """The joint model, its origin, and the transmission error where it is wanted.

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
        **loaded.ways(given),
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
    return Exported(found, Header(study.name, said, rvjax.__version__), _error(inputs, inputs.errors))


def _error(inputs: ExportInputs, errors: ReducerErrors | None) -> np.ndarray | None:
    """Transmission error of a unit under the rated torque at angles of a turn of the output; None where none is wanted.

    Raises:
        StudyError: an equilibrium that cannot be solved, in one line.
    """
    if inputs.curve is None or errors is None:
        return None
    study = inputs.study
    found = loaded.revolution(
        errors.stiffened(study.design),
        errors,
        output_torque=inputs.torque,
        turns=1.0,
        samples=ANGLES * study.design.cycloid.pin_count,
        **loaded.ways(study.conditions),
    )
    if (status := Status(int(found.info.status))) not in SUCCESS:
        raise StudyError(f"--curve: cannot be solved: {status.name} ({MEANING[status]})")
    return np.asarray(found.error)


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


def _curve_file(error: np.ndarray, torque: float) -> bytes:
    """Table that `rvjax compensate` and `rvjax identify` read."""
    angles = 360 * np.arange(len(error)) / len(error)
    rows = [[float(angle), float(value), torque] for angle, value in zip(angles, error / arcsec)]
    return as_csv(["angle [deg]", "error [arcsec]", "torque [N m]"], rows)


def _report_on_joint(inputs: ExportInputs, found: Exported) -> Report:
    """The report on a joint model.

    Args:
        inputs: inputs of the command.
        found: the joint model, its origin, and the transmission error or None.
    """
    joint, header, error = found
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
    curve = {} if inputs.curve is None or error is None else {inputs.curve: _curve_file(error, inputs.torque)}
    said = f"Joint model of {header.study}, unit: {header.unit}. All numbers refer to the output."
    return Report(
        title=f"Joint model of {header.study}",
        content=(Note(said), Table("joint", columns, rows)),
        data={"study": header.study, "unit": header.unit, "format": inputs.form} | numbers,
        exports={inputs.file: content} | curve,
        told={"file": str(inputs.file)},
        closing=(
            f"{inputs.file}: {inputs.form}",
            *(f"{file}: transmission error over a turn of the output under {inputs.torque:g} N m" for file in curve),
            *filter(None, [FORMATS[inputs.form].remark(joint)]),
            *([TIGHT] if inputs.unit == "nominal" and numbers["half_backlash"] == 0 else []),
        ),
    )
