"""Sizes for the drawing, of the tolerances of a study or of a result."""

from rvjax.commands.cells import sizes_table
from rvjax.commands.export.inputs import ExportInputs
from rvjax.commands.export.outlines import built, of_result
from rvjax.render import Note, Report
from rvjax.study import Size, sizes_of


def compute(inputs: ExportInputs) -> list[Size]:
    """Rows of the table.

    Raises:
        StudyError: a result of another design, in one line.
    """
    return sizes_of(*built(inputs))


def report(inputs: ExportInputs, found: list[Size]) -> Report:
    """The report on the table.

    Args:
        inputs: of the command.
        found: its rows.
    """
    study, table = inputs.study, sizes_table(found)
    origin = study.name if inputs.result is None else of_result(inputs)
    return Report(
        title=f"Sizes of {study.name}",
        content=(Note(f"Tolerances of {origin}."), table),
        data={"study": study.name, "tolerances": origin, "sizes": found},
        exports={inputs.file: table.csv()},
        told={"file": str(inputs.file)},
        closing=(f"{inputs.file}: sizes",),
    )
