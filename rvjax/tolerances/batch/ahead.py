"""Chunks of a run evaluated ahead of the host, which counts them in order."""

import collections
import functools
import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rvjax._ground.files import Arrays
from rvjax._jax.compile_cache import kept_folder
from rvjax.records import PyTree
from rvjax.response import Evaluator
from rvjax.tolerances.batch.chunks import Chunks

Start = Callable[[int], tuple[dict[str, PyTree], PyTree]]  # first unit -> values and status


def ahead_of(evaluated: Evaluator) -> int:
    """Chunks evaluated at once, each by a thread: two where a command keeps programs and chunks are small."""
    return 2 if kept_folder() is not None and type(evaluated) is Evaluator and not evaluated.shared else 1


def in_order(
    start: Start, numbers: Chunks, chunk: int, samples: int, ahead: int
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    """Evaluated chunks in order; the device works on the next ones while the host reads this one.

    With several ahead, threads start them, for XLA shares out no kernel of a few thousand units; the first chunk, which
    compiles, is started here.

    Args:
        start: begins to evaluate the chunk with this first unit.
        numbers: of the chunks.
        chunk: units of a chunk.
        samples: units of the run.
        ahead: chunks evaluated at once.
    """
    ready: collections.deque[tuple[int, Callable[[], tuple[Arrays, PyTree]]]] = collections.deque()
    with ThreadPoolExecutor(ahead, "units") as threads:
        for number in itertools.chain(numbers, [None] * ahead):
            if number is not None:
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
