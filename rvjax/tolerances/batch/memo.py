"""What an interrupted allocation goes on from: every array that took long to compute, by what it was computed from."""

import contextlib
import hashlib
import io
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import numpy as np

from rvjax.files import write_atomically
from rvjax.response import Values

_WORTH = 0.1  # s of computing, below which an array is computed anew
_DIGITS = 32


class Journal:
    """Arrays in a folder. An allocation is deterministic: begun anew, it asks the same and finds the answers there."""

    def __init__(self, folder: str | Path, fingerprint: Mapping[str, str]) -> None:
        """A journal in a folder, which is made when there is something to keep.

        Args:
            folder: of its own.
            fingerprint: all that a response depends on: the study, its files, the versions of rvjax, JAX and SciPy.
        """
        self.folder = Path(folder)
        self._about = repr(sorted(fingerprint.items()))

    def recall(self, asked: Mapping[str, str], compute: Callable[[], np.ndarray]) -> np.ndarray:
        """The array, from the folder where a run before has left it there."""
        name = hashlib.sha256((self._about + repr(sorted(asked.items()))).encode()).hexdigest()[:_DIGITS]
        path = self.folder / f"{name}.npy"
        with contextlib.suppress(ValueError, EOFError, OSError):  # absent or damaged: computed and written
            return np.asarray(np.load(path, allow_pickle=False))
        start = time.monotonic()
        found = np.asarray(compute())
        if time.monotonic() - start >= _WORTH:
            content = io.BytesIO()
            np.save(content, found, allow_pickle=False)
            with contextlib.suppress(OSError):  # a full disk costs the next run its time, not this one its answer
                self.folder.mkdir(parents=True, exist_ok=True)
                write_atomically(path, content.getvalue())
        return found

    def units(
        self, names: tuple[str, ...], asked: Mapping[str, str], compute: Callable[[], tuple[Values, jax.Array]]
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Values by name and status of a block of units."""

        def rows() -> np.ndarray:
            values, status = compute()
            return np.stack([*(np.asarray(values[name]) for name in names), np.asarray(status)])

        *values, status = self.recall(asked, rows)
        return dict(zip(names, values)), status.astype(np.int32)

    def clear(self) -> None:
        """Remove the folder: the answer is there."""
        shutil.rmtree(self.folder, ignore_errors=True)
