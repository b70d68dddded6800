"""Results folders: made whole or not at all, over another one only where it holds the result of the same study."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from rvjax.base.files import check_writable, naming

PAGE_FILE = "report.html"


def results_folder(option: str | None, name: str, stored: Path | None = None) -> Path:
    """The folder that the results should go to; it must not exist yet, so that nothing is overwritten.

    Args:
        option: the folder that the user named; None for the next free number under `results`.
        name: of the study.
        stored: a folder that the results replace, or None.

    Raises:
        OSError: it cannot be made.
        ValueError: the folder that the user named exists.
    """
    if stored is not None:
        check_writable(stored.with_name(f".{stored.name}-new"))
        return stored
    if option is not None:
        folder = Path(option)
        if folder.exists():
            raise ValueError(f"--results {option}: exists already; name a new folder")
    else:
        folder = next(folder for folder in _numbered(Path("results") / name) if not folder.exists())
    check_writable(folder)
    return folder


def numbered_folders(name: str) -> list[Path]:
    """The results folders of a study that exist, in the order of their numbers."""
    return [folder for folder in _numbered(Path("results") / name) if folder.is_dir()]


def _numbered(folder: Path) -> Iterator[Path]:
    """A folder, and those that replace it where it exists."""
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


def write_files(files: Iterable[tuple[str, bytes]], folder: Path, *, over: bool = False) -> Path:
    """Write files into a new folder: all of them, or nothing; returns the folder.

    Args:
        files: name and content, made one after the other.
        folder: wanted one; where another run has made it meanwhile, the next free number.
        over: take the place of the folder; files in it that are not made here stay, but for its page.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with naming(folder, folder.absolute().parent):
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        for name, content in files:
            (scratch / name).write_bytes(content)
        scratch.chmod(0o755)  # mkdtemp makes it private
        if over and folder.is_dir():
            return _exchanged(scratch, folder)
        made = new_folder(folder)
        scratch.rename(made)  # onto an empty folder
        return made
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise


def _exchanged(scratch: Path, folder: Path) -> Path:
    """Put a folder in the place of another one; that one is removed at the end, and stays if anything fails."""
    for path in folder.iterdir():
        if path.name != PAGE_FILE and not (scratch / path.name).exists():
            if path.is_dir():
                shutil.copytree(path, scratch / path.name, symlinks=True)
            else:
                shutil.copy2(path, scratch / path.name, follow_symlinks=False)
    old = scratch.with_name(scratch.name + "-old")
    folder.rename(old)
    try:
        os.replace(scratch, folder)
    except BaseException:
        old.rename(folder)
        raise
    shutil.rmtree(old, ignore_errors=True)
    return folder
