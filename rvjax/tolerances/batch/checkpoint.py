"""Checkpoints of a Monte Carlo study, and the fingerprint that distinguishes two studies."""

import glob
import hashlib
import json
import operator
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._ground.files import DAMAGE, PARTIAL, Arrays, digest, pack, unpack, write_atomically
from rvjax.population import Population
from rvjax.records import PyTree, Record
from rvjax.response import Response, respond
from rvjax.tolerances.requirements.kinds import Limits

_SHARE = 10  # times as long computing as writing
_FORMAT = 3
LARGEST = 2**26
"""Bytes of a state for each response, at most: 16 histograms and what waits for one are 16 MiB."""


def describe(population: Population, requirements: Mapping[str, Limits]) -> dict[str, str]:
    """Tolerances, correlation and requirements as text, exact to the last bit."""
    about = {f"tolerances.{name}": tolerance.described() for name, tolerance in population.active.items()}
    about |= {f"tolerances.{n}": repr(np.asarray(value).tolist()) for n, value in population.constants.items()}
    about |= {f"values.{n}": repr(float(value)) for n, value in (population.values or {}).items()}
    if population.mixing is not None:
        about["correlation"] = hashlib.sha256(np.ascontiguousarray(population.mixing, float).tobytes()).hexdigest()
    about |= {f"requirements.{name}": repr(item) for name, item in requirements.items()}
    return about


def response_hash(response: Response, population: Population) -> str:
    """Hash of the program that the response compiles to, constants and a record's numbers included.

    Limits of tolerances do not enter. Of a Python function that it calls back, code and data count.

    Raises:
        UnseenFunction: a Python function that cannot be compared with that of another run.
    """
    z = jax.ShapeDtypeStruct((population.numbers, 1), jnp.result_type(float))
    found = hashlib.sha256(respond.lowered(response, population, z).encode())
    leaves: list[Any] = jax.tree.leaves(response) if isinstance(response, Record) else []
    for array in map(np.asarray, leaves):
        found.update(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


class Checkpoint:
    """The file of one study (and process): read once, then written now and again."""

    def __init__(self, path: str | Path, fingerprint: Mapping[str, str], *, every: float = 1.0) -> None:
        """Name the file.

        Args:
            path: of the file.
            fingerprint: all that the state depends on.
            every: least time between two files, s, or ten times the time to write one; 0 writes after each chunk.
        """
        self._path, self._fingerprint, self._every = Path(path), dict(fingerprint), every
        self._next, self._warned = 0.0, False

    def load(self, largest: int) -> tuple[int, dict[str, np.ndarray]]:
        """Number of the next chunk and the state before it, which is empty at the beginning.

        Raises a ValueError where the file is damaged, larger than `largest` bytes or of another study, an OSError where
        it is out of reach.
        """
        try:
            if (size := self._path.stat().st_size) > largest:
                raise ValueError(f"{size} bytes, a checkpoint of this study has {largest} at most")
            arrays = unpack(self._path.read_bytes())
            about = json.loads(arrays.pop("about").tobytes())
            if about["format"] != _FORMAT:
                raise ValueError(f"format {about['format']!r}, this version reads {_FORMAT}")
            written, chunk = dict(about["fingerprint"]), operator.index(about["next"])
            if chunk < 0 or about["digest"] != digest(arrays):
                raise ValueError("its contents are not those that were written")
        except FileNotFoundError:
            self._write(0, {})  # a place that cannot be written raises an error before anything is computed
            return 0, {}
        except DAMAGE as error:
            raise self.damaged(error) from None
        here = self._fingerprint
        different = [
            f"{key} is {written.get(key, 'absent')} in the file and {here.get(key, 'absent')} here"
            for key in sorted(written.keys() | here.keys())
            if written.get(key) != here.get(key)
        ]
        if different:
            raise ValueError(
                f"checkpoint = {str(self._path)!r}: belongs to another study: {'; '.join(different)}; "
                "name another file, or delete it to start again"
            )
        return chunk, arrays

    def damaged(self, error: Exception) -> ValueError:
        """Return the error of a file that cannot be gone on from."""
        where = f"checkpoint = {str(self._path)!r}"
        return ValueError(f"{where}: damaged, or no checkpoint ({error}); delete it to start again")

    def save(self, chunk: int, state: PyTree, *, now: bool = False) -> None:
        """Write what `state()` gives before chunk number `chunk`, if it is time or `now`; a failure only warns."""
        start = time.monotonic()
        if start < self._next and not now:
            return
        try:
            self._write(chunk, state())
        except OSError as error:
            if not self._warned:
                message = f"checkpoint = {str(self._path)!r}: cannot be written ({error}); the study continues"
                with warnings.catch_warnings():  # where warnings are errors, this one must not end the study
                    warnings.simplefilter("always", RuntimeWarning)
                    warnings.warn(message, RuntimeWarning, stacklevel=3)
            self._warned = True
        end = time.monotonic()
        self._next = end + (max(self._every, _SHARE * (end - start)) if self._every else 0.0)

    def _write(self, chunk: int, arrays: Arrays) -> None:
        about = {"format": _FORMAT, "fingerprint": self._fingerprint, "next": chunk, "digest": digest(arrays)}
        write_atomically(self._path, pack({**arrays, "about": np.frombuffer(json.dumps(about).encode(), np.uint8)}))


def of_process(path: str | Path, process: int, processes: int) -> Path:
    """Return the checkpoint of one process; raise an error for those of another number of processes."""
    whole = Path(path)
    all_of = [of_number(whole, number, processes) for number in range(processes)]
    all_of = [whole] if processes == 1 else all_of
    for found in (whole, *whole.parent.glob(f"{glob.escape(whole.name)}.*-of-*")):
        if found.suffix != PARTIAL and found not in all_of and found.is_file():
            raise ValueError(
                f"checkpoint = {str(path)!r}: {found.name} is of another number of processes than {processes}; "
                "name another file, or delete it to start again"
            )
    return all_of[process]


def of_number(whole: Path, process: int, processes: int) -> Path:
    """Return the file of one of several processes."""
    return whole.with_name(f"{whole.name}.{process}-of-{processes}")
