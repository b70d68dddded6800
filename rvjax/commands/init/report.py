"""Report of `rvjax init`: path of the study, and next steps."""

from pathlib import Path

from rvjax.commands.init.inputs import Inputs
from rvjax.render import Report


def report(inputs: Inputs, found: str) -> Report:
    """The report on a new study.

    Args:
        inputs: inputs of the command.
        found: text of the study.
    """
    file, base = inputs.file, inputs.base
    return Report(
        title=file,
        content=(),
        data={"study": file, "base": base},
        exports={Path(file): found.encode("utf-8")},
        closing=(f"{file}: a study of the {base} to change. Next: rvjax check {file}",),
    )
