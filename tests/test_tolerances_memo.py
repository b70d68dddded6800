"""An allocation that was interrupted goes on from its memo, to the same bits."""

import sys

import numpy as np
import pytest

from rvjax.tolerances import Requirement, allocate
from rvjax.tolerances.batch.checkpoint import Memo
from tests.oracles.linear_pair import COSTS, LIMIT, PAIR, linear

NEED = Requirement(lower=-LIMIT, upper=LIMIT, target=0.99)


@pytest.fixture
def counted(monkeypatch):
    """Blocks of units that were computed; `counted.stop` is one block too many."""

    class Counted:
        blocks, stop = 0, 10**9

    counted = Counted()

    def count(respond):
        def counting(*arguments, **static):
            counted.blocks += 1
            if counted.blocks >= counted.stop:
                raise KeyboardInterrupt
            return respond(*arguments, **static)

        return counting

    parts = sys.modules["rvjax.response.parts"]
    monkeypatch.setattr(parts, "respond", count(parts.respond))
    return counted


def found(kept):
    return allocate(linear, PAIR, NEED, costs=COSTS, samples=512, certificate_samples=2048, memo=kept, max_steps=3)


def test_an_interrupted_allocation_resumes_to_the_same_bits(counted, tmp_path):
    whole = found(None)
    blocks, counted.blocks = counted.blocks, 0
    counted.stop = blocks // 2
    with pytest.raises(KeyboardInterrupt):
        found(Memo(tmp_path / "part", {"study": "one"}, worth=0))
    counted.blocks, counted.stop = 0, 10**9
    again = found(Memo(tmp_path / "part", {"study": "one"}, worth=0))
    assert counted.blocks == blocks - (blocks // 2 - 1)  # nothing twice
    assert (again.cost, again.half_widths, again.history) == (whole.cost, whole.half_widths, whole.history)
    assert again.certificate.yield_ == whole.certificate.yield_
    counted.blocks = 0
    found(Memo(tmp_path / "part", {"study": "one"}, worth=0))
    assert counted.blocks == 0
    found(Memo(tmp_path / "part", {"study": "another"}, worth=0))  # its numbers are no answer to this one
    assert counted.blocks == blocks


def test_a_damaged_array_is_computed_again(tmp_path):
    kept = Memo(tmp_path / "part", {}, worth=0)
    assert kept.recall({"what": "a"}, lambda: np.arange(3.0)).tolist() == [0, 1, 2]
    (path,) = kept.folder.iterdir()
    path.write_bytes(path.read_bytes()[:-5])
    assert kept.recall({"what": "a"}, lambda: np.arange(4.0)).tolist() == [0, 1, 2, 3]
    assert kept.recall({"what": "a"}, lambda: np.zeros(0)).tolist() == [0, 1, 2, 3]
    kept.clear()
    assert not kept.folder.exists()


def test_other_responses_of_the_same_units_are_other_arrays(tmp_path):
    kept, one, two = Memo(tmp_path / "part", {}, worth=0), np.ones(3), np.full(3, 2.0)
    computed = {"a": one, "b": two}, np.zeros(3)
    assert set(kept.units(("b",), {"first": "0"}, lambda: computed)[0]) == {"b"}
    values, status = kept.units(("a", "b"), {"first": "0"}, lambda: computed)
    assert values["a"].tolist() == [1, 1, 1] and values["b"].tolist() == [2, 2, 2] and status.dtype == np.int32
    values, _ = kept.units(("b",), {"first": "0"}, lambda: pytest.fail("stored"))
    assert values["b"].tolist() == [2, 2, 2]
