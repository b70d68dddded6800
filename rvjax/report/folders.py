"""Results folders: made whole or not at all, never over another one."""

import contextlib
import csv
import io
import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rvjax.files import check_writable
from rvjax.report import numbers, text
from rvjax.report.pictures import pictures
from rvjax.study.answer import Answer


def results_folder(option: str | None, name: str) -> Path:
    """The folder that the results should go to; it must not exist yet, so that nothing is overwritten.

    Args:
        option: what was asked for; None for the next free number under `results`.
        name: of the study.

    Raises:
        OSError: it cannot be made.
        ValueError: the folder asked for exists.
    """
    if option is not None:
        folder = Path(option)
        if folder.exists():
            raise ValueError(f"--results {option}: exists already; name a new folder")
    else:
        folder = next(folder for folder in _numbered(Path("results") / name) if not folder.exists())
    check_writable(folder)
    return folder


def numbered_folders(name: str) -> list[Path]:
    """The results folders of a study that are there, in the order of their numbers."""
    return [folder for folder in _numbered(Path("results") / name) if folder.is_dir()]


def _numbered(folder: Path) -> Iterator[Path]:
    """A folder, and those that stand in for it where it is taken."""
    yield folder
    yield from (folder.with_name(f"{folder.name}-{k}") for k in range(2, 10_000))


def new_folder(folder: Path) -> Path:
    """Make a folder, or the next free one where another run made it first."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    for free in _numbered(folder):
        with contextlib.suppress(FileExistsError):
            free.mkdir()
            return free
    raise FileExistsError(f"{folder}: exists, and so do all numbered ones")


def write(answer: Answer, folder: Path) -> Path:
    """Write study, tables, JSON and pictures into a new folder, as `write_files` does."""
    return write_files(_files(answer), folder)


def _files(answer: Answer) -> Iterator[tuple[str, bytes]]:
    yield "study.toml", answer.study.text.encode()
    yield "summary.txt", (text.summary(answer) + "\n").encode()
    yield "result.json", as_json(text.as_json(answer))
    for name, (headers, cells) in numbers.tables(answer):
        yield f"{name}.csv", as_csv(headers, cells)
    for picture in pictures(answer):
        yield f"{picture.name}.png", picture.content


def as_csv(headers: Sequence[str], rows: Iterable[Sequence[str | float | None]]) -> bytes:
    """A table as the content of a CSV file."""
    file = io.StringIO(newline="")
    csv.writer(file, lineterminator="\n").writerows([headers, *rows])
    return file.getvalue().encode()


def as_json(data: Any) -> bytes:
    """JSON values as the content of a file."""
    return json.dumps(data, indent=1, allow_nan=False).encode()


def write_files(files: Iterable[tuple[str, bytes]], folder: Path) -> Path:
    """Write files into a new folder: all of them, or nothing; returns the folder.

    Args:
        files: name and content, made one after the other.
        folder: that is wanted; where another run has taken it meanwhile, the next free number.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        for name, content in files:
            (scratch / name).write_bytes(content)
        scratch.chmod(0o755)  # mkdtemp makes it private
        made = new_folder(folder)
        scratch.rename(made)  # onto an empty folder of its own
        return made
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise
