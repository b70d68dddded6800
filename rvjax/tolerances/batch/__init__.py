"""Monte Carlo: the distribution of a response over units with random errors, in constant memory."""

from pathlib import Path

from rvjax._jax.checks import checked
from rvjax.population import SCRAMBLES, Correlation, Population, check_method, deviate_of
from rvjax.records import PyTree
from rvjax.response import Response, by_response, response_names, unwrapped
from rvjax.tolerances.batch.run import QUANTILES, Run, check_memory
from rvjax.tolerances.batch.shares import Processes
from rvjax.tolerances.batch.statistics import Statistics
from rvjax.tolerances.batch.unit_file import UnitFile
from rvjax.tolerances.limits import Limits

__all__ = ["monte_carlo"]


@checked
def monte_carlo(
    response: Response,
    tolerances: PyTree,
    *,
    samples: int,
    seed: int,
    method: str = "random",
    chunk: int = 65536,
    requirements: object = None,
    quantiles: tuple[float, ...] = QUANTILES,
    correlation: Correlation = None,
    confidence: float = 0.95,
    checkpoint: str | Path | None = None,
    checkpoint_every: float = 1.0,
    keep: bool = False,
    save: str | Path | UnitFile | None = None,
    progress: bool = False,
    processes: Processes | None = None,
) -> Statistics:
    """Statistics of a response over random units, chunk by chunk.

    Unit i depends on the seed, i, the method and the active fields only. Another chunk size, or another
    number of devices, gives equal counts and values equal to round-off; the same chunk gives the same
    bits, also after an interruption and in any number of processes. Device memory holds two chunks,
    for any `samples`.

    All local devices share every chunk. Where `jax.distributed.initialize` was called, every process
    must call this function alike: each evaluates its share of the chunks, and all return the same result.

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
            interruption, to identical bits, also with another number of processes; a larger `samples` continues a
            finished one. Several processes need a folder that they share.
        checkpoint_every: least time between two states of the checkpoint, s; 0 writes one after each chunk.
        keep: keep the response of every unit (host memory, and the checkpoint, grow with `samples`).
        save: table of every unit, .csv or .parquet, or a `UnitFile` with the choice of columns; memory does not grow
            with `samples`. Units that a checkpoint has counted already are computed again, to the same bits. Several
            processes need a folder that they share.
        progress: show a progress bar.
        processes: that share the run; None: those of JAX's distributed runtime.

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
    if samples > (most := 2**32 * SCRAMBLES if method == "sobol" else 2**53):
        raise ValueError(f"samples = {samples}: must be at most {most} with method = {method!r}")
    for p in quantiles:
        if not 0 < p < 1:
            raise ValueError(f"quantiles: {p!r} must lie between 0 and 1")
    population = Population.of(tolerances, correlation)
    names = response_names(response, population)
    required = by_response(requirements, names, Limits, "requirements")
    if keep:
        check_memory(samples, len(names))
    table = UnitFile(save) if isinstance(save, (str, Path)) else save
    run = Run(
        response, population, names, required, samples, seed, chunk, method, tuple(quantiles), confidence, checkpoint,
        checkpoint_every, keep, table, progress, processes=processes,
    )  # fmt: skip
    return unwrapped(run.statistics())


def _positive(name: str, value: int) -> int:
    if value < 1:
        raise ValueError(f"{name} = {value}: must be at least 1")
    return int(value)
