"""Inputs of `rvjax montecarlo`: a study and how its units are sampled and stored."""

import argparse
import time
from dataclasses import dataclass

from rvjax.commands.montecarlo.cluster import group_of
from rvjax.commands.speak import check_files, share_cores
from rvjax.tolerances import ENDINGS, Folder, UnitFile


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        options: of the command line, checked.
        group: processes of a cluster that share the run, or None.
        table: file that every unit goes to as a row, or None.
        started: clock at the start, s.
        quiet: show no phases: the first of several processes has a line of its own, the others are silent.
    """

    options: argparse.Namespace
    group: Folder | None
    table: str | None
    started: float
    quiet: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name, once all processes have met; each core becomes a device.

    Raises:
        ValueError: one line that names the option.
    """
    check_files(options, json=".json", save=(".npz", *ENDINGS))
    table = options.save if options.save and options.save.endswith(ENDINGS) else None
    if options.save_errors and table is None:
        raise ValueError(f"--save-errors: needs --save FILE with {' or '.join(ENDINGS)}, not {options.save}")
    if table is not None:
        UnitFile(table)  # raises an error for a missing extra before any work
    group = group_of(options)
    share_cores(int(options.worker[2]) if options.worker else 1)
    quiet = options.quiet or (options.processes > 1 if group is None else group.number > 0)
    return Inputs(options, group, table, time.perf_counter(), quiet)
