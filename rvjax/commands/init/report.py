"""Report of `rvjax init`: path of the study, warnings, and next steps."""

from pathlib import Path

from rvjax.commands.init.compute import Written
from rvjax.commands.init.inputs import Inputs
from rvjax.render import Report


def report(inputs: Inputs, found: Written) -> Report:
    """The report on a new study.

    Args:
        inputs: inputs of the command.
        found: the study.
    """
    file, base = inputs.file, inputs.base
    return Report(
        title=file,
        content=(),
        data={"study": file, "base": base, "model": found.model, "warnings": found.warnings},
        exports={Path(file): found.text.encode("utf-8")},
        closing=(
            *(f"warning: {line}" for line in found.warnings),
            f"{file}: a study of the {found.of} to change. Next: rvjax check {file}",
        ),
    )
