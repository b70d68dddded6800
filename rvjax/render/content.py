"""Parts of a report: paragraphs, sections and blocks with a template."""

from collections.abc import Mapping
from dataclasses import dataclass

from rvjax.render.figure import Figure
from rvjax.render.table import EVERYWHERE, Table


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
