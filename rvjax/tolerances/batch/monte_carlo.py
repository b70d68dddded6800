"""Monte Carlo: the distribution of a response over units with random errors, in constant memory."""

import contextlib
import dataclasses
import functools
import itertools
import math
import operator
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rvjax.files import DAMAGE
from rvjax.population import SCRAMBLES, Correlation, Estimate, Population, Sampled, check_method, deviate_of
from rvjax.progress import progress_bar
from rvjax.records import PyTree
from rvjax.response import Response, by_response, evaluator, gathered, place, response_names, unwrapped
from rvjax.status import PRECEDENCE
from rvjax.tolerances.batch.accumulator import Accumulator
from rvjax.tolerances.batch.checkpoint import (
    LARGEST,
    Checkpoint,
    describe,
    of_number,
    of_process,
    response_hash,
    versions,
)
from rvjax.tolerances.batch.memo import Memo
from rvjax.tolerances.batch.quantiles import quantile_estimate
from rvjax.tolerances.batch.statistics import Statistics, rejects
from rvjax.tolerances.batch.unit_file import UnitFile, Write, writing
from rvjax.tolerances.requirements.kinds import Limits
from rvjax.tolerances.worst_case import extremes

__all__ = ["Run", "Statistics", "monte_carlo"]


def monte_carlo(
    response: Response,
    tolerances: PyTree,
    *,
    samples: int,
    seed: int,
    method: str = "random",
    chunk: int = 65536,
    requirements: object = None,
    quantiles: tuple[float, ...] = (0.00135, 0.5, 0.99865),
    correlation: Correlation = None,
    confidence: float = 0.95,
    checkpoint: str | Path | None = None,
    checkpoint_every: float = 1.0,
    keep: bool = False,
    save: str | Path | UnitFile | None = None,
    progress: bool = False,
) -> Statistics:
    """Statistics of a response over random units, chunk by chunk.

    Unit i depends on the seed, i, the method and the active fields only. Another chunk size, or another
    number of devices, gives equal counts and values equal to round-off; the same chunk gives the same
    bits, also after an interruption and in any number of processes. Device memory holds two chunks,
    for any `samples`.

    All local devices share every chunk. Where `jax.distributed.initialize` was called, every process
    must call this function alike: each takes every n-th chunk, and all return the same result.

    Method "sobol" takes unit i as point i // 16 of scramble i mod 16 of Sobol points. The error of the mean is then
    smaller for the same number of units, that of extreme quantiles is not; all standard errors and intervals come from
    the spread of the 16 scrambles (a yield or quantile with fewer than 160 units beyond it counts as no better than one
    of independent units).

    Args:
        response: pure function of the errors of one unit; a scalar, a dict or record of scalars, or `Outcome`.
        tolerances: record or dict with a `Tolerance` or None in each field.
        samples: units, at least 1.
        seed: of the random numbers.
        method: "random" or "sobol".
        chunk: units evaluated at once.
        requirements: `Requirement`, or a dict of them by name of the response.
        quantiles: shares whose quantiles are wanted.
        correlation: {(field or element, field or element): correlation of their z}.
        confidence: of every interval.
        checkpoint: file to which the state goes now and again, and from which the same study goes on after an
            interruption, to identical bits; a larger `samples` continues a finished one. Several processes write one
            file each, with the number of the process behind the name.
        checkpoint_every: least time between two states of the checkpoint, s; 0 writes one after each chunk.
        keep: keep the response of every unit (host memory, and the checkpoint, grow with `samples`).
        save: table of every unit, .csv or .parquet, or a `UnitFile` with the choice of columns; memory does not grow
            with `samples`. Units that a checkpoint has counted already are computed again, to the same bits. Several
            processes write one file each, with the number of the process behind the name.
        progress: show a progress bar.

    Returns:
        `Statistics`.

    Raises:
        ValueError: bad arguments, or a checkpoint that is damaged or belongs to another study.
        OSError: the checkpoint, or the table of units, cannot be written at the start (later the former is a warning:
            nothing is lost).
        ImportError: pyarrow is not installed, which .parquet needs.
    """
    check_method(method)
    deviate_of(confidence)
    samples, chunk = _positive("samples", samples), _positive("chunk", chunk)
    if not checkpoint_every >= 0:
        raise ValueError(f"checkpoint_every = {checkpoint_every!r} s: must not be negative")
    if samples > 2**32:
        raise ValueError(f"samples = {samples}: units are numbered with 32 bits")
    for p in quantiles:
        if not 0 < p < 1:
            raise ValueError(f"quantiles: {p!r} must lie between 0 and 1")
    population = Population.of(tolerances, correlation)
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    if keep:
        _check_memory(samples, len(names))
    table = UnitFile(save) if isinstance(save, (str, Path)) else save
    run = Run(
        response, population, names, required, samples, seed, chunk, method, tuple(quantiles), confidence, checkpoint,
        checkpoint_every, keep, table, progress,
    )  # fmt: skip
    return unwrapped(run.statistics())


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
    quantiles: tuple[float, ...] = (0.00135, 0.5, 0.99865)
    confidence: float = 0.95
    checkpoint: str | Path | None = None
    checkpoint_every: float = 1.0
    keep: bool = False
    save: UnitFile | None = None
    progress: bool = False
    label: str = "Monte Carlo"
    memo: Memo | None = None

    def statistics(self) -> Statistics:
        """Draw, evaluate and count all units."""
        study = describe(self.population, self.requirements)
        study |= {"seed": str(self.seed), "method": self.method, "chunk": str(self.chunk)}
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
        study = describe(self.population, self.requirements)
        study |= {"seed": str(self.seed), "method": self.method, "chunk": str(self.chunk)}
        counted = self._empty(keeps=self.keep)
        counted.add(0, 0, values, status)
        return self._figures(counted, study)

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
        nothing, judged = Estimate(*[math.nan] * 4), counted.requirements
        cp, cpk = (
            {name: of(item, judged[name]) if name in judged else nothing for name, item in seen.items()}
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
            minimum={name: item.whole.minimum for name, item in seen.items()},
            maximum={name: item.whole.maximum for name, item in seen.items()},
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
        study["response"] = response_hash(self.response, self.population)
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
                raise ValueError(f"checkpoint = {str(self.checkpoint)!r}: keeps every unit; go on with keep = True")
            _check_memory(self.samples, len(self.names))
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

        def start(first: int) -> tuple[dict[str, Any], Any]:
            if self.memo is None:
                return evaluated.start(first)
            compute = functools.partial(evaluated.start, first)
            return self.memo.units(self.names, asked | {"first": str(first)}, compute)

        label = self.label if processes == 1 else f"{self.label}, process {process + 1} of {processes}"
        reached = first * chunk
        with progress_bar(self.progress, samples, label, "unit", initial=reached) as advance:
            for number, values, status in _chunks(start, counted, range(first, -(-samples // chunk)), chunk, samples):
                own, unit = number % processes == process, number * chunk
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


def _check_memory(samples: int, responses: int) -> None:
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
    start: Callable[[int], tuple[dict[str, Any], Any]], counted: Accumulator, numbers: range, chunk: int, samples: int
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    """Evaluated chunks of this process in order; the device works on the next one while the host reads this one.

    Until the range of the histograms is known, those of other processes too.
    """
    process, processes = place()
    ready = None
    for number in itertools.chain(numbers, [None]):
        after = None
        if number is not None:
            if number % processes != process and counted.settled:
                continue
            after = number, start(number * chunk)
        if ready is not None:
            done, (values, status) = ready
            # The last chunk is evaluated as long as the others, and cut here: nothing is compiled twice.
            count = min(chunk, samples - done * chunk)
            yield done, {name: np.asarray(v)[:count] for name, v in values.items()}, np.asarray(status)[:count]
        ready = after


def _positive(name: str, value: Any) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name} = {value!r}: must be an integer") from None
    if number < 1:
        raise ValueError(f"{name} = {number}: must be at least 1")
    return number
