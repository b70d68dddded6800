"""What `rvjax check` reads: a study, and where to draw its reducer."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.commands.speak import check_files
from rvjax.designs import RVReducer
from rvjax.study import Study


@dataclass(frozen=True)
class Inputs:
    """What the command needs.

    Attributes:
        study: to check.
        picture: file of a drawing, or None.
    """

    study: Study
    picture: Path | None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    check_files(options, picture=".png")
    question = study.load(options.study, solve=False)
    if options.picture and not isinstance(question.design, RVReducer):
        kind = type(question.design).__name__
        raise ValueError(f"--picture {options.picture}: draws RV reducers only, not a {kind}")
    return Inputs(question, Path(options.picture) if options.picture else None)
