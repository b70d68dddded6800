"""The gates of the frozen table of allocations find planted losses, and its counter counts units. Nothing is allocated.

Oracle: rows changed by hand, on either side of each bound that `python -m benchmarks.optima --help` states.
"""

import json

import jax.numpy as jnp
import pytest

from benchmarks import optima
from rvjax.population import Population
from rvjax.response import respond
from rvjax.tolerances import Tolerance
from tests.oracles.responses import Linear

ROW = {
    "kind": "study", "status": "OPTIMAL", "right": "OPTIMAL", "cost": 10.0, "graded": 11.0, "optimum": 9.9,
    "ratio": 1.0101, "prices": {"y": -1.0}, "exact": {}, "units": 100, "gradients": 10, "seconds": 20.0, "others": 0.0,
}  # fmt: skip
REFUSED = ROW | {"status": "INFEASIBLE", "right": "INFEASIBLE", "graded": None, "cost": 0.1, "ratio": 1.0}


def test_every_problem_has_a_frozen_row():
    frozen = json.loads(optima.FROZEN.read_text("utf-8"))["rows"]
    assert len(frozen) == 56 and list(frozen) == list(optima.PROBLEMS)
    assert [row["kind"] for row in frozen.values()] == [item.kind for item in optima.PROBLEMS.values()]
    assert [row["right"] for row in frozen.values()] == [item.right for item in optima.PROBLEMS.values()]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cost": 10.031}, "cost 0.31 % above"),
        ({"graded": 11.04}, "cost with grades 0.36 % above"),
        ({"status": "SUBOPTIMAL"}, "status SUBOPTIMAL after OPTIMAL"),
        ({"status": "NOT_CERTIFIED", "cost": 3.0, "ratio": 0.3}, "status NOT_CERTIFIED after OPTIMAL"),
        ({"cost": 9.88, "ratio": 0.998}, "certified at 0.9980 of the optimum"),
        ({"seconds": 25.2}, "CPU seconds 26 % above"),
        ({"fresh": {"y": [0.987, 0.98999, 0.99], "b": [0.991, 0.993, 0.99]}}, "y: 0.98700 of other units for 0.99"),
    ],
)
def test_a_loss_fails_its_gate(changes, words):
    assert optima.failures(ROW | changes, ROW) == [words]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"cost": 10.029, "graded": 11.03, "seconds": 24.9},
        {"cost": 9.9, "ratio": 0.9995},  # by the luck of a certificate
        {"fresh": {"y": [0.987, 0.99, 0.99]}},
        {"seconds": 40.0, "others": 0.5},
        {"seconds": 40.0, "others": None},
    ],
)
def test_what_is_within_its_bound_or_not_measurable_passes(changes):
    assert optima.failures(ROW | changes, ROW) == []


def test_cpu_seconds_count_for_studies_only():
    quick = ROW | {"kind": "steps"}
    assert optima.failures(quick | {"seconds": 40.0}, quick) == []


def test_the_cure_of_a_known_defect_may_cost_more():
    """A cost that nothing certifies is no bound on one that is certified."""
    false = ROW | {"status": "NOT_CERTIFIED", "cost": 3.2, "ratio": 0.32}
    assert optima.failures(ROW, false) == []


def test_an_infeasible_problem_must_be_called_so():
    assert optima.failures(REFUSED, REFUSED) == []
    assert optima.failures(REFUSED | {"cost": 0.1004}, REFUSED) == ["cost 0.40 % above"]
    found = REFUSED | {"status": "SUBOPTIMAL", "cost": 0.0, "ratio": 0.0}
    assert optima.failures(found, REFUSED) == ["status SUBOPTIMAL after INFEASIBLE"]
    assert optima.failures(REFUSED, found) == []


def test_a_missing_or_failing_row_is_reported(capsys):
    assert optima.compared({"a": ROW, "new": ROW}, {"a": ROW})
    assert "new                                  is not among the frozen rows" in capsys.readouterr().out
    assert not optima.compared({"a": ROW | {"cost": 11.0}, "b": ROW}, {"a": ROW, "b": ROW})
    assert "FAILS: cost 10.00 % above" in capsys.readouterr().out


def test_units_of_calls_are_counted():
    population = Population.of({"a": Tolerance.symmetric(1.0)})
    with optima.units() as found:
        respond(Linear({"a": 2.0}), population, jnp.zeros((1, 7)))
        respond(Linear({"a": 3.0}), population, jnp.zeros((1, 5)))
    assert found == {"values": 12}
    respond(Linear({"a": 2.0}), population, jnp.zeros((1, 7)))
    assert found == {"values": 12}  # no longer
