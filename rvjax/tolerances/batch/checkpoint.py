"""Files from which an interrupted computation goes on: checkpoints of Monte Carlo studies, the memo of an allocation.

A fingerprint distinguishes two studies. An allocation that resumes from its memo has bit-identical results.
"""

import contextlib
import glob
import hashlib
import json
import shutil
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr

from rvjax.base.files import DAMAGE, PARTIAL, Arrays, digest, pack, unpack, write_atomically
from rvjax.population import Population
from rvjax.records import Record
from rvjax.response import Response, Values, respond
from rvjax.tolerances.limits import Limits

_SHARE = 10  # times as long computing as writing
_FORMAT = 4
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


def response_hash(response: Response, population: Population) -> str | None:
    """Hash of the program that the response compiles to, constants and a record's numbers included.

    Limits of tolerances do not enter. None if the program calls a Python function, of which its text says nothing.
    """
    z = jax.ShapeDtypeStruct((population.numbers, 1), jnp.result_type(float))
    traced = respond.traced(response, population, z)
    if _calls_python(traced.jaxpr.jaxpr):
        return None
    found = hashlib.sha256(str(traced.lower().as_text()).encode())
    leaves: list[Any] = jax.tree.leaves(response) if isinstance(response, Record) else []
    for array in map(np.asarray, leaves):
        found.update(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _calls_python(program: Jaxpr) -> bool:
    """True if a Python function computes a value of a program; what only prints changes none."""
    for equation in program.eqns:
        if equation.primitive.name in ("pure_callback", "io_callback"):
            return True
        for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: isinstance(x, ClosedJaxpr)):
            inner = value.jaxpr if isinstance(value, ClosedJaxpr) else value
            if isinstance(inner, Jaxpr) and _calls_python(inner):
                return True
    return False


class Checkpoint:
    """A file of one study: read once, then written now and again."""

    def __init__(self, path: str | Path, fingerprint: Mapping[str, str], *, every: float = 1.0) -> None:
        """Name the file.

        Args:
            path: of the file.
            fingerprint: all that the state depends on.
            every: least time between two files, s, or ten times the time to write one; 0 writes after each chunk.
        """
        self._path, self._fingerprint, self._every = Path(path), dict(fingerprint), every
        self._next, self._warned = 0.0, False

    def load(self, largest: int) -> dict[str, np.ndarray]:
        """Return the state, which is empty at the beginning.

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
            written = dict(about["fingerprint"])
            if about["digest"] != digest(arrays):
                raise ValueError("its contents are not those that were written")
        except FileNotFoundError:
            self._write({})  # a place that cannot be written raises an error before anything is computed
            return {}
        except DAMAGE as error:
            raise self.damaged(error) from None
        if different := differences(written, self._fingerprint, "in the file"):
            raise ValueError(
                f"checkpoint = {str(self._path)!r}: belongs to another study: {different}; "
                "name another file, or delete it to start again"
            )
        return arrays

    def damaged(self, error: Exception) -> ValueError:
        """Return the error of a file that cannot be gone on from."""
        where = f"checkpoint = {str(self._path)!r}"
        return ValueError(f"{where}: damaged, or no checkpoint ({error}); delete it to start again")

    def save(self, state: Callable[[], Arrays], *, now: bool = False) -> None:
        """Write what `state()` gives, if it is time or `now`; a failure only warns."""
        start = time.monotonic()
        if start < self._next and not now:
            return
        try:
            self._write(state())
        except OSError as error:
            if not self._warned:
                message = f"checkpoint = {str(self._path)!r}: cannot be written ({error}); the study continues"
                with warnings.catch_warnings():  # where warnings are errors, this one must not end the study
                    warnings.simplefilter("always", RuntimeWarning)
                    warnings.warn(message, RuntimeWarning, stacklevel=3)
            self._warned = True
        end = time.monotonic()
        self._next = end + (max(self._every, _SHARE * (end - start)) if self._every else 0.0)

    def _write(self, arrays: Arrays) -> None:
        about = {"format": _FORMAT, "fingerprint": self._fingerprint, "digest": digest(arrays)}
        write_atomically(self._path, pack({**arrays, "about": np.frombuffer(json.dumps(about).encode(), np.uint8)}))


def differences(written: Mapping[str, str], here: Mapping[str, str], where: str) -> str:
    """In what two studies differ, as text; empty if they are one.

    Args:
        written: inputs of the one.
        here: inputs of this one.
        where: the one is, such as "in the file".
    """
    return "; ".join(
        f"{key} is {written.get(key, 'absent')} {where} and {here.get(key, 'absent')} here"
        for key in sorted(written.keys() | here.keys())
        if written.get(key) != here.get(key)
    )


def parts_of(path: str | Path) -> list[Path]:
    """Checkpoints that further processes of an earlier run, with any number of them, left next to that of the first."""
    whole = Path(path)
    found = whole.parent.glob(f"{glob.escape(whole.name)}.*-of-*")
    return sorted(part for part in found if part.suffix != PARTIAL and part.is_file())


def of_number(whole: str | Path, process: int, processes: int) -> Path:
    """Return the file of one of several processes; that of the first is the whole."""
    whole = Path(whole)
    return whole.with_name(f"{whole.name}.{process}-of-{processes}") if process else whole


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

        *values, status = self.recall({**inputs, "names": repr(names)}, rows)
        return dict(zip(names, values)), status.astype(np.int32)

    def clear(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
