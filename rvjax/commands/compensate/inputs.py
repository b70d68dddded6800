"""Inputs of `rvjax compensate`: a study for ratio and pins, a bench file, options."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.compensation import FORMS
from rvjax.render import results_folder
from rvjax.study import Study, quantity

POINTS = 720
"""Rows of a table without --points, unless the orders need more."""


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: its design gives ratio and pins.
        data: path of the bench file.
        export: file of the table, None for none.
        angle_sd: of the zero of the table, rad of the output.
        count: orders to store at most, None for all.
        first_order: order 1 belongs to the reducer.
        points: rows of a table at least.
        side: "input" or "output".
        folder: of the results.
        encoding: of the bench file; None: guessed.
    """

    study: Study
    data: str
    export: Path | None
    angle_sd: float
    count: int | None
    first_order: bool
    points: int
    side: str
    folder: Path
    encoding: str | None = None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    export = None if options.export is None else Path(options.export)
    if export is not None and export.suffix not in FORMS:
        raise ValueError(f"--export {export}: must end with one of {', '.join(FORMS)}")
    if export is not None and not export.absolute().parent.is_dir():
        raise ValueError(f"--export {export}: there is no such folder")
    loaded = study.load(options.study, solve=False, needs=("design",))
    return Inputs(
        study=loaded,
        data=options.data,
        export=export,
        angle_sd=quantity(options.angle_sd, "rad", "--angle-sd"),
        count=options.count,
        first_order=options.first_order,
        points=options.points or POINTS,
        side=options.side,
        folder=results_folder(options.results, f"{loaded.name}-compensation"),
        encoding=options.encoding,
    )
