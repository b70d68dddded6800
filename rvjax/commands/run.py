"""One run of a command: compute, report; then text or JSON on standard output, and a results folder.

The module of a command is imported when it is first used.
"""

import importlib
import json
from collections.abc import Callable, Mapping
from types import ModuleType

from rvjax.base import progress
from rvjax.base.words import terminal_width, wrapped
from rvjax.commands.console import EXIT_NO_ANSWER, EXIT_OK, READING, WRITING, say
from rvjax.commands.inputs import Inputs

COMMANDS = {
    "init": "write a commented study file to change",
    "check": "check the values of a study, estimate the run time",
    "allocate": "the cheapest tolerances that meet the requirements",
    "design": "the cheapest design and tolerances together that meet the requirements",
    "report": "the result of `allocate` as one HTML page",
    "budget": "error budget: variance by error, part, stage and order",
    "compare": "two results of `allocate` side by side",
    "montecarlo": "Monte Carlo statistics, any sample size",
    "identify": "errors of the parts from measured curves, with intervals",
    "reproduce": "published values next to computed ones, with a verdict",
    "tradeoff": "speed and accuracy of every model, measured on this computer",
    "assemble": "match measured parts: parts and positions of every unit",
    "compensate": "correction table for a controller",
    "export": "joint model of a reducer for a simulator",
}
"""Every command with its line in the help, in the order of the help."""

TABLES = {"assembly": "assemble"}
"""Tables of study files that only one command reads, with this command."""


def module(name: str) -> ModuleType:
    """The module of a command."""
    return importlib.import_module(f"rvjax.commands.{name}")


def inputs_of(name: str) -> type[Inputs]:
    """The class of the inputs of a command."""
    return getattr(module(name), f"{name.capitalize()}Inputs")


def section(table: str) -> Callable[[Mapping[str, object], object], object] | None:
    """The function (table, study) -> value that reads a table of study files, None where no command reads it."""
    name = TABLES.get(table)
    return None if name is None else module(name).section


def run(name: str, inputs: Inputs, *, as_json: bool = False) -> int:
    """Run a command; returns the exit code.

    Args:
        name: of the command.
        inputs: its inputs.
        as_json: print one JSON value in SI instead of text.
    """
    from rvjax.base.files import write_atomically  # the help does not wait for NumPy
    from rvjax.render import plain, write_files

    work, folder, width = module(name), inputs.folder, terminal_width()
    phases = work.phases(inputs) if hasattr(work, "phases") else ()
    with progress.shown(phases, counted=getattr(work, "COUNTED", ""), quiet=inputs.quiet):
        progress.begin(READING)
        found = work.report(inputs, work.compute(inputs))
        if not as_json and found.content:  # before the folder is made, which may fail
            say(found.text(width) if found.brief is None else wrapped(found.brief, width))
        if folder is not None:
            progress.begin(WRITING)
            folder = write_files(found.folder(), folder, over=inputs.over)
    for path, content in found.exports.items():
        write_atomically(path, content)
    if inputs.memo is not None:
        inputs.memo.clear()
    wrote = {} if folder is None else {"report": folder / found.main} if found.main else {"results": folder}
    if as_json:
        more = dict(found.told) | {name: str(path) for name, path in wrote.items()}
        print(json.dumps(plain(found.data | more if more else found.data), indent=1, allow_nan=False))
    elif closing := [*found.closing, *(f"{'' if found.main else chr(10)}{n.title()}: {p}" for n, p in wrote.items())]:
        say(wrapped("\n".join(closing), width))
    return EXIT_OK if found.ok else EXIT_NO_ANSWER
