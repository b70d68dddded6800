"""Costly units near their limits: used ways by these alone are those of all units, and far fewer are solved.

Oracle: the same sample with all of its units solved at each vector.
"""

from collections import Counter
from typing import NamedTuple
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest
from test_tolerances_constraints import FAR, Two, X, constraints

from rvjax._jax.sizes import AT_ONCE
from rvjax.response import Outcome, Part
from rvjax.status import Status
from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance, Variable, allocate
from rvjax.tolerances.allocation.certificate import Certifier
from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.sample import Units

UNITS = 4096
ONE = Requirement(lower=-0.29, upper=0.45, target=0.99)  # its used way is about 1 at X
BOTH = {"y": ONE, "b": Requirement(upper=0.21, target=0.98)}
WAY = np.array([0.3, -0.5, 1.0, 0.2, 0.0, -0.4])
WAY = WAY / np.abs(WAY).max()


def of_all(made, x):
    """A look at all units of a sample."""
    made._near = None
    return made.look(x)


@pytest.mark.parametrize("required", [{"y": ONE}, BOTH])
@pytest.mark.parametrize(("step", "part"), [(1e-4, 0.2), (0.01, 0.35), (0.03, 0.5), (0.3, 1.0)])
def test_used_ways_are_those_of_all_units(required, step, part):
    """Also their derivatives and standard errors; the farther the step, the more units are solved."""
    made, oracle = (constraints(required, costly=True, samples=UNITS, begun=X) for _ in range(2))
    made.look(X)
    assert (made.look(X).used > 0.85).all()
    before, there = made.units.solved, made.look(X + step * WAY)
    solved, due = made.units.solved - before, of_all(oracle, X + step * WAY)
    for name in ("used", "jacobian", "errors"):
        np.testing.assert_allclose(getattr(there, name), getattr(due, name), rtol=1e-12, atol=1e-14)
    assert solved <= part * UNITS + 256 and (part < 1 or solved >= 0.5 * UNITS)


@pytest.mark.parametrize("wider", [1.0, 2.0])
@pytest.mark.parametrize("moved", [-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
def test_units_of_the_other_side_are_solved_where_a_mid_point_moves(moved, wider):
    """Those farthest inside one limit come nearest to the other one; wider limits did not decide before."""
    need = {"y": Requirement(lower=wider * ONE.lower, upper=wider * ONE.upper, target=0.99)}
    made, oracle = (constraints(need, costly=True, samples=UNITS) for _ in range(2))
    assert (made.look(X).used > 0.85).all() == (wider == 1.0)
    x = X + np.array([0, 0, 0, moved, 0, 0])
    found, due = made.look(x, sloped=False).used[0], of_all(oracle, x).used[0]
    assert found == pytest.approx(due, rel=1e-12 if due > 0.9 else 0.03)


def test_units_that_all_move_inside_are_solved():
    """Those that keep their old values would lie beyond the others."""
    made, oracle = (constraints({"y": ONE}, costly=True, samples=UNITS) for _ in range(2))
    out = X + np.array([0.5, 0.5, 0.5, 0.0, 0.0, 0.0])
    for x in (X + 0.02 * (out - X), X, X - 0.1 * (out - X)):
        made._near = None
        made.look(out)
        assert made.look(x, sloped=False).used == pytest.approx(of_all(oracle, x).used, rel=1e-12)
    made._near = None
    made.look(out)
    far = X - 2 * (out - X)  # the limit decides no more
    assert made.look(far, sloped=False).used < 0.85 and of_all(oracle, far).used < 0.5


def test_a_limit_that_does_not_decide_needs_the_units_behind_its_slope_alone():
    far = {"y": ONE, "b": Requirement(upper=2.0, target=0.99)}
    made, one = (constraints(required, costly=True, samples=UNITS) for required in (far, {"y": ONE}))
    counts = []
    for each in (made, one):
        each.look(X)
        before = each.units.solved
        each.look(X + 0.001 * WAY)
        counts.append(each.units.solved - before)
    assert counts[0] < counts[1] + 2 * 0.04 * UNITS  # those behind its slope


def test_many_small_steps_never_lose_a_unit(thorough):
    """Values of units far inside are of the first vector; after many steps some of them are near."""
    made, oracle = (constraints({"y": ONE}, costly=True, samples=UNITS) for _ in range(2))
    made.look(X)
    for k in range(1, 40):
        x = X + 0.02 * k * WAY
        used = made.look(x, sloped=False).used
        assert (k % 3 and not thorough) or used == pytest.approx(of_all(oracle, x).used, rel=1e-12)


def test_many_small_steps_of_a_mid_point_bring_units_from_the_other_side(thorough):
    """They come nearer a little at each step."""
    made, oracle = (constraints({"y": ONE}, costly=True, samples=UNITS) for _ in range(2))
    made.look(X)
    for k in range(1, 30):
        x = X + np.array([0, 0, 0, 0.1 * k, 0, 0])
        used = made.look(x, sloped=False).used
        assert (k % 3 and not thorough) or used == pytest.approx(of_all(oracle, x).used, rel=1e-12)


def test_calls_of_near_units_are_full(monkeypatch):
    sizes, of_part = [], Units.of_part

    def counted(self, part, population, z):
        sizes.append(z.shape[1])
        return of_part(self, part, population, z)

    monkeypatch.setattr(Units, "of_part", counted)
    made = constraints({"y": ONE}, costly=True, samples=UNITS)
    for step in (0.0, 1e-4, 0.03):
        made.look(X + step * WAY, sloped=False)
    assert sizes[0] == UNITS and len(sizes) >= 3 and not any(size % AT_ONCE for size in sizes)


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_a_unit_that_fails_in_one_part_fails_in_all(shift):
    """The number d moves the error above which b fails; y is another part, which has no failures of its own."""

    class Of(NamedTuple):
        names: tuple
        costly: bool = True

        def parts(self):
            return [Of((name,)) for name in self.names]

        def __call__(self, e, v):
            value = {"y": e["a"] + 0.6 * e["b"] - 0.5 * e["c"], "b": e["b"] + 0.0 * v["d"]}
            high = jnp.where(e["b"] > 0.2 / v["d"], int(Status.NONFINITE), int(Status.CONVERGED))
            return Outcome({n: value[n] for n in self.names}, high if "b" in self.names else int(Status.CONVERGED))

    required = {"y": Requirement(lower=-0.45, upper=0.45, target=0.9), "b": Requirement(upper=0.19, target=0.9)}
    made, oracle = (constraints(required, response=Of(("y", "b")), costly=True, samples=UNITS) for _ in range(2))
    x = X + np.array([0, 0, 0, 0, 0, shift])
    made.look(X)
    found, due = made.values(x), oracle.values(x)
    assert np.isnan(due["y"]).sum() > 10 and (np.isnan(found["y"]) == np.isnan(found["b"])).all()
    assert made.look(x).used == pytest.approx(oracle.look(x).used, rel=1e-12)


def test_a_slope_takes_the_state_of_its_own_unit(monkeypatch):
    """The state of a unit is its error a here. Units of a limit that does not decide are solved for their slopes."""
    seen, missing = [], []
    solve, pull, of_elements = Part.solve, Part.slopes_of_elements, Part.of_elements

    def solved(self, population, z):
        values, status, _ = solve(self, population, z)
        return values, status, 0.1 * z[:1]  # a third of the half-width 0.3

    def found(self, population, errors):
        missing.append(errors.shape[1])
        values, status, _ = of_elements(self, population, errors)
        return values, status, errors[:1]

    def pulled(self, population, errors, state, cotangents):
        seen.append((errors[0], state[0]))
        return pull(self, population, errors, of_elements(self, population, errors)[2], cotangents)

    monkeypatch.setattr(Part, "solve", solved)
    monkeypatch.setattr(Part, "of_elements", found)
    monkeypatch.setattr(Part, "slopes_of_elements", pulled)
    made = constraints({"y": ONE, "b": Requirement(upper=2.0, target=0.99)}, costly=True, samples=UNITS)
    made.look(X)
    assert not missing
    made.look(X + 0.01 * WAY * np.array([0, 1, 1, 1, 1, 1]))
    for errors, state in seen:
        np.testing.assert_allclose(errors, state, rtol=1e-9)
    assert len(seen) == 2 and len(missing) == 1 and 0 < missing[0] < len(seen[1][0])


BOTH_PARTS = Two("both")  # one program for all


def allocated(need, seed=0):
    """The cheapest half-widths of two costly parts with equal values, and the units of each that tests solved."""
    solved, tests, solve, test = Counter(), Counter(), Part.solve, Certifier.test

    def counted(self, population, z):
        solved[self.names] += z.shape[1]
        return solve(self, population, z)

    def tested(self, *given):
        before = solved.copy()
        found = test(self, *given)
        tests.update(solved - before)
        assert len(next(iter(found.values.values()))) == self.run.samples == len(self._near.z.T)
        return found

    with mock.patch.object(Part, "solve", counted), mock.patch.object(Certifier, "test", tested):
        found = allocate(
            BOTH_PARTS, dict.fromkeys("ab", Tolerance.symmetric(0.1)), need,
            samples=512, certificate_samples=8192, seed=seed,
            costs=dict.fromkeys("ab", ReciprocalPower(reference=0.3, finest=0.02, coarsest=3.0)),
            variables={"d": Variable(0.99, 1.01, 1.0)},
        )  # fmt: skip
    return found, tests


def test_a_certificate_solves_the_parts_that_do_not_decide_at_the_end_alone():
    found, tests = allocated(FAR)
    assert found.status == "OPTIMAL" and set(found.certificate.verdicts) == set(FAR)
    assert found.certificate.values["w"] == pytest.approx(found.certificate.values["y"])
    assert tests["y",] >= 8192 and not tests["w",]
    assert found.margin_slopes["w"]["a"] > 0


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.long)])
def test_a_limit_that_was_set_aside_and_decides_is_searched_again(monkeypatch, seed):
    """As if the search had not seen that the limit decides: its few units promise too much."""
    spare = Constraints.spare

    def wrongly(self, look):
        spare(self, look)
        self.aside = frozenset() if look is None else frozenset(["w"])

    need = dict(y=Requirement(upper=0.5, target=0.9), w=Requirement(upper=0.4, target=0.995))
    due, _ = allocated(need, seed)
    monkeypatch.setattr(Constraints, "spare", wrongly)
    found, _ = allocated(need, seed)
    assert found.status == "OPTIMAL" and found.certificate.verdicts["w"].met
    assert found.cost == pytest.approx(due.cost, rel=0.02)
