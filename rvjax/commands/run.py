"""One run of a command: inputs, compute, report; then text or JSON on standard output, and a results folder."""

import argparse
import json

from rvjax import progress
from rvjax.commands.registry import module
from rvjax.commands.speak import EXIT_NO_ANSWER, EXIT_OK, READING, WRITING, say


def run(name: str, options: argparse.Namespace) -> int:
    """Run a command; returns the exit code.

    `inputs.inputs(options)` checks everything before any work; its result may have a `folder` for the results.
    `compute.compute(inputs)` works, in phases that `compute.phases(inputs)` lists with their expected seconds, if it
    has any; `compute.COUNTED` is the phase that reports which part of it is done.
    `report.report(inputs, found)` describes what was found.

    Args:
        name: of the command.
        options: as parsed.
    """
    from rvjax.files import write_atomically  # the help does not wait for NumPy
    from rvjax.render import plain, write_files

    asked = module(name, "inputs").inputs(options)
    work, report = module(name, "compute"), module(name, "report").report
    folder, quiet = getattr(asked, "folder", None), getattr(asked, "quiet", getattr(options, "quiet", True))
    as_json = options.format == "json" or getattr(options, "json", None) is True  # `--json` that names no file
    phases = work.phases(asked) if hasattr(work, "phases") else {}
    with progress.shown(phases, counted=getattr(work, "COUNTED", ""), quiet=quiet):
        progress.begin(READING)
        found = report(asked, work.compute(asked))
        if not as_json and found.content:  # before the folder is made, which may fail
            say(found.text() if found.brief is None else found.brief)
        if folder is not None:
            progress.begin(WRITING)
            folder = write_files(found.folder(), folder)
    for path, content in found.exports.items():
        write_atomically(path, content)
    getattr(asked, "finished", lambda: None)()
    wrote = {} if folder is None else {"report": folder / found.main} if found.main else {"results": folder}
    if as_json:
        more = dict(found.told) | {name: str(path) for name, path in wrote.items()}
        print(json.dumps(plain(found.data | more if more else found.data), indent=1, allow_nan=False))
    elif closing := [*found.closing, *(f"{'' if found.main else chr(10)}{n.title()}: {p}" for n, p in wrote.items())]:
        say("\n".join(closing))
    return EXIT_OK if found.ok else EXIT_NO_ANSWER
