"""Title, author and revision of a study, for the head of reports."""

import dataclasses
from collections.abc import Mapping

from rvjax.study.values import known

LONGEST = 200  # characters of a line


@dataclasses.dataclass(frozen=True)
class About:
    """Title, author and revision of a study; "" for a missing entry.

    Attributes:
        title: of the report; "" for the name of the study.
        author: person responsible for the values.
        revision: of the study or of the drawing.
    """

    title: str = ""
    author: str = ""
    revision: str = ""

    def line(self) -> str:
        """Join all entries in one line; "" without any."""
        said = [self.title, self.author, f"revision {self.revision}" if self.revision else ""]
        return "; ".join(filter(None, said))


def parse_about(table: Mapping[str, object]) -> About:
    """Read the table [about].

    Raises:
        ValueError: names the key and its value.
    """
    names = [f.name for f in dataclasses.fields(About)]
    known(table, names, "about")
    return About(**{key: _line(value, f"about.{key}") for key, value in table.items()})


def _line(value: object, where: str) -> str:
    if isinstance(value, int) and not isinstance(value, bool):  # a revision that is counted
        value = str(value)
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or len(value) > LONGEST:
        raise ValueError(f"{where} = {value!r}: must be a text of one line, at most {LONGEST} characters")
    return value.strip()
