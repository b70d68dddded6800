"""A batch of units of a study: what `rvjax montecarlo` runs, in one process or several, and prints."""

import contextlib
import dataclasses
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rvjax import study, tolerances
from rvjax._jax.blocks import CHUNK
from rvjax.tolerances import Statistics, UnitFile, joined

_STUDY = "study.toml"


@dataclasses.dataclass(frozen=True)
class Batch:
    """Arguments of a run.

    Attributes:
        study: sampled study.
        samples: units; None: as many as the study certifies with.
        seed: None: that of the study.
        sobol: Sobol points instead of random numbers.
        chunk: units at once.
        checkpoint: file to continue from, or None.
        keep: keep the responses of every unit.
        save: table that every unit goes to, or None.
        progress: show a progress bar.
    """

    study: study.Study
    samples: int | None = None
    seed: int | None = None
    sobol: bool = False
    chunk: int = CHUNK
    checkpoint: str | None = None
    keep: bool = False
    save: UnitFile | None = None
    progress: bool = False


def run(batch: Batch) -> Statistics:
    """The statistics, in this process or, where JAX's distributed runtime is on, with the others."""
    loaded = batch.study
    found = tolerances.monte_carlo(
        loaded.response(solve=False),
        loaded.tolerances,
        samples=loaded.certificate_samples if batch.samples is None else batch.samples,
        seed=loaded.seed if batch.seed is None else batch.seed,
        method="sobol" if batch.sobol else "random",
        chunk=batch.chunk,
        requirements=loaded.requirements,
        checkpoint=batch.checkpoint,
        keep=batch.keep,
        save=batch.save,
        progress=batch.progress,
    )
    if found.failed == found.samples:
        loaded.response()  # says so where the unit without errors fails too
    return found


def study_of(source: str, worker: Sequence[str] | None = None) -> study.Study:
    """The study of a command line, read once.

    Args:
        source: file, or name of an embedded study.
        worker: of one of several processes: the text that the first process read is next to its target.
    """
    if worker is None or not (copy := Path(worker[-1]).with_name(_STUDY)).is_file():
        return study.load(source)
    path = Path(source)
    own = path.suffix == ".toml"
    return study.parse_study(
        copy.read_text("utf-8"),
        name=path.stem if own else source,
        folder=path.parent if own else Path(),
        solve=False,  # the first process has
    )


def table_of(
    path: str, loaded: study.Study, source: str, *, errors: bool, worker: Sequence[str] | None = None
) -> UnitFile:
    """Table of units that a command line requires.

    Args:
        path: of the table.
        loaded: study, with the measurement units of the responses.
        source: of the study, as it was named.
        errors: write the sampled errors too.
        worker: of one of several processes: its part is next to its target.
    """
    units = {name: loaded.output(name).unit for name in loaded.requirements}
    own = path if worker is None else Path(worker[-1]).with_name(Path(path).name)
    return UnitFile(own, errors, units, {"name": source, "toml": loaded.text})


def run_in_processes(
    command: Sequence[str], processes: int, *, text: str | None = None, table: str | None = None, chunk: int = CHUNK
) -> Statistics:
    """Start `processes` of this command line, each with `--worker`, and take the result of the first.

    Args:
        command: arguments of `rvjax` that all processes get.
        processes: their number.
        text: of the study, for all processes alike; None: each reads it.
        table: of every unit, of which each process writes a part.
        chunk: units at once.

    Raises:
        ValueError: a process ended without a result; the others are ended too.
    """
    beside = None if table is None else Path(table).absolute().parent  # a disk with space for all units
    with tempfile.TemporaryDirectory(prefix="rvjax-", dir=beside) as folder:
        # The first one's progress and complaints are for everybody; its result comes as a file, since the
        # libraries below print to standard output.
        logs = [Path(folder) / f"{number}.txt" for number in range(processes)]
        if text is not None:
            (Path(folder) / _STUDY).write_text(text, "utf-8")
        workers, address = [], f"127.0.0.1:{_free_port()}"
        try:
            for number, log in enumerate(logs):
                here = [address, str(number), str(processes), f"{folder}/result.npz"]
                arguments = [sys.executable, "-m", "rvjax", *command, "--worker", *here]
                with log.open("w") as file:
                    shown = None if number == 0 else file
                    workers.append(subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=shown))
            _wait(workers, logs)
        finally:
            for worker in workers:
                with contextlib.suppress(OSError):
                    worker.kill()
                worker.wait()
        if table is not None:
            whole = Path(folder) / Path(table).name
            parts = [whole.with_name(f"{whole.name}.{number}-of-{processes}") for number in range(processes)]
            joined(parts, Path(table), chunk)
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


def work(inputs: Callable[[], Batch], address: str, number: int, processes: int, target: str) -> None:
    """One of several processes; the first writes the result.

    Args:
        inputs: makes what to run, which may compute and so comes after the processes have found each other.
        address: of the first process.
        number: of this process.
        processes: their number.
        target: file for the result.
    """
    import jax

    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    jax.distributed.initialize(address, num_processes=processes, process_id=number)
    try:
        batch = inputs()
        found = run(dataclasses.replace(batch, progress=batch.progress and number == 0))
        if number == 0:
            tolerances.save(found, target)
    except (ValueError, OSError) as error:
        print(f"rvjax: error: {' '.join(str(error).split())}", file=sys.stderr, flush=True)
        os._exit(2)  # an orderly exit would wait for the others, who wait for this one


def _end_with(parent: int) -> None:
    """End this process when its parent has ended: the next run needs its checkpoint."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)


def _free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]
