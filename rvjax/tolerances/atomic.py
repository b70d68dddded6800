"""Files that are there whole or not at all."""

import os
from pathlib import Path

PARTIAL = ".partial"
"""Ending of a file that is being written."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader, or the next run after a crash, finds the old or the new content, never a part.

    Args:
        path: of the file; beside it a `.partial` file exists while writing.
        content: bytes.

    Raises:
        OSError: it cannot be written; the old content stays.
    """
    partial = path.with_name(path.name + PARTIAL)
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
