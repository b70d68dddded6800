"""Report of a command. Text, tables of numbers, JSON and the HTML page follow from it."""

import dataclasses
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rvjax.base.words import wrapped
from rvjax.records import PyTree
from rvjax.render.content import Block, Content, Note, Section
from rvjax.render.figure import Figure
from rvjax.render.folders import PAGE_FILE
from rvjax.render.table import CSV, TEXT, Table


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

        return page(self)


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


def plain(value: PyTree) -> PyTree:
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
