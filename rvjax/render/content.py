"""Content of a report: tables, paragraphs, sections, blocks with a template, and plots, rendered when they are written.

A table is a list of rows under typed columns.
"""

import csv
import dataclasses
import io
import itertools
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rvjax.base.cells import is_number
from rvjax.base.words import wrapped
from rvjax.render.quantity import CSV, EVERYWHERE, TEXT, Cell, Column, Text, Value, micro

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawn, SubFigure


GAP = "  "  # between columns
PROSE = 20  # characters of a broken line, at least


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes:
        name: of its file, without ending.
        columns: what the cells of a row are.
        rows: cells, as many in each row as there are columns.
        caption: a line above it, "" for none.
        note: lines below it, "" for none.
        on: where the table is shown.
        total: the last row is a sum.
        under: text below each row on the terminal; none where there is no such text.
    """

    name: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    note: str = ""
    on: frozenset[str] = EVERYWHERE
    total: bool = False
    under: Sequence[str] = ()

    @classmethod
    def of(
        cls, record: type, name: str, rows: Iterable[object], *, without: Sequence[str] = (), **more: Any
    ) -> "Table":
        """A table of row records.

        Args:
            record: class of the rows, with a `column` in each field.
            name: of the file of the table.
            rows: of this class.
            without: fields that the table leaves out.
            **more: as in the class.
        """
        fields = [field for field in dataclasses.fields(record) if field.name not in without]
        columns = [field.metadata["column"] for field in fields]
        return cls(name, columns, [[getattr(row, field.name) for field in fields] for row in rows], **more)

    def shown(self, on: str) -> list[tuple[int, Column]]:
        """Place and description of the columns that are shown there."""
        return [(k, column) for k, column in enumerate(self.columns) if on in column.on]

    def texts(self, on: str = TEXT) -> tuple[list[str], list[list[str]]]:
        """Headers and rows as text."""
        columns = self.shown(on)
        return [column.title for _, column in columns], [[c.text(row[k]) for k, c in columns] for row in self.rows]

    def values(self) -> tuple[list[str], list[list[Value]]]:
        """Headers and rows of a CSV file."""
        columns = self.shown(CSV)
        headers = [header for _, column in columns for header in column.headers()]
        return headers, [[value for k, c in columns for value in c.values(row[k])] for row in self.rows]

    def text(self, width: int | None = None) -> str:
        """The table as plain text with its caption and note.

        Args:
            width: characters of a line; None: as wide as it is.
        """
        drawn = aligned(*self.texts(), width, [column for _, column in self.shown(TEXT)], self.under)
        return "\n".join(filter(None, [wrapped(self.caption, width), drawn, wrapped(self.note, width)]))

    def csv(self) -> bytes:
        """The content of a CSV file."""
        return as_csv(*self.values())


def aligned(
    headers: Sequence[str],
    rows: Iterable[Sequence[str]],
    width: int | None = None,
    columns: Sequence[Column] = (),
    under: Sequence[str] = (),
) -> str:
    """A plain text table: the first column left aligned, the others right aligned.

    A table that is too wide becomes blocks of columns, each with the first column. A column without a title of its own
    stays next to the one before.

    Args:
        headers: of the columns.
        rows: cells.
        width: characters of a line; None: as wide as it is.
        columns: what is known of each column; none where no cell may be broken into lines.
        under: text below each row, in the last block of columns.
    """
    texts = [list(column) for column in zip(headers, *rows, strict=True)]
    full = [max(map(len, column)) for column in texts]
    left, under = [k == 0 for k in range(len(texts))], [wrapped(text, width) for text in under]
    if width is None or _total(full) <= width:
        return "\n".join(_drawn(texts, full, left, under))
    about = columns or [Text(title) for title in headers]
    left = [k == 0 or column.wraps for k, column in enumerate(about)]
    narrow = [PROSE if one.wraps else one.narrow for one in about]
    least = [_least(*both) for both in zip(texts, narrow)]
    blocks = [[0]]
    for group in _groups(headers, lambda columns: _total([least[0], *(least[k] for k in columns)]) <= width):
        if len(blocks[-1]) > 1 and _total([least[k] for k in blocks[-1] + group]) > width:
            blocks.append([0])
        blocks[-1] += group
    drawn = []
    for block in blocks:
        for k in block:  # the rest of the width goes to cells that were broken
            rest = width - _total([least[j] for j in block])
            if narrow[k] and rest > 0:
                least[k] = min(full[k], least[k] + rest)
        below = under if block is blocks[-1] else ()
        lines = _drawn([texts[k] for k in block], [least[k] for k in block], [left[k] for k in block], below)
        drawn.append("\n".join(map(str.rstrip, lines)))
    return "\n\n".join(drawn)


def _least(column: Sequence[str], narrow: int) -> int:
    """Least width of a column: titles are broken at spaces, cells where they may be narrow."""
    title, *cells = column
    words = [word for text in [title, *(cells if narrow else [])] for word in _glued(text).split(" ")]
    whole = [min(len(cell), narrow) if narrow else len(cell) for cell in cells]
    return max([*map(len, words), *whole])


def _groups(headers: Sequence[str], fits: Callable[[list[int]], bool]) -> Iterator[list[int]]:
    """Columns but for the first that stay together: one without a title, or with that of others, with the one before.

    Those whose titles begin with the same word too, if they fit.
    """
    groups: list[list[int]] = []
    for k, title in list(enumerate(headers))[1:]:
        if groups and (not title or list(headers).count(title) > 1):
            groups[-1].append(k)
        else:
            groups.append([k])
    for _, family in itertools.groupby(groups, lambda group: headers[group[0]].split(" ")[0]):
        own = list(family)
        together = list(itertools.chain(*own))
        yield from [together] if fits(together) else own


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + len(GAP) * (len(widths) - 1)


def _drawn(
    texts: Sequence[Sequence[str]], widths: Sequence[int], left: Sequence[bool], under: Sequence[str]
) -> list[str]:
    """Lines of a block of columns; a title or cell that is too long has several."""
    lines: list[str] = []
    for place, row in enumerate(zip(*texts, strict=True)):
        cells = [_broken(cell, width) for cell, width in zip(row, widths)]
        high = max(map(len, cells))
        filled = []
        for cell, wide, first in zip(cells, widths, left):
            rest = [""] * (high - len(cell))
            own = rest + cell if place == 0 else cell + rest  # titles end at the rule
            filled.append([text.ljust(wide) if first else text.rjust(wide) for text in own])
        lines += [GAP.join(line) for line in zip(*filled, strict=True)]
        if place == 0:
            lines.append("-" * len(lines[0]))
        elif under:
            lines.append(under[place - 1])
    return lines


def _broken(cell: str, width: int) -> list[str]:
    """Lines of a cell; a number stays with its unit."""
    if len(cell) <= width:
        return [cell]
    lines = textwrap.wrap(_glued(cell), width, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\xa0", " ") for line in lines]


def _glued(text: str) -> str:
    return re.sub(r"(?<=\d) (?=[A-Za-z%])", "\xa0", text)


def as_csv(headers: Sequence[str], rows: Iterable[Sequence[Value]]) -> bytes:
    """A table as the content of a CSV file. A text that a spreadsheet would compute has an apostrophe before it.

    Args:
        headers: of the columns.
        rows: cells; None is an empty one.
    """
    file = io.StringIO(newline="")
    csv.writer(file, lineterminator="\n").writerows([*map(_no_formula, row)] for row in [headers, *rows])
    return file.getvalue().encode()


def _no_formula(cell: Value) -> Value:
    """A text such as "=A1" or "+- 0.2 arcsec" with an apostrophe; a number in a text, or a dash, as it is."""
    if not isinstance(cell, str) or not cell.startswith(("=", "+", "-", "@", "\t", "\r")) or cell == "-":
        return cell
    return cell if is_number(cell) else f"'{cell}"


DPI = 150
FORM = "png"
"""Of the files of a folder; a page has "svg"."""


@dataclass(frozen=True)
class Figure:
    """A plot of a report.

    Attributes:
        name: of its file, without ending.
        caption: what it shows, for a person who may not see it.
        draw: draws it and returns its axes.
    """

    name: str
    caption: str
    draw: "Callable[[], Axes]"

    def content(self, form: str = FORM) -> bytes:
        """The content of its file, in the one style of all plots; units are spelled as on the page.

        Args:
            form: "png" or "svg".
        """
        from matplotlib.text import Text

        from rvjax import plotting

        with plotting.style():
            figure = self.draw().figure
            for text in figure.findobj(Text):
                assert isinstance(text, Text)
                text.set_text(micro(text.get_text()))
            return saved(figure, form)


def saved(figure: "Drawn | SubFigure", form: str = FORM) -> bytes:
    """A Matplotlib figure as a file, closed. Without a date or random names: equal results give equal files.

    Args:
        figure: to close.
        form: "png" or "svg".
    """
    import matplotlib.pyplot as plt
    from matplotlib.backend_bases import get_registered_canvas_class
    from matplotlib.figure import Figure as Drawn

    assert isinstance(figure, Drawn)  # the types of Matplotlib allow a part of a figure
    file, layout, canvas = io.BytesIO(), figure.get_layout_engine(), get_registered_canvas_class(form)
    options: Any = {"svg.hashsalt": "rvjax", "figure.autolayout": False, "figure.constrained_layout.use": False}
    with plt.rc_context(options):
        if layout is not None and canvas is not None:
            # `savefig` would draw the figure twice: unseen for its layout, and into the file.
            figure.set_dpi(DPI)
            figure.set_canvas(canvas(figure))
            layout.execute(figure)
            figure.set_layout_engine(None)  # "none" would leave one that does nothing, for which it draws as well
        figure.savefig(file, format=form, dpi=DPI, metadata={"Date": None} if form == "svg" else None)
    plt.close(figure)
    return file.getvalue()


@dataclass(frozen=True)
class Note:
    """A paragraph.

    Attributes:
        text: one or several lines.
        on: where it is shown.
    """

    text: str
    on: frozenset[str] = EVERYWHERE


@dataclass(frozen=True)
class Section:
    """A part of a page under its own heading; the text shows its paragraphs and tables without the heading.

    Attributes:
        title: heading, "" for a group without one.
        content: in reading order.
        style: class of the style sheet for all of it, "" for none.
        fold: line under which the page folds the content away; "" for content that is always shown.
    """

    title: str
    content: tuple["Content", ...]
    style: str = ""
    fold: str = ""


@dataclass(frozen=True)
class Block:
    """A part of a page with a template; the text and the folder do not contain it.

    Attributes:
        template: "package:file".
        facts: values for it.
    """

    template: str
    facts: Mapping[str, object]


Content = Note | Table | Figure | Section | Block
