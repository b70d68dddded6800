"""Report of `rvjax export`: the file, and its numbers."""

import dataclasses

from rvjax.commands.export.inputs import Inputs
from rvjax.render import Note, Report, Table, Text
from rvjax.running import FORMATS, Header, Joint


def report(inputs: Inputs, found: tuple[Joint, Header]) -> Report:
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
