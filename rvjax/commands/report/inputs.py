"""Inputs of `rvjax report`: a study, and the folder that may hold its result."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.commands.allocate import Answer, restored_from
from rvjax.commands.cores import share_cores
from rvjax.commands.speak import check_files, forewarn
from rvjax.files import check_writable
from rvjax.render import results_folder
from rvjax.study import Study


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: the question.
        source: of the study, as named.
        answer: stored result, or None.
        kept: this folder, or None.
        output: file of the page, None for `report.html` in the folder of the result.
        folder: of the results, made for a new result without `output`.
        quiet: show no progress.
    """

    study: Study
    source: str
    answer: Answer | None
    kept: Path | None
    output: Path | None
    folder: Path | None
    quiet: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    check_files(options, output=".html")
    asked = study.load(options.study, solve=False)
    if asked.costly:
        share_cores(1)
    kept, answer = restored_from(asked)
    output = None if options.output is None else Path(options.output)
    if output is None and kept is not None:
        output = kept / "report.html"
    folder = results_folder(None, asked.name) if output is None else None
    if output is not None:
        check_writable(output)
    forewarn(asked)
    return Inputs(asked, options.study, answer, kept, output, folder, options.quiet)
