"""Stored results of the scripts of `benchmarks`, and tables in Markdown."""

import json
from pathlib import Path


def stored(name):
    """Stored results of a script of `benchmarks`."""
    return json.loads((Path(__file__).parents[1] / "benchmarks" / f"{name}.json").read_text())


def table(headers, rows):
    """A table in Markdown."""
    lines = [headers, ["---"] * len(headers), *rows]
    cell = lambda value: str(value).replace("|", "\\|").replace("\n", " ")  # noqa: E731
    return "\n".join("| " + " | ".join(map(cell, line)) + " |" for line in lines) + "\n"
