"""Inputs of `rvjax tradeoff`: the levels to measure, and the output files."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax.commands.speak import check_files


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        full: all levels, and more cases.
        seed: of the random cases.
        json: file of the table, or None.
        picture: file of the plot, or None.
    """

    full: bool
    seed: int
    json: Path | None
    picture: Path | None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: a file that cannot be written.
    """
    check_files(options, json=".json", picture=".png")
    files = (Path(name) if name else None for name in (options.json, options.picture))
    return Inputs(options.full, options.seed, *files)
