"""Files that are written whole or not at all, and arrays as bytes.

Four kinds of files hold numbers. Results: JSON to read, NPZ where arrays are large. Checkpoints and memos: NPZ, exact
bits in one piece. Units of a run: CSV or Parquet, written chunk by chunk and read by other programs.
"""

import contextlib
import hashlib
import importlib
import io
import math
import os
import platform
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

PARTIAL = ".partial"
"""Ending of a file that is being written."""

DAMAGE = (ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, OverflowError, RecursionError,
          NotImplementedError, zipfile.BadZipFile, zlib.error)  # fmt: skip
"""Exceptions that reading a malformed file may raise."""

Arrays = Mapping[str, np.ndarray]


def check_writable(path: Path) -> None:
    """Raise an error for a file that `write_atomically` could not write, before any work is done.

    Args:
        path: of the file; its folder, and those above it, may still have to be made.

    Raises:
        OSError: the reason.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder")
    folder = next(p for p in path.absolute().parents if p.exists())
    if not folder.is_dir():
        raise NotADirectoryError(f"{path}: {folder} is not a folder")
    trial = folder / _partial(path).name  # the name itself may be too long, the disk read-only
    with naming(path, folder):
        trial.touch()
        trial.unlink()


@contextlib.contextmanager
def naming(path: Path, folder: Path) -> Iterator[None]:
    """Errors of the system name a file that is to be written, and not the scratch file next to it.

    Args:
        path: of the file.
        folder: that the scratch file is in.

    Raises:
        OSError: of the same kind.
    """
    try:
        yield
    except OSError as error:
        if error.strerror is None:
            raise
        raise type(error)(f"{path}: cannot be written in {folder} ({error.strerror})") from None


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader, or the next run after a crash, finds the old or the new content, never a part.

    Args:
        path: of the file; next to it a `.partial` file, with the number of the process, exists while writing.
        content: bytes.

    Raises:
        OSError: it cannot be written; the old content stays.
    """
    with replacing(path) as partial:
        partial.write_bytes(content)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """The name of a file to write, which takes the place of another once the block has ended well.

    Args:
        path: of the other; the name to write has the number of the process and `.partial` appended.

    Raises:
        OSError: it cannot be written; the old content stays.
    """
    partial = _partial(path)
    try:
        with naming(path, path.absolute().parent):
            yield partial
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
            partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _partial(path: Path) -> Path:
    """Scratch file next to a file, with the number of the process: two processes never share it."""
    return path.with_name(f"{path.name}.{os.getpid()}{PARTIAL}")


def pack(arrays: Arrays) -> bytes:
    """Arrays as the bytes of an NPZ file."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def unpack(content: bytes) -> dict[str, np.ndarray]:
    """Arrays from the bytes of `pack`; nothing that would take more memory than the bytes themselves is begun."""
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        if sum(member.file_size for member in file.infolist()) > len(content):
            raise ValueError("its parts are larger than the file")
        for member in file.infolist():
            if member.compress_type != zipfile.ZIP_STORED:
                raise ValueError(f"{member.filename!r} is compressed, which no file of rvjax is")
            with file.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(stream)
            if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > member.file_size:
                raise ValueError(f"{member.filename!r} is shorter than its shape {shape}")
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def digest(arrays: Arrays) -> str:
    """Hash of names, types, shapes and values."""
    found = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()


def versions() -> dict[str, str]:
    """Versions that a result in a file belongs to, by name."""
    return {name: importlib.import_module(name).__version__ for name in ("rvjax", "jax", "scipy")} | {
        "python": platform.python_version()
    }
