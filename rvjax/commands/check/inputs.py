"""Inputs of `rvjax check`: a study, and the file of the drawing."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.commands.speak import check_files
from rvjax.study import KINDS, Study, kind_of


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: to check.
        picture: file of the drawing, or None.
        source: file of the study, or name of an embedded one.
    """

    study: Study
    picture: Path | None
    source: str = ""


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    check_files(options, picture=".png")
    loaded = study.load(options.study, solve=False)
    if options.picture and kind_of(loaded.design).drawing is None:
        able = " and ".join(kind.plural for kind in KINDS.values() if kind.drawing)
        raise ValueError(f"--picture {options.picture}: plots {able} only, not a {type(loaded.design).__name__}")
    return Inputs(loaded, Path(options.picture) if options.picture else None, options.study)
