"""The processes of a cluster job that share a run: `rvjax montecarlo --distributed`."""

import argparse
import os
import shutil
import time
import uuid
from pathlib import Path

from rvjax._jax.distributed import meet
from rvjax.tolerances import Folder

_PLACES = (("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"), ("PMI_SIZE", "PMI_RANK"), ("SLURM_NTASKS", "SLURM_PROCID"))
"""Variables of a launcher with the count of processes and the number of this one: Open MPI, MPICH, Slurm."""


def group_of(options: argparse.Namespace) -> Folder | None:
    """The processes that the options name, after they have met; None without `--distributed`.

    Args:
        options: of the command line.

    Raises:
        ValueError: one line that names the option.
    """
    given = {"--coordinator": options.coordinator, "--process-id": options.process_id, "--timeout": options.timeout}
    if not options.distributed:
        if alone := [name for name, value in given.items() if value is not None]:
            raise ValueError(f"{alone[0]}: needs --distributed")
        return None
    if options.checkpoint is None:
        raise ValueError("--distributed: needs --checkpoint FILE, in a folder that all processes share")
    whole = Path(options.checkpoint).absolute()
    if not whole.parent.is_dir():
        raise ValueError(f"--checkpoint {options.checkpoint}: there is no such folder")
    limit = float(options.timeout or 120)

    def folder_of(count: int) -> bytes:
        for old in whole.parent.glob(f"{whole.name}.run-*"):  # of a run that was killed
            shutil.rmtree(old, ignore_errors=True)
        name = f"{whole.name}.run-{uuid.uuid4().hex[:8]}"
        (whole.parent / name).mkdir()
        return name.encode()

    number, count, said = meet(*_place(options), limit=limit, first=folder_of)
    folder, until = whole.parent / said.decode(), time.monotonic() + limit
    while not folder.is_dir():
        if time.monotonic() > until:
            raise ValueError(
                f"--checkpoint {options.checkpoint}: process {number + 1} of {count} has no {folder.name} of the first "
                "process there; name the same file, in a folder that all processes share"
            )
        time.sleep(0.1)
    return Folder(folder, number, count, silence=limit)


def _place(options: argparse.Namespace) -> tuple[str | None, int | None, int | None]:
    """Address of the first process, count of all, number of this one; None: the cluster says so."""
    if options.coordinator is None:
        if options.process_id is not None or options.processes != 1:
            name = "--processes" if options.process_id is None else "--process-id"
            raise ValueError(f"{name}: with --distributed it needs --coordinator HOST:PORT")
        return None, None, None
    host, _, port = options.coordinator.rpartition(":")
    if not host or not port.isdigit():
        raise ValueError(f"--coordinator {options.coordinator}: must be HOST:PORT of the first process")
    if options.process_id is None and options.processes == 1:
        for size, rank in _PLACES:
            if size in os.environ and rank in os.environ:
                return options.coordinator, int(os.environ[size]), int(os.environ[rank])
    if options.process_id is None:
        raise ValueError("--coordinator: needs --processes N and --process-id K, or srun or mpirun")
    if not 0 <= options.process_id < options.processes:
        raise ValueError(f"--process-id {options.process_id}: must be 0 to {options.processes - 1}, below --processes")
    return options.coordinator, options.processes, options.process_id
