"""Inputs of `rvjax identify`: a study with [identify], and bench data."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.render import results_folder
from rvjax.study import Measured, Study, identification_of, read_measured


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: with [identify].
        source: of the study, as named.
        paths: of the data.
        data: that they hold; None without files.
        check: only what the data can distinguish.
        sample: draw from the posterior as well.
        folder: of the results, None for a check.
    """

    study: Study
    source: str
    paths: list[str]
    data: Measured | None
    check: bool
    sample: bool
    folder: Path | None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option, the key or the cell.
    """
    loaded = study.load(options.study, solve=False, needs=("design", "tolerances"))
    columns = identification_of(loaded).columns
    data = read_measured(options.data, columns, encoding=options.encoding) if options.data else None
    if data is None and not options.check:
        raise ValueError("no data: name at least one CSV file, or use --check for the identifiability")
    folder = None if options.check else results_folder(options.results, loaded.name)
    return Inputs(loaded, options.study, options.data, data, options.check, options.sample, folder)
