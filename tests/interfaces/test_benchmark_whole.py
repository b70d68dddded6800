"""The benchmark of whole processes: its studies and data are ones that the commands read. Nothing is solved.

Oracle: the parts and runs that it says it writes.
"""

import pytest

from benchmarks import whole
from rvjax import measured, study
from rvjax.commands.assemble import bench


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("whole")
    whole.write(made)
    return made


@pytest.mark.parametrize("name", ["loaded", "four-bar"])
def test_a_measured_unit_is_read(folder, name):
    asked = study.load(str(folder / f"{name}.toml"), solve=False)
    found = measured.read([str(folder / "unit.csv")], asked.columns)
    assert (found.kind, len(found.runs)) == ("curve", 2)


@pytest.mark.parametrize(
    ("name", "parts", "counts"),
    [
        ("loaded-sets", "sets", {"crank_0": 400, "crank_1": 400}),
        ("four-bar-sets", "three", {"crank_2": 21, "disc_0": 14, "carrier": 5}),
    ],
)
def test_parts_are_read(folder, name, parts, counts):
    found = bench(study.load(str(folder / f"{name}.toml"), solve=False), str(folder / f"{parts}.csv"))
    assert {kind: len(found.kinds[kind].parts) for kind in counts} == counts


def test_three_cranks_of_ratio_121_have_limits_on_forces(folder):
    question = study.load(str(folder / "three-cranks.toml"), solve=False)
    assert (question.design.ratio, question.design.cranks.count) == (121, 3)
    assert {"pin_force", "arm_bearing_force"} < set(question.requirements)
    parts = [set(part.outputs) for part in question.response().parts()]
    turn = {"pin_force", "arm_bearing_force", "loaded_transmission_error"}
    assert sorted(map(len, parts)) == [1, 3] and turn in parts  # one turn gives three of them, and the curve
    assert [part.curve for part in question.response().parts()] == [turn == outputs for outputs in parts]


def test_every_command_is_timed_or_tells_its_seconds():
    found = whole.commands()
    assert len({command.name for command in found}) == len(found)
    assert all(("print" in command.run[-1]) == command.timed for command in found)
