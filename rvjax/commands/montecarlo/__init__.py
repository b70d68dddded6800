"""`rvjax montecarlo`: statistics of a sample of units, any size."""

import contextlib
import dataclasses
import os
import shutil
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rvjax import commands, tolerances
from rvjax._jax.distributed import meet
from rvjax._jax.sizes import CHUNK
from rvjax.base import progress
from rvjax.commands.cells import evaluated, failures_text, met_text, rejects_texts, searched_texts, share
from rvjax.commands.forecast import forewarn, unit_seconds
from rvjax.commands.montecarlo import batch
from rvjax.render import Column, Note, Number, Quantity, Report, Table, Text
from rvjax.study import Study
from rvjax.tolerances import ENDINGS, Folder, Processes, Statistics, UnitFile


@dataclass(kw_only=True)
class MontecarloInputs(commands.Inputs):
    """Sample units of a study with random errors and print the statistics of their responses. Memory does not grow with
    the number of units; all local devices share the work.

    examples:
      rvjax montecarlo my-study.toml
      rvjax montecarlo my-study.toml --samples 1e8 --checkpoint run.ckpt --json statistics.json
      rvjax montecarlo rv-40e --sobol --samples 65536
      rvjax montecarlo my-study.toml --save units.parquet --save-errors
      srun -n 64 rvjax montecarlo my-study.toml --samples 1e10 --distributed --checkpoint run.ckpt

    With --checkpoint an interrupted run resumes with bit-identical results. More --samples continue a finished run.
    --save may be added later: units that the checkpoint does not contain are computed again from the seed. A failed
    unit counts as a reject, by reason. exit code 0 for any yield.

    With --distributed start the same command once per process, by srun or mpirun; the statistics do not depend on
    the number of processes. A later run may have another number of them.
    """

    source: str = commands.study_argument(": rv-40e-whole (default), rv-40e, corr", default="rv-40e-whole")
    samples: int | None = commands.option(
        "units, such as 250000 or 1e8 (default: the study's certificate_samples)", "N", type=commands.whole_number
    )
    seed: int | None = commands.option("seed of the random numbers (default: the study's)", type=int)
    sobol: bool = commands.switch("scrambled Sobol points (default: random numbers)")
    chunk: int | None = commands.option("units at once (default: 32768)", "N", type=commands.whole_number)
    processes: int = commands.option(
        "processes on this computer (default: 1); with --coordinator: on all computers",
        "N",
        default=1,
        type=commands.whole_number,
    )
    distributed: bool = commands.switch(
        "share the units with the other processes of a Slurm, Open MPI or Kubernetes job; needs --checkpoint in a "
        "shared folder"
    )
    coordinator: str | None = commands.option(
        "with --distributed: address of the first process, where no cluster gives it", "HOST:PORT"
    )
    process_id: int | None = commands.option(
        "with --coordinator: number of this process, 0 to --processes - 1 (default: of srun or mpirun)", "K", type=int
    )
    timeout: int | None = commands.option(
        "with --distributed: seconds to wait for a missing process (default: 120)", "S", type=commands.whole_number
    )
    checkpoint: str | None = commands.option(
        "resume from this file after an interruption; written once a second", "FILE"
    )
    json: str | None = commands.option("write the statistics (default: only print)", "FILE.json", ends=".json")
    save: str | None = commands.option(
        "write every unit: .npz responses and statistics; .csv or .parquet (extra parquet) a table of number, "
        "status and responses in SI, in constant memory",
        "FILE",
        ends=(".npz", *ENDINGS),
    )
    save_errors: bool = commands.switch(
        "write every sampled error too, one column for each element (with --save FILE.csv or .parquet)"
    )
    quiet: bool = commands.quiet_option()
    worker: list[str] | None = commands.option(None, nargs=3)

    def __post_init__(self) -> None:
        """Meet all processes; each core becomes a device."""
        self.table = self.save if self.save and self.save.endswith(ENDINGS) else None
        if self.save_errors and self.table is None:
            raise ValueError(f"--save-errors: needs --save FILE with {' or '.join(ENDINGS)}, not {self.save}")
        if self.table is not None:
            UnitFile(self.table)  # raises an error for a missing extra before any work
        self.group = _group_of(self)
        commands.share_cores(int(self.worker[2]) if self.worker else 1)
        self.shown = not self.quiet
        # The first of several processes has a line of its own, the others are silent.
        self.quiet |= self.processes > 1 if self.group is None else self.group.number > 0
        self.started, self.phases = time.perf_counter(), (commands.READING, COUNTED)


COUNTED = "drawing units"
"""Phase whose part done is known."""


@dataclass(frozen=True)
class Sampled:
    """A sample of a study.

    Attributes:
        study: as it was read before the run; the file may change meanwhile.
        statistics: of its responses.
        device: that computed them, in words.
    """

    study: Study
    statistics: Statistics
    device: str


def compute(inputs: MontecarloInputs) -> Sampled | None:
    """The statistics, after they are written to the files that options name; None in one of several processes."""
    if inputs.worker:
        folder, number, processes = inputs.worker
        part = lambda group: _run(inputs, batch.study_of(inputs.source, group), group)  # noqa: E731
        batch.work(part, folder, int(number), int(processes))
        return None
    with inputs.group or contextlib.nullcontext() as group:
        loaded = batch.study_of(inputs.source, group)
        first = group is None or group.number == 0
        if first:
            forewarn(loaded)
        progress.begin(COUNTED)
        if group is None and inputs.processes > 1:
            device = f"the processor, {inputs.processes} processes"
            found = batch.run_in_processes(inputs.command, inputs.processes, text=loaded.text)
        else:
            with commands.units_placed(lambda: _seconds(inputs, loaded)) as device:
                found = _run(inputs, loaded, group)
    if not first:
        return None
    about = found.study | {"name": inputs.source, "toml": loaded.text}
    if inputs.json is not None:
        tolerances.save(dataclasses.replace(found, values=None), inputs.json, study=about)
    if inputs.save is not None and inputs.table is None:
        tolerances.save(found, inputs.save, study=about)
    return Sampled(loaded, found, device)


def _seconds(inputs: MontecarloInputs, loaded: Study) -> float | None:
    """Seconds of two cores that the units take; None: unknown."""
    unit = unit_seconds(loaded)
    return None if unit is None else unit * (inputs.samples or loaded.certificate_samples)


def _run(inputs: MontecarloInputs, loaded: Study, group: Processes | None) -> Statistics:
    """The statistics, by the units of this process or those of all that share the run."""
    save = inputs.table and batch.table_of(inputs.table, loaded, inputs.source, errors=inputs.save_errors)
    return batch.run(
        loaded,
        samples=inputs.samples or loaded.certificate_samples,
        seed=loaded.seed if inputs.seed is None else inputs.seed,
        method="sobol" if inputs.sobol else "random",
        chunk=inputs.chunk or CHUNK,
        checkpoint=inputs.checkpoint,
        keep=inputs.save is not None and inputs.table is None,
        save=save or None,
        progress=inputs.shown and (group is None or group.number == 0),
        processes=group,
    )


def report(inputs: MontecarloInputs, found: Sampled | None) -> Report:
    """The report on a sample; empty in one of several processes.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    if found is None:
        return Report("", ())
    made = report_on(found.statistics, found.study)
    seconds = time.perf_counter() - inputs.started
    last = f"{seconds:.1f} s, start and compilation included; units on {found.device}"
    return dataclasses.replace(made, content=(*made.content, Note(last)))


def report_on(found: Statistics, study: Study) -> Report:
    """The report on a sample.

    Args:
        found: its statistics.
        study: that it belongs to.
    """
    judging = [name for name, each in (found.yield_ or {}).items() if each is not None]
    head = [
        f"Study {study.name}: {found.samples:,} units, method {found.method}, seed {found.seed}",
        f"{failures_text(found)}; standard errors from {found.standard_errors}",
        *(f"Inaccurate: {line}" for line in study.inaccurate()),
    ]
    rest = "\n".join(_verdicts(found, study))
    statistics = _statistics(found, study, judging)
    tables = [statistics, _yields(found, judging)] if judging else [statistics]
    tables[-1] = dataclasses.replace(tables[-1], note=rest)
    units = {name: study.output(name).unit for name in found.mean}
    return Report(
        title=f"{study.name}: Monte Carlo",
        content=(Note("\n".join(head)), *tables),
        data={"name": study.name, "units": units} | vars(dataclasses.replace(found, values=None)),
    )


def _statistics(found: Statistics, study: Study, judging: list[str]) -> Table:
    percentiles = list(found.quantiles)
    titles = ["mean", "+-", "sd", "least", "most", *(f"{100 * p:g} %" for p in percentiles)]
    numbers = [Number(title, form=".5g", named=False) for title in titles]
    columns = [Text("response"), Text("unit"), *numbers, Number("cpk", form=".3f")]
    rows: list[list[Any]] = []
    for name in found.mean:
        output = study.output(name)
        values = [found.mean[name].value, found.mean[name].error, found.sd[name].value]
        values += [found.minimum[name], found.maximum[name], *(found.quantiles[p][name].value for p in percentiles)]
        cells = [Quantity(float(value), output.unit, read_in=output.read_in) for value in values]
        rows.append([name, output.shown[0], *cells, found.cpk[name] if name in judging else None])
    return Table("statistics", columns, rows)


def _yields(found: Statistics, judging: list[str]) -> Table:
    rows = [[name, share(found.yield_[name]), Quantity.of(found.ppm[name])] for name in judging]
    columns = [Text("requirement"), Column("yield [interval]"), Column("rejects in a million [interval]")]
    return Table("yields", columns, rows)


def _verdicts(found: Statistics, study: Study) -> list[str]:
    """Requirements of a mean or a spread, and all requirements at once."""
    lines = []
    for name, verdict in (found.verdicts or {}).items():
        if verdict.kind != "share":
            value = evaluated(verdict, study.output(name)).text()
            met = met_text(study.requirements[name], verdict, found.samples)
            lines.append(f"{name}: {verdict.wanted}: {value}, {met}")
    lines += [*rejects_texts(study, found).values(), *searched_texts(study, study.tolerances)]
    if found.joint_yield is not None:
        lines.append(f"all requirements at once {share(found.joint_yield).text()}")
    return lines


_PLACES = (("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"), ("PMI_SIZE", "PMI_RANK"), ("SLURM_NTASKS", "SLURM_PROCID"))
"""Variables of a launcher with the count of processes and the number of this one: Open MPI, MPICH, Slurm."""


def _group_of(inputs: MontecarloInputs) -> Folder | None:
    """The processes that the options name, after they have met; None without `--distributed`.

    Args:
        inputs: of the command.

    Raises:
        ValueError: one line that names the option.
    """
    given = {"--coordinator": inputs.coordinator, "--process-id": inputs.process_id, "--timeout": inputs.timeout}
    if not inputs.distributed:
        if alone := [name for name, value in given.items() if value is not None]:
            raise ValueError(f"{alone[0]}: needs --distributed")
        return None
    if inputs.checkpoint is None:
        raise ValueError("--distributed: needs --checkpoint FILE, in a folder that all processes share")
    whole = Path(inputs.checkpoint).absolute()
    if not whole.parent.is_dir():
        raise ValueError(f"--checkpoint {inputs.checkpoint}: there is no such folder")
    limit = float(inputs.timeout or 120)

    def folder_of(count: int) -> bytes:
        for old in whole.parent.glob(f"{whole.name}.run-*"):  # of a run that was killed
            shutil.rmtree(old, ignore_errors=True)
        name = f"{whole.name}.run-{uuid.uuid4().hex[:8]}"
        (whole.parent / name).mkdir()
        return name.encode()

    number, count, said = meet(*_place(inputs), limit=limit, first=folder_of)
    folder, until = whole.parent / said.decode(), time.monotonic() + limit
    while not folder.is_dir():
        if time.monotonic() > until:
            raise ValueError(
                f"--checkpoint {inputs.checkpoint}: process {number + 1} of {count} has no {folder.name} of the first "
                "process there; name the same file, in a folder that all processes share"
            )
        time.sleep(0.1)
    return Folder(folder, number, count, silence=limit)


def _place(inputs: MontecarloInputs) -> tuple[str | None, int | None, int | None]:
    """Address of the first process, count of all, number of this one; None: the cluster says so."""
    if inputs.coordinator is None:
        if inputs.process_id is not None or inputs.processes != 1:
            name = "--processes" if inputs.process_id is None else "--process-id"
            raise ValueError(f"{name}: with --distributed it needs --coordinator HOST:PORT")
        return None, None, None
    host, _, port = inputs.coordinator.rpartition(":")
    if not host or not port.isdigit():
        raise ValueError(f"--coordinator {inputs.coordinator}: must be HOST:PORT of the first process")
    if inputs.process_id is None and inputs.processes == 1:
        for size, rank in _PLACES:
            if size in os.environ and rank in os.environ:
                return inputs.coordinator, int(os.environ[size]), int(os.environ[rank])
    if inputs.process_id is None:
        raise ValueError("--coordinator: needs --processes N and --process-id K, or srun or mpirun")
    if not 0 <= inputs.process_id < inputs.processes:
        raise ValueError(f"--process-id {inputs.process_id}: must be 0 to {inputs.processes - 1}, below --processes")
    return inputs.coordinator, inputs.processes, inputs.process_id
