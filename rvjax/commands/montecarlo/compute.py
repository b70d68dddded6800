"""Statistics of a sample, by one process or several."""

import contextlib
import dataclasses
from dataclasses import dataclass

from rvjax import tolerances
from rvjax._jax.sizes import CHUNK
from rvjax.base import progress
from rvjax.commands.forecast import forewarn, unit_seconds
from rvjax.commands.montecarlo import batch
from rvjax.commands.montecarlo.inputs import Inputs
from rvjax.commands.speak import READING, units_placed
from rvjax.study import Study
from rvjax.tolerances import Processes, Statistics

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


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return READING, COUNTED


def compute(inputs: Inputs) -> Sampled | None:
    """The statistics, after they are written to the files that options name; None in one of several processes."""
    options = inputs.options
    if options.worker:
        folder, number, processes = options.worker
        batch.work(lambda group: _batch(inputs, group), folder, int(number), int(processes))
        return None
    with inputs.group or contextlib.nullcontext() as group:
        wanted = _batch(inputs, group)
        first = group is None or group.number == 0
        if first:
            forewarn(wanted.study)
        progress.begin(COUNTED)
        if group is None and options.processes > 1:
            device = f"the processor, {options.processes} processes"
            found = batch.run_in_processes(options.command, options.processes, text=wanted.study.text)
        else:
            with units_placed(lambda: _seconds(wanted)) as device:
                found = batch.run(wanted)
    if not first:
        return None
    about = found.study | {"name": options.study, "toml": wanted.study.text}
    if options.json is not None:
        tolerances.save(dataclasses.replace(found, values=None), options.json, study=about)
    if wanted.keep:
        tolerances.save(found, options.save, study=about)
    return Sampled(wanted.study, found, device)


def _seconds(wanted: batch.Batch) -> float | None:
    """Seconds of two cores that the units take; None: unknown."""
    unit = unit_seconds(wanted.study)
    return None if unit is None else unit * (wanted.samples or wanted.study.certificate_samples)


def _batch(inputs: Inputs, group: Processes | None = None) -> batch.Batch:
    options = inputs.options
    loaded = batch.study_of(options.study, group)
    save = inputs.table and batch.table_of(inputs.table, loaded, options.study, errors=options.save_errors)
    return batch.Batch(
        study=loaded,
        samples=options.samples,
        seed=options.seed,
        sobol=options.sobol,
        chunk=options.chunk or CHUNK,
        checkpoint=options.checkpoint,
        keep=options.save is not None and inputs.table is None,
        save=save or None,
        progress=not options.quiet and (group is None or group.number == 0),
        processes=group,
    )
