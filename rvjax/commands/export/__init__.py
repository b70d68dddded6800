"""`rvjax export`: outlines of the parts for CAD and wire EDM, or the joint model of the reducer for a simulator."""

from typing import Any

from rvjax.commands import READING, WRITING
from rvjax.commands.export import joint, outlines
from rvjax.commands.export.inputs import UNITS as UNITS, ExportInputs as ExportInputs
from rvjax.commands.export.joint import SOLVING
from rvjax.render import Report


def phases(inputs: ExportInputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return (READING, WRITING) if inputs.drawing else (READING, SOLVING, WRITING)


def compute(inputs: ExportInputs) -> Any:
    """Outlines, or the joint model with its origin.

    Raises:
        StudyError: parts or a unit that cannot be, in one line.
    """
    return outlines.outlines(inputs) if inputs.drawing else joint.compute(inputs)


def report(inputs: ExportInputs, found: Any) -> Report:
    """The report on the file.

    Args:
        inputs: inputs of the command.
        found: from `compute`.
    """
    return outlines.report(inputs, found) if inputs.drawing else joint.report(inputs, found)
