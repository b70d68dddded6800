"""Parts of a report: paragraphs, sections, blocks with a template, and plots, rendered when they are written."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rvjax.render.quantity import EVERYWHERE, micro
from rvjax.render.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawn, SubFigure

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
