"""Functions of all commands: printing, checks before any work, exit codes.

A device of JAX for each core, where units take longer than their start.
"""

import argparse
import contextlib
import os
from pathlib import Path
from typing import TextIO

# A loop over blocks of units has one thread, so each core becomes a device of JAX, which takes its part of every chunk;
# more devices would leave each too few blocks.
_MOST_DEVICES = 8


def share_cores(processes: int) -> None:
    """A device of JAX for each core, among `processes`; JAX_NUM_CPU_DEVICES says otherwise."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or "host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(RuntimeError):  # the caller of `main` already uses JAX
        jax.config.update("jax_num_cpu_devices", max(1, min(cores // processes, _MOST_DEVICES)))


READING, WRITING = "reading the study", "tables and pictures"  # phases
EXIT_OK, EXIT_NO_ANSWER, EXIT_BAD_INPUT = 0, 1, 2


def say(text: str, file: TextIO | None = None) -> None:
    """Print text; characters that control a terminal are spelled out.

    Args:
        text: one or several lines.
        file: stream; None is standard output.
    """
    from rvjax._ground import progress

    lines = (
        "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
        for line in text.split("\n")
    )
    with progress.aside():
        print("\n".join(lines), file=file)


def check_files(options: argparse.Namespace, **endings: str | tuple[str, ...]) -> None:
    """Raise an error for a file that could not be written, before any work is done.

    Args:
        options: of the command line.
        **endings: endings that the file of each option may have.
    """
    for option, ending in endings.items():
        path = getattr(options, option)
        name = path if option == "file" else f"--{option} {path}"
        if path is not None and not path.endswith(ending):
            raise ValueError(f"{name}: must end with {ending if isinstance(ending, str) else ' or '.join(ending)}")
        if path is not None and not Path(path).absolute().parent.is_dir():
            raise ValueError(f"{name}: there is no such folder")
