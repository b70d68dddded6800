"""Plots of a report, rendered when they are written: PNG for a folder, SVG for a page."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rvjax.render.quantity import micro

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
