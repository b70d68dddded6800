"""Pieces of a page: sections, tables and figures as HTML."""

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources

import rvjax
from rvjax.report import text as tables
from rvjax.report.pictures import Picture

ZERO = '<span class="none">0</span>'
NOT_SEEN = f'<span class="none">{tables.UNMOVED}</span>'
EMPTY, NIL = ("", "-", ZERO, NOT_SEEN), ' class="nil"'  # cells that a narrow screen leaves out


def typeset(cell: str) -> str:
    """A cell of the text tables for the page: numbers stay with their units, an interval has a line of its own."""
    cell, _, interval = cell.partition(" [")
    cell = micro(escape(cell.replace("+-", "±").replace("<=", "≤").replace(">=", "≥"))).replace(" and ", "<br>")
    if re.match(r"0\.00+ ", cell) or cell == "0.0 %":
        return ZERO
    if cell == tables.UNMOVED:
        return NOT_SEEN
    if cell in ("", "-"):
        return cell
    return f'<span class="whole">{cell}</span>' + (f"<small>[{escape(interval)}</small>" if interval else "")


def micro(text: str) -> str:
    """HTML text with the sign of a micrometre and a microsecond."""
    return re.sub(r"(?<![A-Za-z])u(?=[ms]\b)", "µ", text)


def note(text: str) -> str:
    """What the author wrote above the study: its leading comment."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def document(title: str, body: str) -> str:
    """A whole page: nothing is fetched, the style stands inside."""
    style = (resources.files("rvjax.render") / "page.css").read_text("utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="rvjax {rvjax.__version__}">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def boxes(figures: Iterable[tuple[str, str, str]]) -> str:
    """Figures (name, value, remark) that a reader looks for first."""
    each = (f"<div><dt>{escape(a)}</dt><dd>{escape(b)}<small>{escape(c)}</small></dd></div>" for a, b, c in figures)
    return f'<dl class="key">{"".join(each)}</dl>'


def origin(facts: Mapping[str, str], study: str) -> str:
    """The section that says how to get a page again: facts, versions and the text of the study."""
    made = ", ".join(map(" ".join, zip(("rvjax", "JAX", "Python"), tables.versions().values())))
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td class="text"><code>{escape(value)}</code></td></tr>'
        for name, value in {**facts, "versions": made}.items()
    )
    text = f"<table><tbody>{rows}</tbody></table><p>The study:</p><pre>{escape(study)}</pre>"
    return section("How to get this page again", text)


def section(title: str, content: str) -> str:
    """A section of the page."""
    return f"<section>\n<h2>{escape(title)}</h2>\n{content}\n</section>"


def table(headers: Sequence[str], rows: Iterable[Sequence[str]], *, total: bool = False, cards: bool = True) -> str:
    """A table of cells that are HTML already; each knows its column, for narrow screens."""
    head = "".join(f'<th scope="col">{escape(header)}</th>' for header in headers)
    body, rows = [], list(rows)
    for k, row in enumerate(rows):
        cells = "".join(
            f'<td data-label="{escape(label)}"{NIL if cell in EMPTY else ""}>{cell}</td>'
            for label, cell in zip(headers[1:], row[1:])
        )
        last = ' class="sum"' if total and k == len(rows) - 1 else ""
        body.append(f'<tr{last}><th scope="row">{row[0]}</th>{cells}</tr>')
    kind = ' class="cards"' if cards else ""
    return f'<div class="wide"><table{kind}><thead><tr>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'


def figure(picture: Picture) -> str:
    """A picture (SVG) inside the page, with its caption."""
    data = base64.b64encode(picture.content).decode("ascii")
    caption = escape(picture.caption)
    return f'<figure><img alt="{caption}" src="data:image/svg+xml;base64,{data}"></figure>'
