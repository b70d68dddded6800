"""Inputs of `rvjax design`: a study with variables."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax._jax.solved_state import moving
from rvjax.commands.allocate import kept
from rvjax.commands.forecast import forewarn
from rvjax.commands.speak import share_cores
from rvjax.population import sample
from rvjax.render import results_folder
from rvjax.study import Study, StudyError
from rvjax.tolerances import Memo

FRONT, MOST = 4, 16  # points of the trade front


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: with variables.
        front: points of the trade front.
        alone: no optimum but the one in question.
        folder: of the results.
        memo: keeps what took long until the folder exists, or None.
        quiet: show no progress.
    """

    study: Study
    front: int
    alone: bool
    folder: Path
    memo: Memo | None
    quiet: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    loaded = study.load(options.study, solve=False)
    if not loaded.variables:
        raise StudyError(f'{loaded.name}: [variable] is missing; add one, such as [variable."cycloid.eccentricity"]')
    if options.front is not None and not 0 <= options.front <= MOST:
        raise ValueError(f"--front {options.front}: must lie between 0 and {MOST}")
    _refuse_unread(loaded)
    if loaded.costly:
        share_cores(1)
    usual = 0 if loaded.costly else FRONT
    front = 0 if options.alone or not loaded.objective else usual if options.front is None else options.front
    folder = results_folder(options.results, f"{loaded.name}-design")
    forewarn(loaded)
    memo = kept.memo(loaded, folder)
    return Inputs(loaded, front, options.alone, folder, memo, options.quiet)


def _refuse_unread(asked: Study) -> None:
    """Raise an error for a variable on which no output depends, and for what the conditions cannot give."""
    response, errors = asked.design_response(), sample(asked.tolerances, 0, seed=0)
    start = {path: item.first for path, item in asked.variables.items()}
    read = moving(lambda values: response(errors, values).value, start)
    for path in start.keys() - read:
        outputs = ", ".join(response.response.outputs)
        raise StudyError(f'{asked.name}: variable."{path}": no required output depends on it ({outputs}); leave it out')
