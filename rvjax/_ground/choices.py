"""Words that an argument or a key may have: an error names the nearest ones first, then all of them."""

import difflib
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
