"""The HTML page of a report: one file, nothing is fetched. Every value is escaped by Jinja2."""

import base64
import itertools
import re
from collections.abc import Mapping
from functools import cache
from importlib import resources

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

import rvjax
from rvjax.base.files import versions
from rvjax.render import quantity
from rvjax.render.content import Block, Figure, Note, Section, Table
from rvjax.render.quantity import PAGE


def page(template: str, values: Mapping[str, object]) -> str:
    """The page that a template makes.

    Args:
        template: "package:file", or "" for the page that all reports share.
        values: for the template, the `report` and its facts.
    """
    made = _environment().get_template(template or "rvjax.render:page.html.j2")
    style = Markup((resources.files("rvjax.render") / "page.css").read_text("utf-8"))
    return made.render(style=style, versions=versions(), rvjax=rvjax, **values)


@cache
def _environment() -> Environment:
    def source(name: str) -> str:
        package, _, file = name.partition(":")
        return (resources.files(package) / file).read_text("utf-8")

    made = Environment(
        loader=FunctionLoader(source), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    made.filters |= {
        "typeset": typeset,
        "micro": micro,
        "svg": svg,
        "label": label,
        "groupby_indent": _by_indent,
        "block": _block,
    }
    made.tests |= {
        "note": lambda part: isinstance(part, Note) and PAGE in part.on,
        "table": lambda part: isinstance(part, Table) and PAGE in part.on,
        "figure": lambda part: isinstance(part, Figure),
        "section": lambda part: isinstance(part, Section),
        "block": lambda part: isinstance(part, Block),
        "nil": nil,
    }
    return made


def _block(part: Block) -> Markup:
    return Markup(_environment().get_template(part.template).render(**part.facts))


def label(name: str) -> Markup:
    """The name of an error as words; the place of an element may be on a separate line."""
    return Markup(re.sub(r"\[(?=\d)", "<wbr>[", str(escape(name.replace("_", " ")))))


def _by_indent(lines: list[str]) -> list[tuple[bool, list[str]]]:
    """Separate indented lines, which are a list, from the others."""
    groups = itertools.groupby(lines, lambda line: line.startswith("  "))
    return [(indented, [line.strip() for line in own]) for indented, own in groups]


MUTED = ("no slope",)
ZERO = Markup('<span class="none">0</span>')


DRAWN = re.compile(r"^([a-z]+(?: [a-z]+)*) (\d\S* \S+)$")
"""Words of a drawing and its number, such as "position diametral 6.2 um"."""


def typeset(cell: object) -> Markup:
    """A text of a cell for the page: numbers stay with their units, an interval is on a separate line."""
    if isinstance(cell, Markup):
        return cell
    text, _, interval = str(cell).partition(" [")
    if re.match(r"0\.00+ ", text) or text == "0.0 %":
        return ZERO
    if text.startswith(("✔", "✘")):
        return Markup('<span class="{}">{}</span>').format("met" if text[0] == "✔" else "missed-mark", text)
    more = Markup("<small>[{}</small>").format(micro(interval)) if interval else Markup("")
    if text in MUTED:
        return Markup('<span class="none">{}</span>{}').format(text, more)
    if text == "assumed":
        return Markup("<strong>assumed</strong>")
    said = micro(escape(text.replace("+-", "±").replace("<=", "≤").replace(">=", "≥")))
    said = Markup(DRAWN.sub(r"\1<br>\2", str(said).replace(" and ", "<br>")))
    if said in ("", "-"):
        return said
    return Markup('<span class="whole">{}</span>{}').format(said, more)


def nil(cell: str) -> bool:
    """True if a narrow screen hides a typeset cell."""
    return cell in ("", "-") or (cell.startswith('<span class="none">') and cell.endswith("</span>"))


def micro(text: str) -> Markup:
    """Text with the sign of a micrometre and a microsecond."""
    return Markup(quantity.micro(str(escape(text))))


def svg(figure: Figure) -> str:
    """A figure as the address of an image inside the page."""
    return f"data:image/svg+xml;base64,{base64.b64encode(figure.content('svg')).decode('ascii')}"
