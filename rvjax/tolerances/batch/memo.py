"""Memo of an allocation: expensive arrays, by their inputs.

An interrupted allocation resumes from it with bit-identical results.
"""

import contextlib
import hashlib
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import numpy as np

from rvjax.base.files import DAMAGE, pack, unpack, write_atomically
from rvjax.response import Values

_DIGITS = 32


class Memo:
    """Arrays in a folder. An allocation is deterministic: a second run requires the same arrays and reads them here."""

    def __init__(self, folder: str | Path, fingerprint: Mapping[str, str], *, worth: float = 0.1) -> None:
        """Name the folder; the first array makes it.

        Args:
            folder: that holds nothing else.
            fingerprint: all that a response depends on: the study, its files, the versions of rvjax, JAX and SciPy.
            worth: computing time below which an array is not stored, s.
        """
        self.folder, self._worth = Path(folder), worth
        self._about = repr(sorted(fingerprint.items()))

    def apart(self, what: str) -> "Memo":
        """Memo in the same folder for another response of the same study.

        Args:
            what: in which it differs.
        """
        return Memo(self.folder, {"of": self._about, "apart": what}, worth=self._worth)

    def recall(self, inputs: Mapping[str, str], compute: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the stored array, or compute and store it."""
        name = hashlib.sha256((self._about + repr(sorted(inputs.items()))).encode()).hexdigest()[:_DIGITS]
        path = self.folder / f"{name}.npz"
        with contextlib.suppress(*DAMAGE, OSError):  # absent or damaged: computed and written
            return unpack(path.read_bytes())["found"]
        start = time.monotonic()
        found = np.asarray(compute())
        if time.monotonic() - start >= self._worth:
            with contextlib.suppress(OSError):  # a full disk costs the next run time, not this one its result
                self.folder.mkdir(parents=True, exist_ok=True)
                write_atomically(path, pack({"found": found}))
        return found

    def units(
        self, names: tuple[str, ...], inputs: Mapping[str, str], compute: Callable[[], tuple[Values, jax.Array]]
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return values by name and status of a block of units, stored or computed."""

        def rows() -> np.ndarray:
            values, status = compute()
            return np.stack([*(np.asarray(values[name]) for name in names), np.asarray(status)])

        *values, status = self.recall(inputs, rows)
        return dict(zip(names, values)), status.astype(np.int32)

    def clear(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
