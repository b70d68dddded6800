"""Inputs of `rvjax budget`: a study, an output, torques."""

import argparse
from dataclasses import dataclass
from pathlib import Path

from rvjax import study
from rvjax.commands.forecast import forewarn
from rvjax.render import results_folder
from rvjax.study import Study, quantity


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: design, conditions and tolerances.
        output: whose curve is shared out; None: the first that has one.
        loads: torques by name, N m; None: that of the study, and a thousandth of it.
        samples: units.
        seed: of the random numbers, None: that of the study.
        folder: of the results.
    """

    study: Study
    output: str | None
    loads: dict[str, float] | None
    samples: int
    seed: int | None
    folder: Path


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    loaded = study.load(options.study, solve=False)
    loads = {torque: quantity(torque, "N m", "--torque") for torque in options.torque or ()}
    if len(set(loads.values())) < len(options.torque or ()):
        raise ValueError(f"--torque {', '.join(options.torque)}: each torque once")
    folder = results_folder(options.results, f"{loaded.name}-budget")
    forewarn(loaded)
    return Inputs(loaded, options.output, loads or None, options.samples, options.seed, folder)
