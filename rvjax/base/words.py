"""Words that an argument or key may have, the nearest ones first in an error; lines of text that fit a terminal."""

import difflib
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable

_LONGEST = 80  # characters of a wrong word in a message


class UnknownWord(ValueError):
    """A word that is not in its list; the message ends with the whole list."""


def unknown(what: str, word: object, words: Iterable[str], rule: str = ": must be one of") -> UnknownWord:
    """Return the error of a word that is not in its list.

    Args:
        what: argument or key with its value, as the message begins.
        word: as given.
        words: that are allowed.
        rule: text before the list.
    """
    words = list(words)
    what = what if len(what) <= 3 * _LONGEST else f"{what[:_LONGEST]} ... {what[-_LONGEST:]}"
    return UnknownWord(f"{what}{meant(word, words)}{rule} {', '.join(words)}")


def choose(where: str, word: object, words: Iterable[str]) -> str:
    """Return a word that is in the list.

    Args:
        where: argument or key, for the message.
        word: as given.
        words: that are allowed.

    Raises:
        UnknownWord: it is not in the list.
    """
    words = list(words)
    if not isinstance(word, str) or word not in words:
        shown = repr(word)
        raise unknown(f"{where} = {shown if len(shown) <= _LONGEST else shown[:_LONGEST] + ' ...'}", word, words)
    return word


def meant(word: object, words: Iterable[str]) -> str:
    """Return the nearest of the words in brackets, at most three; "" where none is near.

    Args:
        word: as given.
        words: that are allowed.
    """
    near = difflib.get_close_matches(str(word)[:_LONGEST], list(words), 3)
    return f" (did you mean {' or '.join(near)}?)" if near else ""


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
