"""A Monte Carlo run: units sampled, evaluated and counted chunk by chunk; its checkpoint and table of units."""

import collections
import contextlib
import dataclasses
import functools
import itertools
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from rvjax._ground.files import DAMAGE, Arrays, versions
from rvjax._ground.progress import progress_bar
from rvjax._jax.callbacks import UnseenFunction
from rvjax._jax.compile_cache import kept_folder
from rvjax.population import SCRAMBLES, Estimate, Population, Sampled
from rvjax.records import PyTree
from rvjax.response import Evaluator, Response, evaluator, gathered, place
from rvjax.status import PRECEDENCE
from rvjax.tolerances.batch.accumulator import Accumulator
from rvjax.tolerances.batch.checkpoint import (
    LARGEST,
    Checkpoint,
    describe,
    of_number,
    of_process,
    response_hash,
)
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.quantiles import quantile_estimate
from rvjax.tolerances.batch.statistics import Statistics, rejects
from rvjax.tolerances.batch.unit_file import UnitFile, Write, writing
from rvjax.tolerances.requirements.kinds import Limits
from rvjax.tolerances.worst_case import extremes

Start = Callable[[int], tuple[dict[str, PyTree], PyTree]]  # first unit -> values and status
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

    def statistics(self) -> Statistics:
        """Sample, evaluate and count all units."""
        study = self._described()
        with self._saving(study) as write:
            counted, file, done, kept = self._begun(study)
            self._count(counted, file, done, 0 if write or (self.keep and not kept) else done, write)
        if place()[1] > 1:
            states, counted = gathered(counted.state(self.samples)), self._empty(keeps=bool(counted.values))
            for part in states:
                counted.merge(part)
        return self._figures(counted, study)

    def of_units(self, values: dict[str, np.ndarray], status: np.ndarray) -> Statistics:
        """Statistics of units that are solved.

        Args:
            values: (n,) by name.
            status: (n,).
        """
        study = self._described()
        counted = self._empty(keeps=self.keep)
        counted.add(0, 0, values, counted.judged(values, status))
        return self._figures(counted, study)

    def _described(self) -> dict[str, str]:
        """Inputs of the run as text."""
        about = describe(self.population, self.requirements)
        return about | {"seed": str(self.seed), "method": self.method, "chunk": str(self.chunk)}

    def _figures(self, counted: Accumulator, study: dict[str, str]) -> Statistics:
        """Statistics of all units, as dicts by name of the response."""
        named = [status for status in PRECEDENCE if int(status) in counted.failures]
        seen = {
            name: Sampled(
                [tree.total() for tree in trees],
                counted.passed.get(name),
                counted.seen,
                self.confidence,
                self._extremes(name),
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
            seed=self.seed,
            method=self.method,
            standard_errors="independent units" if counted.streams == 1 else f"{counted.streams} independent scrambles",
            confidence=self.confidence,
            failed=sum(counted.failures.values()),
            failures={status.name: counted.failures[int(status)] for status in named},
            examples={status.name: counted.examples[int(status)] for status in named},
            worst_index=counted.examples[int(named[0])] if named else None,
            mean={name: item.mean() for name, item in seen.items()},
            sd={name: item.sd() for name, item in seen.items()},
            quantiles={p: {n: quantile_estimate(o, p, self.confidence) for n, o in orders} for p in self.quantiles},
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
            verdicts={name: item.verdict(seen[name]) for name, item in self.requirements.items()} or None,
            values=(counted.values or None) if self.keep else None,
            study=study,
            versions=versions(),
        )

    def _extremes(self, name: str) -> tuple[float, float]:
        """Return the range of a response over the limits of all errors, where its requirement needs it."""
        if name not in self.requirements or not self.requirements[name].of_extremes:
            return math.nan, math.nan
        low, high = extremes(self.response, self.population, self.names, name).values
        return float(low), float(high)

    def _empty(self, *, keeps: bool) -> Accumulator:
        streams, kept = SCRAMBLES if self.method == "sobol" else 1, self.samples if keeps else 0
        return Accumulator(self.names, self.requirements, streams, kept)

    def _saving(self, study: dict[str, str]) -> contextlib.AbstractContextManager[Write | None]:
        """Context that returns the writer of every unit, or None."""
        if self.save is None:
            return contextlib.nullcontext()
        path, (process, processes) = Path(self.save.path), place()
        about = dict(seed=self.seed, samples=self.samples, method=self.method, versions=versions(), study=study)
        own = path if processes == 1 else of_number(path, process, processes)
        return writing(self.save, own, self.names, self.population, about)

    def _begun(self, study: dict[str, str]) -> tuple[Accumulator, Checkpoint | None, int, bool]:
        """Counts so far, their checkpoint, number of the next chunk, and True if its units need no further check.

        Counts are equal with and without kept units. A checkpoint that keeps units continues to do so, with or without
        `keep`; a checkpoint without units gets them.
        """
        if self.checkpoint is None:
            return self._empty(keeps=self.keep), None, 0, True
        process, processes = place()
        try:
            study["response"] = response_hash(self.response, self.population)
        except UnseenFunction as error:
            raise ValueError(f"checkpoint = {str(self.checkpoint)!r}: {error}; run without a checkpoint") from None
        mine = {"process": f"{process} of {processes}"}
        path, about = of_process(self.checkpoint, process, processes), study | mine | versions()
        file = Checkpoint(path, about, every=self.checkpoint_every)
        done, state = file.load(LARGEST * (1 + len(self.names)) + 16 * self.samples * len(self.names))
        if done * self.chunk > self.samples:
            where = f"checkpoint = {str(self.checkpoint)!r} holds {done * self.chunk} already"
            raise ValueError(f"samples = {self.samples}: {where}")
        kept = any(key.endswith("/values") for key in state)
        if kept and not self.keep:
            if processes > 1:  # of which some may have kept them and some not
                raise ValueError(f"checkpoint = {str(self.checkpoint)!r}: stores every unit; continue with keep = True")
            check_memory(self.samples, len(self.names))
        counted = self._empty(keeps=self.keep or kept)
        if done or state:
            try:
                seen = self._empty(keeps=kept)
                seen.check(state, len(range(process, done, processes)) * self.chunk)
                counted.merge(state)
            except DAMAGE as error:
                raise file.damaged(error) from None
        return counted, file, done, kept or not done

    def _count(self, counted: Accumulator, file: Checkpoint | None, done: int, first: int, write: Write | None) -> None:
        """Chunks from `first` on; those before `done` are counted already, and only kept or written."""
        samples, chunk = self.samples, self.chunk
        process, processes = place()
        count = min(chunk, samples)
        evaluated = evaluator(self.response, self.population, self.seed, self.method, count)
        asked = describe(self.population, {}) | {"seed": str(self.seed), "method": self.method, "count": str(count)}

        def start(first: int) -> tuple[dict[str, PyTree], PyTree]:
            if self.memo is None:
                return evaluated.start(first)
            compute = functools.partial(evaluated.start, first)
            return self.memo.units(self.names, asked | {"first": str(first)}, compute)

        label = self.label if processes == 1 else f"{self.label}, process {process + 1} of {processes}"
        reached = first * chunk
        with progress_bar(self.progress, samples, label, "unit", initial=reached) as advance:
            numbers = range(first, -(-samples // chunk))
            for number, values, status in _chunks(start, counted, numbers, chunk, samples, _ahead(evaluated)):
                own, unit = number % processes == process, number * chunk
                status = counted.judged(values, status)
                if number >= done:
                    counted.add(number, unit, values, status, own=own)
                elif own:
                    counted.keep(unit, values, status)
                    if file is not None and self.keep and number + 1 == done:  # the next run finds them
                        file.save(done, functools.partial(counted.state, done * chunk), now=True)
                if write and own:
                    write(unit, values, status, evaluated.errors(unit) if self.save and self.save.errors else {})
                # A larger study evaluates a shorter last chunk whole.
                if file is not None and own and number >= done and len(status) == chunk:
                    last = (number + 1 + processes) * chunk > samples
                    file.save(number + 1, functools.partial(counted.state, (number + 1) * chunk), now=last)
                advance(min((number + 1) * chunk, samples) - reached)
                reached = min((number + 1) * chunk, samples)
            advance(samples - reached)  # the last chunks may be other processes'


def _ahead(evaluated: Evaluator) -> int:
    """Chunks evaluated at once, each by a thread: two where a command keeps programs and chunks are small."""
    return 2 if kept_folder() is not None and type(evaluated) is Evaluator and not evaluated.shared else 1


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


def _chunks(
    start: Callable[[int], tuple[dict[str, PyTree], PyTree]],
    counted: Accumulator,
    numbers: range,
    chunk: int,
    samples: int,
    ahead: int,
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    """Evaluated chunks of this process in order; the device works on the next ones while the host reads this one.

    Until the range of the histograms is known, those of other processes too. With several ahead, threads start them,
    for XLA shares out no kernel of a few thousand units; the first chunk, which compiles, is started here.
    """
    process, processes = place()
    ready: collections.deque[tuple[int, Callable[[], tuple[Arrays, PyTree]]]] = collections.deque()
    with ThreadPoolExecutor(ahead, "units") as threads:
        for number in itertools.chain(numbers, [None] * ahead):
            if number is not None:
                if number % processes != process and counted.settled:
                    continue
                if ahead > 1 and ready:
                    waiting = threads.submit(_finished, start, number * chunk)
                    ready.append((number, waiting.result))
                else:
                    ready.append((number, functools.partial(tuple, start(number * chunk))))
            if len(ready) > ahead or (number is None and ready):
                done, wait = ready.popleft()
                values, status = wait()
                # The last chunk is evaluated as long as the others, and cut here: nothing is compiled twice.
                count = min(chunk, samples - done * chunk)
                yield done, {name: np.asarray(v)[:count] for name, v in values.items()}, np.asarray(status)[:count]


def _finished(start: Callable[[int], tuple[dict[str, PyTree], PyTree]], first: int) -> tuple[Arrays, np.ndarray]:
    """Values and status of a chunk, computed."""
    values, status = start(first)
    return {name: np.asarray(row) for name, row in values.items()}, np.asarray(status)
