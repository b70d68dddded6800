"""Inputs of `rvjax allocate`: a study, and results folders that may hold its result."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.commands.allocate import kept
from rvjax.commands.allocate.forecast import expected
from rvjax.commands.forecast import forewarn
from rvjax.commands.speak import share_cores
from rvjax.render import results_folder
from rvjax.study import Study
from rvjax.tolerances import Memo


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: solved study.
        kept: folder that holds the result, or None.
        folder: of the results, None where they are kept.
        memo: keeps what took long until the folder exists, or None.
        quiet: show no progress.
        measure: measure the allocated units of a four-bar or lost-motion study on the whole reducer.
        over: the result takes the place of the stored one of the same study.
    """

    study: Study
    kept: Path | None
    folder: Path | None
    memo: Memo | None
    quiet: bool
    measure: bool = True
    over: bool = False


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    loaded = study.load(options.study, solve=False)
    if loaded.costly:
        share_cores(1)
    found = kept.folder(loaded, options.results)
    if found is not None and not options.fresh:
        return Inputs(loaded, found, None, None, True)
    folder = results_folder(options.results, loaded.name, found)
    forewarn(loaded, expected(loaded))
    memo = kept.memo(loaded, folder)
    return Inputs(loaded, None, folder, memo, options.quiet, not options.no_whole, over=found is not None)
