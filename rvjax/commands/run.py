"""One run of a command: inputs, compute, report; then text or JSON on standard output, and a results folder.

Parts of the package of a command, imported when first used.
"""

import argparse
import importlib
import json
import tomllib
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from rvjax.base import progress
from rvjax.base.words import terminal_width, wrapped
from rvjax.commands.speak import EXIT_NO_ANSWER, EXIT_OK, READING, WRITING, say


def about(name: str) -> dict[str, Any]:
    """Options and help of a command: its `command.toml`."""
    found = find_spec(f"rvjax.commands.{name}")
    assert found is not None and found.submodule_search_locations, f"{name}: no package of rvjax.commands"
    return tomllib.loads((Path(found.submodule_search_locations[0]) / "command.toml").read_text("utf-8"))


def module(name: str, part: str) -> ModuleType:
    """A module of a command: "inputs", "compute" or "report".

    Args:
        name: of the command.
        part: of the module.
    """
    return importlib.import_module(f"rvjax.commands.{name}.{part}")


def run(name: str, options: argparse.Namespace) -> int:
    """Run a command; returns the exit code.

    `inputs.inputs(options)` checks everything before any work; its result may have a `folder` for the results, `over`
    whether they take the place of those in it, and a `memo` of an interrupted run.
    `compute.compute(inputs)` works, in phases that `compute.phases(inputs)` lists with their expected seconds, if it
    has any; `compute.COUNTED` is the phase that reports which part of it is done.
    `report.report(inputs, found)` describes what was found.

    Args:
        name: of the command.
        options: as parsed.
    """
    from rvjax.base.files import write_atomically  # the help does not wait for NumPy
    from rvjax.render import plain, write_files

    inputs = module(name, "inputs").inputs(options)
    work, report = module(name, "compute"), module(name, "report").report
    if (memo := getattr(inputs, "memo", None)) is not None:  # an interrupted run resumes from it
        options.begun = lambda: memo.folder if memo.folder.exists() else None
    folder, quiet = getattr(inputs, "folder", None), getattr(inputs, "quiet", getattr(options, "quiet", True))
    as_json = options.format == "json" or getattr(options, "json", None) is True  # `--json` that names no file
    width = terminal_width()
    phases = work.phases(inputs) if hasattr(work, "phases") else ()
    with progress.shown(phases, counted=getattr(work, "COUNTED", ""), quiet=quiet):
        progress.begin(READING)
        found = report(inputs, work.compute(inputs))
        if not as_json and found.content:  # before the folder is made, which may fail
            say(found.text(width) if found.brief is None else wrapped(found.brief, width))
        if folder is not None:
            progress.begin(WRITING)
            folder = write_files(found.folder(), folder, over=getattr(inputs, "over", False))
    for path, content in found.exports.items():
        write_atomically(path, content)
    if memo is not None:
        memo.clear()
    wrote = {} if folder is None else {"report": folder / found.main} if found.main else {"results": folder}
    if as_json:
        more = dict(found.told) | {name: str(path) for name, path in wrote.items()}
        print(json.dumps(plain(found.data | more if more else found.data), indent=1, allow_nan=False))
    elif closing := [*found.closing, *(f"{'' if found.main else chr(10)}{n.title()}: {p}" for n, p in wrote.items())]:
        say(wrapped("\n".join(closing), width))
    return EXIT_OK if found.ok else EXIT_NO_ANSWER
