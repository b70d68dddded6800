"""The speed figures of README, docs/speed.md and benchmarks/NOTES.md are those of the benchmarks.

Oracle: the newest of benchmarks/history, written by `python -m benchmarks.run`. Each figure is followed by a
comment with the script and the name of its figure, such as `44 <!-- four_bar: numpy_over_library -->`, and by a factor
where the units differ: `1.9 <!-- dynamics: seconds * 1e3 -->`. It must be the measured one, rounded to the digits
shown.
"""

import math
import re
from pathlib import Path

import pytest

from benchmarks import history
from benchmarks.pages import written

ROOT = Path(__file__).parents[2]
MARK = re.compile(
    r"(?P<text>[\d.,]+(?:e-?\d+)?)[^\d|\n<]*<!-- (?P<script>\w+): (?P<figure>.+?)(?: \* (?P<factor>[\d.e+-]+))? -->"
)


def differences(text, results):
    """(marks, what does not agree) of a text against results."""
    marks, wrong = list(MARK.finditer(text)), []
    for mark in marks:
        figures = results.get(mark["script"], {}).get("figures", {})
        if mark["figure"] not in figures:
            wrong.append(f"{mark['script']}: there is no figure {mark['figure']!r}")
            continue
        printed, value = mark["text"].replace(",", ""), figures[mark["figure"]] * float(mark["factor"] or 1)
        if not math.isclose(float(printed), value, rel_tol=1e-9, abs_tol=0.5 * last_digit(printed) * (1 + 1e-9)):
            wrong.append(f"{mark['script']}: {mark['figure']} is {value:.6g}, not {printed}")
    return marks, wrong


def last_digit(printed):
    """Size of one unit of the last digit shown; zeros that end a whole number are rounding: 6200 is 62 hundreds."""
    mantissa, _, exponent = printed.partition("e")
    whole, point, fraction = mantissa.partition(".")
    digits = -len(fraction) if point else len(whole) - len(whole.rstrip("0"))
    return 10.0 ** (digits + int(exponent or 0))


def test_the_comparison_finds_what_is_wrong():
    results = {"a": {"figures": {"n / m": 44.3, "s": 0.00192, "big": 6230.0}}}
    good = "| 44 x <!-- a: n / m --> | 1.9 ms <!-- a: s * 1e3 -->, 6,200 <!-- a: big --> |"
    assert differences(good, results)[1] == [] and len(differences(good, results)[0]) == 3
    for old, new in (("44 x", "45 x"), ("1.9", "1.8"), ("6,200", "6,300"), ("n / m", "n / k"), ("a: s", "b: s")):
        assert len(differences(good.replace(old, new), results)[1]) == 1, new
    later = {"a": {"figures": {"n / m": 7.26, "s": 0.0123, "big": 12_340.0}}}
    assert len(differences(good, later)[1]) == 3 and written(good, results) == good
    assert written(good, later) == good.replace("44", "7.3").replace("1.9", "12").replace("6,200", "12,000")
    assert differences(written(good, later), later)[1] == []


@pytest.mark.parametrize("page", ["README.md", "docs/speed.md", "benchmarks/NOTES.md"])
def test_the_page_prints_what_was_measured(page):
    marks, wrong = differences((ROOT / page).read_text("utf-8"), history.newest())
    assert not wrong, "\n".join(wrong)
    assert marks, f"{page} marks no figure"


def test_the_readme_is_short_and_its_pictures_exist():
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) <= 120
    for picture in re.findall(r"\]\((docs/pictures/[^)]+)\)", text):
        assert (ROOT / picture).stat().st_size > 10_000, picture
