"""What `rvjax montecarlo` reads: a study and how its units are sampled and stored."""

import argparse
import contextlib
import os
import time
from dataclasses import dataclass

from rvjax.commands.speak import check_files
from rvjax.tolerances import ENDINGS, UnitFile

# A loop over blocks of units has one thread, so each core becomes a device of JAX, which takes its part of every chunk;
# more devices would leave each too few blocks.
_MOST_DEVICES = 8


@dataclass(frozen=True)
class Inputs:
    """What the command needs.

    Attributes:
        options: of the command line, checked.
        table: file that every unit goes to as a row, or None.
        started: clock at the start, s.
        quiet: show no phases; each of several processes has a line of its own.
    """

    options: argparse.Namespace
    table: str | None
    started: float
    quiet: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name; each core becomes a device.

    Raises:
        ValueError: one line that names the option.
    """
    check_files(options, json=".json", save=(".npz", *ENDINGS))
    table = options.save if options.save and options.save.endswith(ENDINGS) else None
    if options.save_errors and table is None:
        raise ValueError(f"--save-errors: needs --save FILE with {' or '.join(ENDINGS)}, not {options.save}")
    if table is not None:
        UnitFile(table)  # raises an error for a missing extra before any work
    share_cores(int(options.worker[2]) if options.worker else 1)
    return Inputs(options, table, time.perf_counter(), options.quiet or options.processes > 1)


def share_cores(processes: int) -> None:
    """A device of JAX for each core, among `processes`; JAX_NUM_CPU_DEVICES says otherwise."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or "host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(RuntimeError):  # whoever called `main` uses JAX already
        jax.config.update("jax_num_cpu_devices", max(1, min(cores // processes, _MOST_DEVICES)))
