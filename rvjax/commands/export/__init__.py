"""`rvjax export`: outlines or sizes of the parts for CAD and workshop, or the joint model for a simulator."""

from types import ModuleType
from typing import Any

from rvjax.commands import READING, WRITING
from rvjax.commands.export import joint, outlines, sizes
from rvjax.commands.export.inputs import SIZES, UNITS as UNITS, ExportInputs as ExportInputs
from rvjax.commands.export.joint import SOLVING
from rvjax.render import Report


def _work(inputs: ExportInputs) -> ModuleType:
    """The module of the kind of file."""
    return sizes if inputs.form == SIZES else outlines if inputs.drawing else joint


def phases(inputs: ExportInputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return (READING, SOLVING, WRITING) if _work(inputs) is joint else (READING, WRITING)


def compute(inputs: ExportInputs) -> Any:
    """Outlines, rows of sizes, or the joint model with its origin.

    Raises:
        StudyError: parts or a unit that cannot be, in one line.
    """
    return _work(inputs).compute(inputs)


def report(inputs: ExportInputs, found: Any) -> Report:
    """The report on the file.

    Args:
        inputs: inputs of the command.
        found: from `compute`.
    """
    return _work(inputs).report(inputs, found)
