"""A batch of units of a study, in one process, several of this computer, or those of a cluster job."""

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rvjax import study, tolerances
from rvjax.tolerances import Folder, Processes, Statistics, UnitFile, take

_STUDY = "study"
"""Message with the text of the study."""


def run(loaded: study.Study, **how: Any) -> Statistics:
    """The statistics, in this process or with the others.

    Args:
        loaded: study that is sampled.
        **how: options of `rvjax.tolerances.monte_carlo`.
    """
    response = loaded.at_few(loaded.response(solve=False))
    found = tolerances.monte_carlo(response, loaded.tolerances, requirements=loaded.requirements, **how)
    if found.failed == found.samples:
        loaded.response()  # says so where the unit without errors fails too
    return found


def study_of(source: str, group: Processes | None = None) -> study.Study:
    """The study of a command line, read once: by the first process, or by the command that started all.

    Args:
        source: file, or name of an embedded study.
        group: processes that share the run.
    """
    text = None if group is None else group.get(_STUDY) if group.number == 0 else take(group, _STUDY)
    if text is None:
        found = study.load(source)
        if group is not None:
            group.put(_STUDY, found.text.encode())
        return found
    path = Path(source)
    own = path.suffix == ".toml"
    return study.parse_study(
        text.decode(),
        name=path.stem if own else source,
        folder=path.parent if own else Path(),
        solve=False,  # the first process has
    )


def table_of(path: str, loaded: study.Study, source: str, *, errors: bool) -> UnitFile:
    """Table of units that a command line requires.

    Args:
        path: of the table.
        loaded: study, with the measurement units of the responses.
        source: of the study, as it was named.
        errors: write the sampled errors too.
    """
    units = {name: loaded.output(name).unit for name in loaded.requirements}
    return UnitFile(path, errors, units, {"name": source, "toml": loaded.text})


def run_in_processes(command: Sequence[str], processes: int, *, text: str | None = None) -> Statistics:
    """Start `processes` of this command line, each with `--worker`, and take the result of the first.

    Args:
        command: arguments of `rvjax` that all processes get.
        processes: their number.
        text: of the study, for all processes alike; None: the first reads it.

    Raises:
        ValueError: a process ended without a result; the others are ended too.
    """
    with tempfile.TemporaryDirectory(prefix="rvjax-") as folder:
        # The first one's progress and complaints are for everybody; its result comes as a file, since the
        # libraries below print to standard output.
        logs = [Path(folder) / f"{number}.txt" for number in range(processes)]
        shared = Path(folder) / "shared"
        shared.mkdir()
        if text is not None:
            (shared / _STUDY).write_text(text, "utf-8")
        workers = []
        try:
            for number, log in enumerate(logs):
                arguments = [sys.executable, "-m", "rvjax", *command, "--worker", folder, str(number), str(processes)]
                with log.open("w") as file:
                    shown = None if number == 0 else file
                    workers.append(subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=shown))
            _wait(workers, logs)
        finally:
            for worker in workers:
                with contextlib.suppress(OSError):
                    worker.kill()
                worker.wait()
        return tolerances.load(f"{folder}/result.npz")


def _wait(workers: Sequence[subprocess.Popen[bytes]], logs: Sequence[Path]) -> None:
    while any(worker.poll() is None for worker in workers):
        if any(worker.poll() for worker in workers):  # not 0: the others would wait for it for ever
            break
        time.sleep(0.05)
    for number, (worker, log) in enumerate(zip(workers, logs)):
        if code := worker.poll():
            said = log.read_text(errors="replace").strip().splitlines()
            raise ValueError(f"process {number + 1} of {len(workers)} ended with {code} {said[-1] if said else ''}")


def work(share: Callable[[Processes], Statistics], folder: str, number: int, processes: int) -> None:
    """One of several processes of this computer; the first writes the result.

    Args:
        share: solves the units of this process; returns the statistics of all.
        folder: of the command that started them.
        number: of this process.
        processes: their number.
    """
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    with Folder(Path(folder) / "shared", number, processes) as group:
        found = share(group)
        if number == 0:
            tolerances.save(found, f"{folder}/result.npz")


def _end_with(parent: int) -> None:
    """End this process when its parent has ended: the next run needs its checkpoint."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)
