"""`rvjax export`: outlines or sizes of the parts for CAD and workshop, or the joint model for a simulator.

Outlines and sizes are those of the design and the tolerances of a study, or of a result.
"""

import hashlib
from typing import Any

import jax
import numpy as np

import rvjax
from rvjax.commands.cells import sizes_table
from rvjax.commands.compare.results import answered, result
from rvjax.commands.export import joint
from rvjax.commands.export.inputs import ALL, SIZES, UNITS as UNITS, ExportInputs as ExportInputs
from rvjax.geometry import DRAWINGS, PARTS, Outline, layer, outline
from rvjax.records import PyTree
from rvjax.render import Note, Report, Table, Text
from rvjax.study import Size, StudyError, mid_points, naming, sizes_of
from rvjax.units import mm, um


def compute(inputs: ExportInputs) -> Any:
    """Outlines, rows of sizes, or the joint model with its origin.

    Raises:
        StudyError: parts or a unit that cannot be, in one line.
    """
    if inputs.form == SIZES:
        return sizes_of(*_built(inputs))
    return _outlines(inputs) if inputs.drawing else joint.compute(inputs)


def report(inputs: ExportInputs, found: Any) -> Report:
    """The report on the file.

    Args:
        inputs: inputs of the command.
        found: from `compute`.
    """
    if inputs.form == SIZES:
        return _report_on_sizes(inputs, found)
    return _report_on_outlines(inputs, found) if inputs.drawing else joint.report(inputs, found)


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
        content=(*map(Note, about), Table("outlines", columns, rows)),
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
        content=(Note(f"Tolerances of {origin}."), table),
        data={"study": study.name, "tolerances": origin, "sizes": found},
        exports={inputs.file: table.csv()},
        told={"file": str(inputs.file)},
        closing=(f"{inputs.file}: sizes",),
    )
