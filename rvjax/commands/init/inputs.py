"""Inputs of `rvjax init`: the name of the new file, and the reducer."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax.base.files import check_writable
from rvjax.commands.speak import check_files


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        file: new one, as named.
        base: known reducer, or file of a drawing.
        model: "loaded" or "four-bar".
        design: a study for `rvjax design`.
    """

    file: str
    base: str
    model: str
    design: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: the file exists, or cannot be written.
    """
    check_files(options, file=".toml")
    if Path(options.file).exists():
        raise ValueError(f"{options.file}: exists already; name a new file")
    check_writable(Path(options.file))
    if options.design and options.base != "rv-40e":
        raise ValueError(f"--design --base {options.base}: the study with variables is of the rv-40e only")
    return Inputs(options.file, options.base, options.model, options.design)
