"""The marked figures of README, docs/speed.md and benchmarks/NOTES.md, written again from the newest history.

    python -m benchmarks.pages

A mark is a comment with the script and the name of its figure; the number before it has two digits.
"""

import math
import re
from pathlib import Path
from typing import Any

from benchmarks import history

ROOT = Path(__file__).parent.parent
PAGES = ("README.md", "docs/speed.md", "benchmarks/NOTES.md")
MARK = re.compile(r"([\d.,]+(?:e-?\d+)?)([^\d|\n<]*<!-- (\w+): (.+?)(?: \* ([\d.e+-]+))? -->)")


def rounded(value: float) -> str:
    """Two digits, with commas; a count as it is."""
    if isinstance(value, int) or not value:
        return f"{value:,}" if value >= 10_000 else str(value)
    decimals = 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, decimals):,.{max(decimals, 0)}f}"


def written(text: str, results: dict[str, Any]) -> str:
    """A page with the figures of the results; a figure that is right as it is stays."""

    def one(mark: re.Match[str]) -> str:
        value = results[mark[3]]["figures"][mark[4]] * (float(mark[5]) if mark[5] else 1)
        right = rounded(float(mark[1].replace(",", ""))) == rounded(float(value))
        return mark[0] if right else rounded(value) + mark[2]

    return MARK.sub(one, text)


if __name__ == "__main__":
    for page in PAGES:
        path = ROOT / page
        path.write_text(written(path.read_text("utf-8"), history.newest()), "utf-8")
