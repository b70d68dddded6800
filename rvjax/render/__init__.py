"""Report of a command: text, tables of numbers, JSON and the HTML page follow from it; results folders.

A folder is made whole or not at all, over another one only where it holds the result of the same study.
"""

import contextlib
import dataclasses
import itertools
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rvjax.base.files import check_writable, naming
from rvjax.base.words import wrapped
from rvjax.records import PyTree
from rvjax.render.content import (
    Block as Block,
    Content as Content,
    Figure as Figure,
    Note as Note,
    Section as Section,
    Table as Table,
    aligned as aligned,
    as_csv as as_csv,
    saved as saved,
)
from rvjax.render.quantity import (
    CSV as CSV,
    EVERYWHERE as EVERYWHERE,
    PAGE as PAGE,
    TEXT as TEXT,
    Cell as Cell,
    Column as Column,
    Interval as Interval,
    Limits as Limits,
    Number as Number,
    Quantity as Quantity,
    Share as Share,
    Text as Text,
    Titled as Titled,
    Value as Value,
    Zone as Zone,
    column as column,
    micro as micro,
    number as number,
)

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
        folder = next(own for own in map(Path("results").joinpath, _numbered(name)) if not own.exists())
    check_writable(folder)
    return folder


def numbered_folders(name: str) -> list[Path]:
    """The results folders of a study that exist, in the order of their numbers."""
    there = {folder.name for folder in Path("results").glob("*") if folder.is_dir()}
    return [Path("results") / numbered for numbered in _numbered(name) if numbered in there]


def _numbered(name: str) -> Iterator[str]:
    """Name of a folder, and those of others that replace it where it exists."""
    yield name
    yield from (f"{name}-{k}" for k in range(2, 10_000))


def new_folder(folder: Path) -> Path:
    """Make a folder, or the next free one where another run made it first."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    for free in map(folder.with_name, _numbered(folder.name)):
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


@dataclass(frozen=True)
class Report:
    """Report of a command.

    Attributes:
        title: of the page.
        content: paragraphs, tables, figures and sections in reading order.
        status: how the computation ended, as the page says it; "" without a verdict.
        ok: the verdict is good; decides the exit code.
        data: JSON values in SI; records, arrays and numbers that are not finite are converted.
        files: further files of the results folder by name, with their content.
        page: template of the page of the results folder, None for no page; other values that it needs are in `facts`.
        facts: values for the template.
        exports: files outside the folder that options name, with their content.
        brief: text for standard output where it is shorter than summary.txt, None: the whole text.
        main: file of the folder that is named after the run, "" for the folder itself.
        told: further JSON values for standard output only, such as the paths of exports.
        closing: further lines of text for standard output only.
    """

    title: str
    content: tuple[Content, ...]
    status: str = ""
    ok: bool = True
    data: PyTree = field(default_factory=dict)
    files: Mapping[str, bytes] = field(default_factory=dict)
    page: str | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
    exports: Mapping[Path, bytes] = field(default_factory=dict)
    brief: str | None = None
    main: str = ""
    told: Mapping[str, object] = field(default_factory=dict)
    closing: tuple[str, ...] = ()

    def parts(self) -> Iterator[Note | Table | Figure]:
        """Paragraphs, tables and figures in reading order, those of sections too."""
        yield from _flat(self.content)

    def text(self, width: int | None = None) -> str:
        """Text of the report, with an empty line between paragraphs and tables.

        Args:
            width: characters of a line of a terminal; None: as in files.
        """
        parts = (part for part in self.parts() if not isinstance(part, Figure) and TEXT in part.on)
        return "\n\n".join(part.text(width) if isinstance(part, Table) else wrapped(part.text, width) for part in parts)

    def json(self) -> PyTree:
        """The report as JSON values."""
        return plain(self.data)

    def folder(self) -> Iterator[tuple[str, bytes]]:
        """Name and content of each file of a results folder, made one after the other."""
        yield from self.files.items()
        yield "summary.txt", (self.text() + "\n").encode()
        yield "result.json", as_json(self.json())
        parts = list(self.parts())
        yield from ((f"{part.name}.csv", part.csv()) for part in parts if isinstance(part, Table) and CSV in part.on)
        yield from ((f"{part.name}.png", part.content()) for part in parts if isinstance(part, Figure))
        if self.page is not None:
            yield PAGE_FILE, self.html().encode()

    def html(self) -> str:
        """The page: one file that needs no other."""
        from rvjax.render.page import page  # Jinja2 is loaded for a page only

        return page(self.page or "", {"report": self, **self.facts})


def _flat(content: Iterable[Content]) -> Iterator[Note | Table | Figure]:
    for part in content:
        if isinstance(part, Section):
            yield from _flat(part.content)
        elif not isinstance(part, Block):
            yield part


def leading_comment(text: str) -> str:
    """Leading comment of a study file."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    return " ".join(line.lstrip("# ") for line in lines)


def plain(value: object) -> PyTree:
    """Results as JSON values; numbers that JSON cannot hold (inf, nan) become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.generic, np.ndarray)) or hasattr(value, "tolist"):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def as_json(data: object) -> bytes:
    """JSON values as the content of a file."""
    return json.dumps(data, indent=1, allow_nan=False).encode()
