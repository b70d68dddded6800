"""Several processes, or hosts, on one study: JAX's distributed runtime joins what each has counted."""

import jax
import numpy as np

from rvjax.tolerances.propagation.checkpoint import Arrays, packed, unpacked


def place() -> tuple[int, int]:
    """Number of this process, and of all; (0, 1) unless `jax.distributed.initialize` was called."""
    return jax.process_index(), jax.process_count()


def gathered(state: Arrays) -> list[dict[str, np.ndarray]]:
    """The states of all processes, in their order, in every process; waits until all have come here."""
    from jax.experimental import multihost_utils

    content = np.frombuffer(packed(state), np.uint8)
    lengths = np.ravel(multihost_utils.process_allgather(np.array([content.size], np.int32)))
    padded = np.zeros(int(lengths.max()), np.uint8)
    padded[: content.size] = content
    rows = np.asarray(multihost_utils.process_allgather(padded)).reshape(len(lengths), -1)
    return [unpacked(row[:length].tobytes()) for row, length in zip(rows, lengths)]
