"""Files that are there whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

PARTIAL = ".partial"
"""Ending of a file that is being written."""


def check_writable(path: Path) -> None:
    """Refuse a file that `write_atomically` could not write, before any work is done; leaves nothing behind.

    Args:
        path: of the file; its folder, and those above it, may still have to be made.

    Raises:
        OSError: says why not.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder")
    folder = next(p for p in path.absolute().parents if p.exists())
    if not folder.is_dir():
        raise NotADirectoryError(f"{path}: {folder} is not a folder")
    trial = folder / (path.name + PARTIAL)  # the name itself may be too long, the disk read-only
    if not trial.exists():
        trial.touch()
        trial.unlink()


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader, or the next run after a crash, finds the old or the new content, never a part.

    Args:
        path: of the file; beside it a `.partial` file, with the number of the process, exists while writing.
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
        path: of the other; the one to write stands beside it, with the number of the process and `.partial`.

    Raises:
        OSError: it cannot be written; the old content stays.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}{PARTIAL}")  # two processes never share one
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
