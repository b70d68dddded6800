"""Lines of text that fit a terminal."""

import re
import shutil
import sys
import textwrap


def words(name: str) -> str:
    """A field name as words: crank_eccentricity -> crank eccentricity."""
    return name.replace("_", " ")


def terminal_width() -> int | None:
    """Characters of a line of standard output; None where it is a file or a pipe, whose lines have no limit."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def wrapped(text: str, width: int | None) -> str:
    """Break long lines between words; a broken line goes on under its text, or under the value next to a name.

    Args:
        text: one or several lines.
        width: characters of a line; None: as it is.
    """
    return text if width is None else "\n".join(_line(line, width) for line in text.split("\n"))


def _line(line: str, width: int, indent: int | None = None) -> str:
    """A line in several, those after the first with an indent; None: below the text of the first."""
    if len(line) <= width:
        return line
    if indent is None:
        name = re.match(r"\s*\S+(?: \S+)*? {2,}(?=\S)", line)
        indent = name.end() if name and name.end() <= width // 2 else len(line) - len(line.lstrip()) + 2
    return textwrap.fill(line, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)


def refilled(text: str, width: int) -> str:
    """Paragraphs with lines as long as fit, for text whose lines were broken elsewhere; indented lines stay lines.

    Args:
        text: paragraphs between empty lines.
        width: characters of a line.
    """
    paragraphs = re.sub(r"(?<=\S)\n(?=\S)", " ", text)
    return "\n".join(_line(line, width, 0 if line[:1].strip() else None) for line in paragraphs.split("\n"))
