"""A Monte Carlo run: units sampled, evaluated and counted chunk by chunk; its checkpoint and table of units."""

import contextlib
import dataclasses
import functools
import json
import math
import os
from pathlib import Path

import numpy as np

from rvjax._jax.distributed import Store, place
from rvjax.base.files import DAMAGE, pack, unpack, versions
from rvjax.base.progress import progress_bar
from rvjax.population import SCRAMBLES, Estimate, Population, Sampled
from rvjax.records import PyTree
from rvjax.response import Evaluator, Response
from rvjax.status import PRECEDENCE
from rvjax.tolerances.batch.checkpoint import (
    LARGEST,
    Checkpoint,
    Memo,
    describe,
    differences,
    of_number,
    parts_of,
    response_hash,
)
from rvjax.tolerances.batch.quantiles import quantile_estimate
from rvjax.tolerances.batch.shares import Alone, Chunks, Processes, in_order, take
from rvjax.tolerances.batch.statistics import Accumulator, Statistics, rejects
from rvjax.tolerances.batch.unit_file import UnitFile, Write, joined, writing
from rvjax.tolerances.limits import Limits
from rvjax.tolerances.worst_case import extremes

QUANTILES = (0.00135, 0.5, 0.99865)
"""Shares whose quantiles are wanted: the median, and 3 sd of a normal distribution on both sides."""


@dataclasses.dataclass(frozen=True)
class Run:
    """A study whose arguments, those of `monte_carlo`, are checked; its statistics are dicts by name."""

    response: Response
    population: Population
    names: tuple[str, ...]
    requirements: dict[str, Limits]
    samples: int
    seed: int
    chunk: int
    method: str = "random"
    quantiles: tuple[float, ...] = QUANTILES
    confidence: float = 0.95
    checkpoint: str | Path | None = None
    checkpoint_every: float = 1.0
    keep: bool = False
    save: UnitFile | None = None
    progress: bool = False
    label: str = "Monte Carlo"
    memo: Memo | None = None
    processes: Processes | None = None

    def statistics(self) -> Statistics:
        """Sample, evaluate and count all units; several processes share them and all return the same result."""
        study, group = self._described(), self.processes or (Store() if place()[1] > 1 else Alone())
        counted, file, numbers, counts = self._begun(study, group)
        with self._saving(study, group) as write:
            self._count(counted, file, numbers, counts, write, group)
        if group.count > 1:
            counted = self._gathered(counted, study, group)
        return _statistics_of(self, counted, study)

    def of_units(self, values: dict[str, np.ndarray], status: np.ndarray) -> Statistics:
        """Statistics of units that are solved.

        Args:
            values: (n,) by name.
            status: (n,).
        """
        study = self._described()
        counted = self._empty(keeps=self.keep)
        counted.add(0, 0, values, counted.judged(values, status))
        return _statistics_of(self, counted, study)

    def z(self) -> np.ndarray:
        """Random numbers (numbers, samples) of all units."""
        count = min(self.chunk, self.samples)
        evaluated = Evaluator(self.response, self.population, self.seed, self.method, count, self.names)
        rows = [np.asarray(evaluated.z(first)) for first in range(0, self.samples, count)]
        return np.concatenate(rows, axis=1)[:, : self.samples]

    def _described(self) -> dict[str, str]:
        """Inputs of the run as text."""
        about = describe(self.population, self.requirements)
        return about | {"seed": str(self.seed), "method": self.method, "chunk": str(self.chunk)}

    def _empty(self, *, keeps: bool) -> Accumulator:
        streams, kept = SCRAMBLES if self.method == "sobol" else 1, self.samples if keeps else 0
        return Accumulator(self.names, self.requirements, streams, kept)

    def _saving(self, study: dict[str, str], group: Processes) -> contextlib.AbstractContextManager[Write | None]:
        """Context that returns the writer of every unit, or None."""
        if self.save is None:
            return contextlib.nullcontext()
        path = of_number(self.save.path, group.number, group.count)
        about = dict(seed=self.seed, samples=self.samples, method=self.method, versions=versions(), study=study)
        return writing(self.save, path, self.names, self.population, about)

    def _begun(self, study: dict[str, str], group: Processes) -> tuple[Accumulator, Checkpoint | None, Chunks, Chunks]:
        """Counts so far in this process, its checkpoint, the chunks to go through, and those that are counted.

        The first process takes in what all processes of the run before have left, however many they were, and says to
        the others what is left to count. Counts are equal with and without kept units. A checkpoint that keeps units
        continues to do so, with or without `keep`; a checkpoint without units gets them.
        """
        counted, file, again, number = self._empty(keeps=self.keep), None, self.save is not None, group.number
        if self.checkpoint is not None:
            if (found := response_hash(self.response, self.population)) is None:
                raise ValueError(
                    f"checkpoint = {str(self.checkpoint)!r}: the response calls a Python function (jax.pure_callback), "
                    "which cannot be compared with that of another run; run without a checkpoint"
                )
            study["response"] = found
            if number == 0:
                counted, file = self._taken_in(study | versions())
                again |= bool(counted.values) and not counted.complete
        about = study | versions() | {"samples": str(self.samples)}
        if number == 0:
            said = {"study": about, "chunks": counted.chunks.ranges, "again": again, "keeps": bool(counted.values)}
            group.put("start", json.dumps(said).encode())
            counts = counted.chunks
        else:
            said = json.loads(take(group, "start"))
            if different := differences(said["study"], about, "in process 1"):
                raise ValueError(f"process {number + 1} of {group.count}: has another study: {different}")
            counted, counts, again = self._empty(keeps=said["keeps"]), Chunks.of(said["chunks"]), said["again"]
            if self.checkpoint is not None:
                path = of_number(self.checkpoint, number, group.count)
                file = Checkpoint(path, study | versions(), every=self.checkpoint_every)
                file.save(functools.partial(counted.state, 0), now=True)
        total = -(-self.samples // self.chunk)
        return counted, file, (Chunks.up_to(total) if again else counts.rest(total)).share(number, group.count), counts

    def _taken_in(self, about: dict[str, str]) -> tuple[Accumulator, Checkpoint]:
        """Counts of all checkpoints of the study, now in the file of the first process; the others are removed."""
        assert self.checkpoint is not None
        largest = LARGEST * (1 + len(self.names)) + 16 * self.samples * len(self.names)
        counted, parts = self._empty(keeps=self.keep), parts_of(self.checkpoint)
        for path in (self.checkpoint, *parts):
            file = Checkpoint(path, about, every=self.checkpoint_every)
            if not (state := file.load(largest)):
                continue
            kept = any(key.endswith("/values") for key in state)
            if kept and not counted.values:
                check_memory(self.samples, len(self.names))
                more = self._empty(keeps=True)
                more.merge(counted.state(0))
                counted = more
            try:
                self._empty(keeps=kept).check(state, self.chunk)
                chunks = Chunks.of(state["chunks"])
                units = chunks.stop * self.chunk
                if units <= self.samples:  # a run that was killed here has taken them in already
                    (counted.fill if chunks.within(counted.chunks) else counted.merge)(state)
            except DAMAGE as error:
                raise file.damaged(error) from None
            if units > self.samples:
                where = f"checkpoint = {str(self.checkpoint)!r} holds {units} already"
                raise ValueError(f"samples = {self.samples}: {where}")
        file = Checkpoint(self.checkpoint, about, every=self.checkpoint_every)
        if parts:
            file.save(functools.partial(counted.state, counted.chunks.stop * self.chunk), now=True)
            for path in parts:
                path.unlink(missing_ok=True)
        return counted, file

    def _count(
        self,
        counted: Accumulator,
        file: Checkpoint | None,
        numbers: Chunks,
        counts: Chunks,
        write: Write | None,
        group: Processes,
    ) -> None:
        """Go through chunks; those that some process has counted already are only kept or written.

        Args:
            counted: counts of this process.
            file: its checkpoint.
            numbers: chunks of this process.
            counts: chunks that are counted.
            write: writes units, or None.
            group: all processes.
        """
        samples, chunk = self.samples, self.chunk
        count = min(chunk, samples)
        evaluated = Evaluator(self.response, self.population, self.seed, self.method, count, self.names)
        asked = describe(self.population, {}) | {"seed": str(self.seed), "method": self.method, "count": str(count)}

        def start(first: int) -> tuple[dict[str, PyTree], PyTree]:
            if self.memo is None:
                return evaluated.start(first)
            compute = functools.partial(evaluated.start, first)
            return self.memo.units(self.names, asked | {"first": str(first)}, compute)

        label = self.label if group.count == 1 else f"{self.label}, process {group.number + 1} of {group.count}"
        whole = samples // chunk  # a larger study evaluates a shorter last chunk whole: no checkpoint has it
        last = max((min(stop, whole) for first, stop in numbers.ranges if first < whole), default=0) - 1
        own = numbers.count * chunk - max(numbers.stop * chunk - samples, 0)
        total, agreed = samples if group.count == 1 else own, group.count == 1

        def state() -> dict[str, np.ndarray]:
            return counted.state(counted.chunks.stop * chunk)

        with progress_bar(self.progress, total, label, "unit", initial=total - own) as advance:
            for number, values, status in in_order(start, numbers, chunk, samples):
                try:
                    group.check()
                except ValueError:
                    if file is not None:
                        file.save(state, now=True)
                    raise
                unit, status = number * chunk, counted.judged(values, status)
                if number in counts:
                    counted.keep(unit, values, status)
                else:
                    counted.add(number, unit, values, status)
                    agreed = agreed or counted.agree(group)
                if write:
                    write(unit, values, status, evaluated.errors(unit) if self.save and self.save.errors else {})
                if file is not None and number <= last:
                    file.save(state, now=number == last)
                advance(len(status))
        if not agreed:
            counted.agree(group, last=True)

    def _gathered(self, counted: Accumulator, study: dict[str, str], group: Processes) -> Accumulator:
        """Counts of all processes, one after the other in the first, then in all."""
        if group.number:
            group.put(f"state-{group.number}", pack(counted.state(self.samples)))
            counted = self._empty(keeps=bool(counted.values))
            counted.merge(unpack(take(group, "result")))
        else:
            for number in range(1, group.count):
                counted.merge(unpack(take(group, f"state-{number}")))
            if self.checkpoint is not None:
                self._taken_in(study | versions())
            if self.save is not None:
                path = Path(self.save.path)
                joined([of_number(path, number, group.count) for number in range(group.count)], path)
            group.put("result", pack(counted.state(self.samples)))
        group.end()
        return counted


def _statistics_of(run: Run, counted: Accumulator, study: dict[str, str]) -> Statistics:
    """Statistics of all counted units, as dicts by name of the response."""
    wide = [name for name, item in run.requirements.items() if item.of_extremes]
    ends = {name: extremes(run.response, run.population, run.names, name).values for name in wide}
    ranges = {name: (float(low), float(high)) for name, (low, high) in ends.items()}
    named = [status for status in PRECEDENCE if int(status) in counted.failures]
    seen = {
        name: Sampled(
            [tree.total() for tree in trees],
            counted.passed.get(name),
            counted.seen,
            run.confidence,
            ranges.get(name, (math.nan, math.nan)),
        )
        for name, trees in counted.moments.items()
    }
    orders, any_units = counted.orders().items(), bool(counted.requirements)
    yields = {name: None if item.passed is None else item.share() for name, item in seen.items()}
    nothing, limited = Estimate(*[math.nan] * 4), counted.requirements
    cp, cpk = (
        {name: of(item, limited[name]) if name in limited else nothing for name, item in seen.items()}
        for of in (Sampled.cp, Sampled.cpk)
    )
    return Statistics(
        samples=int(counted.seen.sum()),
        seed=run.seed,
        method=run.method,
        standard_errors="independent units" if counted.streams == 1 else f"{counted.streams} independent scrambles",
        confidence=run.confidence,
        failed=sum(counted.failures.values()),
        failures={status.name: counted.failures[int(status)] for status in named},
        examples={status.name: counted.examples[int(status)] for status in named},
        worst_index=counted.examples[int(named[0])] if named else None,
        mean={name: item.mean() for name, item in seen.items()},
        sd={name: item.sd() for name, item in seen.items()},
        quantiles={p: {n: quantile_estimate(o, p, run.confidence) for n, o in orders} for p in run.quantiles},
        minimum={n: -math.inf if counted.infinite[n][0] else item.whole.minimum for n, item in seen.items()},
        maximum={n: math.inf if counted.infinite[n][1] else item.whole.maximum for n, item in seen.items()},
        infinite={name: int(units.sum()) for name, units in counted.infinite.items()},
        yield_=yields if any_units else None,
        ppm={name: rejects(share) for name, share in yields.items()} if any_units else None,
        cp={name: figure.value for name, figure in cp.items()} if any_units else None,
        cpk={name: figure.value for name, figure in cpk.items()} if any_units else None,
        cp_estimate=cp if any_units else None,
        cpk_estimate=cpk if any_units else None,
        joint_yield=next(iter(seen.values())).share(counted.joint) if any_units else None,
        verdicts={name: item.verdict(seen[name]) for name, item in run.requirements.items()} or None,
        values=(counted.values or None) if run.keep else None,
        study=study,
        versions=versions(),
    )


def check_memory(samples: int, responses: int) -> None:
    """Raise a ValueError for more values than half the memory holds: they are also sorted and saved."""
    if not hasattr(os, "sysconf"):  # Windows does not say
        return
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if 8 * samples * responses > memory / 2:
        raise ValueError(
            f"keep = True: {samples} units need {8 * samples * responses / 2**30:.3g} GiB, more than half of this "
            f"computer's {memory / 2**30:.3g} GiB; without keep memory does not grow with samples"
        )
