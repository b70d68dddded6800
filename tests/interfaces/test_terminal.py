"""Text that fits a terminal: tables in blocks, paragraphs in lines; files and pipes have it as it is.

Oracle: the words themselves. What fits has no line beyond the width, and no cell is lost, doubled or out of its row.
"""

import contextlib
import fcntl
import os
import pty
import struct
import sys
import termios
import threading

import pytest
from hypothesis import given, strategies as st

from rvjax import cli
from rvjax.base.words import refilled, wrapped
from rvjax.render import Interval, Note, Report, Table, Text, aligned
from rvjax.render.page import typeset
from rvjax.status import Status
from rvjax.study import Study

WORDS = st.text("abc,.", min_size=1, max_size=14)


@st.composite
def tables(draw):
    columns, rows = draw(st.integers(1, 7)), draw(st.integers(0, 4))
    titles = [f"{draw(WORDS)}{k}" for k in range(columns)]
    return titles, [[f"{draw(WORDS)}{k}_{r}" for k in range(columns)] for r in range(rows)]


@given(tables(), st.integers(10, 120))
def test_a_table_is_as_wide_as_the_terminal(table, width):
    """A block has one column besides the first at least: that one may be too wide, as a cell is not broken."""
    titles, rows = table
    blocks = [block.split("\n") for block in aligned(titles, rows, width).split("\n\n")]
    seen = []
    for block in blocks:
        head = block[0].split()
        assert head[0] == titles[0] and set(block[1]) == {"-"} and len(block) == 2 + len(rows)
        assert max(len(line) for line in block) == len(block[1])
        assert len(block[1]) <= width or len(head) <= 2
        for line, row in zip(block[2:], rows):
            assert line.split() == [row[titles.index(title)] for title in head]
        seen += head[1:]
    assert seen == titles[1:]
    assert len(blocks) == 1 or len(aligned(titles, rows).split("\n")[0]) > width
    wide = max(len(line) for line in aligned(titles, rows).split("\n"))
    assert aligned(titles, rows, wide) == aligned(titles, rows) == aligned(titles, rows, None)


def test_a_share_stays_next_to_what_it_is_a_share_of():
    """Titles break at spaces before a table is split; a column whose title is empty or not its own is never alone."""
    titles = ["error", "d first / d error", "share", "d second / d error", "share", "met", ""]
    rows = [["one", "0.1 um/um", "1 %", "0.2 um/um", "2 %", "9", "yes"]]
    first, second = (block.split("\n") for block in aligned(titles, rows, 46).split("\n\n"))
    assert first == [
        "       d first /          d second",
        "error    d error  share  / d error  share",
        "-----------------------------------------",
        "one    0.1 um/um    1 %  0.2 um/um    2 %",
    ]
    assert second == ["error  met", "---------------", "one      9  yes"]
    blocks = [block.split("\n")[-1] for block in aligned(titles, rows, 38).split("\n\n")]  # the second slope would fit
    assert [block.count("%") for block in blocks] == [1, 1] and "0.2 um/um" in blocks[1]
    titles = ["owner", "of", "loaded rms", "loaded share", "unloaded rms", "unloaded 99 %"]
    blocks = aligned(titles, [["crank_eccentricity"] + ["0.123"] * 5], 48).split("\n\n")
    assert [block.split("\n")[-1].count("0.123") for block in blocks] == [3, 2]  # 4 columns would fit
    assert "99 %" in blocks[1].split("\n")[1]


def test_prose_in_a_table_is_broken_into_lines():
    said = "a reason that is so long that nobody would read it in a single line of a terminal"
    table = Table("t", [Text("name"), Text("why", wraps=True), Text("n")], [["x", said, "1"], ["y", "short", "2"]])
    lines = table.text(50).split("\n")
    assert max(map(len, lines)) <= 50 and " ".join(" ".join(lines[2:-1]).split()).replace(" 1", "", 1) == f"x {said}"
    assert lines[-1].split() == ["y", "short", "2"] and table.text().split("\n")[2].split("  ")[-1] == "1"


@given(tables(), st.integers(20, 120))
def test_text_below_each_row_is_broken_and_stays_below_it(table, width):
    """In the last block of columns; a table that fits is as it was, with a line more for each row."""
    titles, rows = table
    under = [f"    {'some words '}{k} of row{k}" for k in range(len(rows))]
    made = Table("t", [Text(title) for title in titles], rows, under=under)
    plain = aligned(titles, rows).split("\n")
    assert made.text().split("\n") == plain[:2] + [line for pair in zip(plain[2:], under) for line in pair]
    *_, last = made.text(width).split("\n\n")
    rest = last.split("\n")[2:]
    for k, row in enumerate(rows):
        assert row[0] == rest[0].split()[0] and all(f"row{j}" not in rest[0] for j in range(len(rows)))
        words = " ".join(" ".join(rest[1:]).split())
        assert words.startswith(f"some words {k} of row{k}")
        rest = rest[1 + next(n for n, line in enumerate(rest[1:], 1) if line.endswith(f"row{k}")) :]
    assert not rest and all(len(line) <= width for line in last.split("\n") if line.startswith("    some"))


@given(st.lists(st.lists(WORDS, max_size=30).map(" ".join), max_size=4), st.integers(20, 90))
def test_paragraphs_keep_their_words(lines, width):
    for fit in (wrapped, refilled):
        found = fit("\n".join(lines), width)
        assert found.split() == " ".join(lines).split()
        assert all(len(line) <= width for line in found.split("\n"))
    assert wrapped("\n".join(lines), None) == "\n".join(lines)


def test_a_broken_line_goes_on_under_its_text():
    assert wrapped("a b c d", 3) == "a b\n  c\n  d"
    assert wrapped("  a b c d", 5) == "  a b\n    c\n    d"
    assert wrapped("name  one two three", 13) == "name  one two\n      three"
    assert refilled("one\ntwo three\n\n  code  is kept\n  so", 9) == "one two\nthree\n\n  code\n    is\n    kept\n  so"


def test_captions_and_notes_fit_too():
    table = Table("t", [Text("a")], [["x"]], caption="a caption of a table", note="no slope: nothing is said")
    report = Report("r", (Note("a paragraph with some words"), table))
    assert max(map(len, report.text(12).split("\n"))) <= 12
    assert report.text() == "a paragraph with some words\n\na caption of a table\na\n-\nx\nno slope: nothing is said"


class Terminal:
    """A terminal of some width, on which a command prints."""

    def __init__(self, monkeypatch, columns):
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
        monkeypatch.delenv("COLUMNS", raising=False)
        self.stream, self.patch, self.said = os.fdopen(theirs, "w"), monkeypatch, b""
        self.reader = threading.Thread(target=self._read, args=(ours,))  # a terminal holds 4 kB
        self.reader.start()

    def _read(self, end):
        with os.fdopen(end, "rb", buffering=0) as file, contextlib.suppress(OSError):  # the other end is closed
            while part := file.read(65536):
                self.said += part

    def run(self, *arguments):
        """Exit code and text of a command."""
        with self.patch.context() as patch:  # pytest has its own streams between set-up and call
            patch.setattr(sys, "stdout", self.stream)
            patch.setattr(sys, "__stdout__", self.stream)
            code = cli.main(list(arguments))
        self.stream.close()
        self.reader.join()
        return code, self.said.decode().replace("\r\n", "\n")


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("arguments", ["--help", "compare --help", "check rv-40e-whole", "check rv-40e-design"])
def test_commands_fit_the_terminal(monkeypatch, arguments, columns):
    """The unit at the mid-points has some values within the limits, so that nothing is compiled."""

    def some(self, _):
        within = {n: min(0.987654 * item.upper, 1.987654 * abs(item.lower)) for n, item in self.requirements.items()}
        return within, Status.CONVERGED

    monkeypatch.setattr(Study, "at_mid_points", some)
    code, said = Terminal(monkeypatch, columns).run(*arguments.split())
    assert code == 0 and said
    assert [line for line in said.split("\n") if len(line) > columns] == []


def test_a_slope_stays_next_to_its_share_at_eighty_columns():
    """The longest row of a loaded result is 82 characters wide; the root mean square goes to a second line."""
    shares = Interval("share [interval]")
    columns = [Text("error"), Text("d loaded_transmission_error / d error", narrow=20), shares]
    rows = [["equidistant_modification", "no slope [rms 0.0325 arcmin/arcmin]", "33.0 % [25.4, 45.1]"]]
    lines = Table("influence", columns, rows).text(80).split("\n")
    assert max(map(len, Table("influence", columns, rows).text().split("\n"))) > 80 >= max(map(len, lines))
    assert "33.0 %" in lines[-2] and lines[-1].split() == ["0.0325", "arcmin/arcmin]"]


def test_the_page_breaks_the_words_of_a_drawing_from_their_number():
    assert typeset("position diametral 6.2 um") == '<span class="whole">position diametral<br>6.2 µm</span>'
    assert typeset("8.00 +-4.00 um") == '<span class="whole">8.00 ±4.00 µm</span>'
