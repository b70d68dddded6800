"""Statuses, their precedence, and `check`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import SolveError, SolveInfo, Status, check
from rvjax.records import Record, field, record
from rvjax.status import PRECEDENCE, WITHOUT_VALUE, admit, first_failure, succeeded, worst


@record
class Result(Record):
    """A solved result."""

    info: SolveInfo = field("-", "how it went", kind="record")


def result(*statuses):
    return Result(SolveInfo(jnp.array([int(s) for s in statuses])))


def test_every_status_has_its_place():
    assert set(PRECEDENCE) == set(Status) and len(PRECEDENCE) == len(Status)
    assert Status.CONVERGED == 0 and PRECEDENCE[-1] is Status.CONVERGED and PRECEDENCE[0] is Status.NONFINITE
    # A value that was refused or never reached is none; what comes behind describes one.
    refused = {Status.NONFINITE, Status.INVALID_GEOMETRY, Status.UNDERCUT, Status.CONTACT_OVERLOAD}
    assert set(WITHOUT_VALUE) == refused | {Status.NO_BRACKET, Status.MAX_STEPS, Status.NOT_ASSEMBLABLE}


def test_the_worst_of_several_is_the_first_by_precedence():
    compiled = jax.jit(worst, static_argnames="axis")
    for better, status in zip(PRECEDENCE[1:], PRECEDENCE):
        assert int(compiled(np.array([int(better), int(status)]))) == status
    rows = np.array([[0, int(Status.UNLOADED)], [int(Status.SINGULAR), int(Status.CHANGE_POINT)]])
    assert compiled(rows, axis=1).tolist() == [Status.UNLOADED, Status.CHANGE_POINT]


def test_first_failure_does_not_depend_on_the_order_of_its_checks():
    first, second = np.array([True, True, False]), np.array([True, False, False])
    expected = [Status.NONFINITE, Status.SINGULAR, Status.CONVERGED]

    @jax.jit
    def both(first, second):
        checks = (first, Status.SINGULAR), (second, Status.NONFINITE)
        return first_failure(*checks), first_failure(*checks[::-1])

    assert [found.tolist() for found in both(first, second)] == [expected] * 2


def test_a_gate_lets_values_stand_that_their_status_only_describes():
    """Lanes: sound, at a change point, without a root, refused (and then whatever its harmless numbers gave)."""

    @jax.jit
    def lanes(inputs, here):
        inputs, gate = admit(inputs, 0.5, (here == 3, Status.INVALID_GEOMETRY))
        found_wrong = ((here == 1, Status.CHANGE_POINT), (here == 2, Status.NO_BRACKET), (here == 3, Status.SINGULAR))
        return inputs, *gate.close(2 * inputs, *found_wrong)

    inputs, values, info = lanes(np.array([1.0, 2.0, 3.0, np.nan]), np.arange(4))
    assert inputs.tolist() == [1.0, 2.0, 3.0, 0.5]
    assert info.status.tolist() == [
        Status.CONVERGED,
        Status.CHANGE_POINT,
        Status.NO_BRACKET,
        Status.INVALID_GEOMETRY,
    ]
    np.testing.assert_array_equal(values, [2.0, 4.0, np.nan, np.nan])


def test_check_passes_success_and_returns_the_result():
    good = result(Status.CONVERGED, Status.UNLOADED)
    assert check(good) is good
    assert list(succeeded(good.info.status)) == [True, True]


def test_check_names_reasons_counts_and_the_first_lane():
    bad = result(Status.CONVERGED, Status.NOT_ASSEMBLABLE, Status.NONFINITE, Status.NOT_ASSEMBLABLE)
    with pytest.raises(SolveError, match=r"3 of 4 .*NONFINITE 1 \(first at index \(2,\)\), NOT_ASSEMBLABLE 2 .*\(1,\)"):
        check(bad)
    assert check(bad, max_failed_fraction=0.75) is bad
    with pytest.raises(TypeError, match="info"):
        rvjax.check(3.0)


def test_a_case_at_the_edge_of_a_refusal_is_no_success(monkeypatch):
    """XLA may round a condition differently for each of its readers: one refuses the case, the other finds no cause."""
    _, gate = admit(jnp.array([1.0, -1.0]), 1.0, (jnp.array([False, True]), Status.UNDERCUT))
    monkeypatch.setattr(type(gate), "good", property(lambda _: jnp.array([False, False])))
    value, info = gate.close(jnp.array([2.0, 3.0]))
    np.testing.assert_array_equal(info.status, [Status.NONFINITE, Status.UNDERCUT])
    assert np.isnan(value).all()
