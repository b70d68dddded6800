"""The table of mutants fits the tree, and the page shows the score of the last `python -m census.mutants`."""

import json
import re
import shlex
from pathlib import Path

from census import mutants

ROOT = Path(__file__).parents[1]


def test_every_old_text_stands_exactly_once_and_its_tests_exist():
    """A change of the code that takes a mutant's text away has to bring another one."""
    found = mutants.table()
    assert [(m.breaks, m.file, m.places()) for m in found if m.places() != 1] == []
    assert len({m.breaks for m in found}) == len(found) >= 60
    for mutant in found:
        assert mutant.old != mutant.new, mutant.breaks
        path, *rest = shlex.split(mutant.tests)
        names = re.findall(r"^def test_(\w+)", (ROOT / path).read_text("utf-8"), re.MULTILINE)
        assert names and (not rest or rest[0] == "-k"), mutant.breaks


def test_every_room_has_its_mutants():
    """By the package they stand in; pictures and commands are drawn and printed, not computed."""
    touched = {Path(m.file).parts[1] for m in mutants.table()}
    packages = {path.parent.name for path in (ROOT / "rvjax").glob("*/__init__.py")}
    assert packages - touched == {"cli", "plotting"}


def test_the_page_shows_the_last_score():
    """Of the mutants that the run reached; a survivor has its reason in the table."""
    kept = json.loads((ROOT / "census" / "mutants.json").read_text("utf-8"))
    page = (ROOT / "docs" / "stability.md").read_text("utf-8")
    of_room = [m.room for m in mutants.table()]
    assert set(kept["rooms"]) == set(of_room)
    for room, (killed, count) in kept["rooms"].items():
        assert f"| {room} | {killed} of {count} |" in page and count <= of_room.count(room)
    killed, count = (sum(column) for column in zip(*kept["rooms"].values()))
    assert f"| all | {killed} of {count} |" in page and killed >= 0.95 * count
    assert set(kept["survivors"]) <= {m.breaks for m in mutants.table() if m.survives}
    assert all(breaks in page for breaks in kept["survivors"])
