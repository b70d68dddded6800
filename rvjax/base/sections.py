"""Tables of study files that only one command reads: where the reader of studies finds their readers."""

from collections.abc import Callable, Mapping
from typing import Protocol


class Reader(Protocol):
    """Reads a table of a study file."""

    def __call__(self, table: Mapping[str, object], study: object, /) -> object: ...


LOOKUPS: list[Callable[[str], Reader | None]] = []
"""Functions (name of a table) -> its reader, None for an unknown table. The package registers that of its commands."""


def reader(table: str) -> Reader | None:
    """Find the reader of a table; None where there is none."""
    return next((found for lookup in LOOKUPS if (found := lookup(table)) is not None), None)
