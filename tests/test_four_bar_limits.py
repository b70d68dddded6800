"""One four-bar linkage outside the ordinary: impossible methods and lengths, dead points, folds, lost inputs.

Oracles: the geometry of each case, worked out beside it; statuses by their definition.
"""

import numpy as np
import pytest
from four_bar_cases import METHODS, MM, SPACING, E, at, batch, names, random_linkages, solver

from rvjax import LinkDeviations, check, four_bar

FREE = [methods for methods in METHODS if methods[0] == "free"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(cranks="locked"), "cranks"),
        (dict(branch="other"), "branch"),
        (dict(closure="exact"), "closure"),
        (dict(closure="quadratic"), "closure"),
        (dict(branch="crossed"), "branch"),
        (dict(cranks="free", closure="first_order", branch="crossed"), "closure"),
        (dict(gear_stiffness_ratio=67.0), "gear_stiffness_ratio"),
        (dict(cranks="free", gear_stiffness_ratio=67.0), "gear_stiffness_ratio"),
        (dict(cranks="geared"), "gear_stiffness_ratio"),
        (dict(cranks="geared", gear_stiffness_ratio=0.0), "gear_stiffness_ratio"),
        (dict(cranks="geared", gear_stiffness_ratio=67.0, closure="closed_form"), "closure"),
        (dict(cranks="geared", gear_stiffness_ratio=67.0, branch="crossed"), "branch"),
    ],
)
def test_impossible_methods(arguments, message):
    with pytest.raises(ValueError, match=message):
        four_bar.solve_closure(E, SPACING, LinkDeviations(), crank_angle=1.0, **arguments)


def test_impossible_lengths_raise_where_concrete():
    with pytest.raises(ValueError, match=r"eccentricity \+ crank_1 = -0.0007 m"):
        four_bar.solve_closure(E, SPACING, LinkDeviations(crank_1=-2 * MM), crank_angle=1.0, cranks="free")
    with pytest.raises(ValueError, match="spacing = 0 m"):
        four_bar.solve_closure(E, 0.0, LinkDeviations(), crank_angle=1.0)
    four_bar.solve_closure(E, SPACING, LinkDeviations(crank_1=-2 * MM), crank_angle=1.0)


@pytest.mark.parametrize("methods", FREE)
def test_free_statuses(methods):
    fold = 2 * E  # coupler too long by the crank's play at 90 deg
    reach = np.hypot(SPACING, E)
    cases = {
        "CONVERGED": dict(angle=np.pi / 2, d1=1e-5),
        "CHANGE_POINT": dict(angle=np.pi, d1=-1e-5, d2=0.0),
        "NOT_ASSEMBLABLE": dict(angle=np.pi / 2, d2=2 * MM),
        "SINGULAR": dict(angle=np.pi / 2, d2=reach + E - SPACING),
        "INVALID_GEOMETRY": dict(angle=np.pi / 2, d1=-fold),
        "NONFINITE": dict(angle=np.pi / 2, gx=np.nan),
    }
    for name, case in cases.items():
        result = at(methods, **case)
        assert names(result.info.status) == [name]
        lost = name in ("NOT_ASSEMBLABLE", "INVALID_GEOMETRY", "NONFINITE")
        linear = methods[1] == "first_order"
        assert np.isnan(result.coupler_angle[0]) == (
            (lost and not (linear and name == "NOT_ASSEMBLABLE")) or (linear and name == "CHANGE_POINT")
        )
    np.testing.assert_allclose(at(methods, **cases["NOT_ASSEMBLABLE"]).gap, 0.688e-3, rtol=1e-3)
    np.testing.assert_allclose(at(methods, np.deg2rad(5), d1=2e-5).gap, 14.9e-6, rtol=2e-3)
    assert names(at(methods, np.deg2rad(5), d1=2e-5).info.status) == ["NOT_ASSEMBLABLE"]
    assert names(at(methods, 1.0, e=0.0).info.status)[0] in ("CHANGE_POINT", "INVALID_GEOMETRY")
    assert names(at(methods, 1.0, d2=1.0).info.status) == ["NOT_ASSEMBLABLE"]
    assert names(at(methods, 1.0, spacing=-1.0, d2=np.inf).info.status) == ["NONFINITE"]  # precedence


@pytest.mark.parametrize("methods", [m for m in FREE if m[1] != "first_order"])
def test_dead_points_and_folds_are_roots(methods):
    sign = 1 if methods[2] == "open" else -1
    angle = np.array([0, np.pi, 2 * np.pi])
    zero = at(methods, angle)
    assert names(zero.info.status) == ["CHANGE_POINT"] * 3
    assert np.max(np.abs(zero.coupler_angle)) < 1e-15
    # c < 0: roots +-sqrt(-c/a), the open one positive whatever rounding does to sin b1
    dead = at(methods, angle, d1=np.array([-1e-5, -1e-5, -1e-5]))
    assert np.all(sign * np.asarray(dead.coupler_angle) > 1e-3)
    d2 = np.hypot(SPACING, E) + E - SPACING
    fold = at(methods, np.pi / 2, d2=d2).coupler_angle[0]
    if methods[1] != "quadratic":
        np.testing.assert_allclose(fold, -np.arctan2(E, SPACING), rtol=1e-6)


def test_locked_extremes():
    for methods in (m for m in METHODS if m[0] == "phase_locked"):
        dead = at(methods, np.array([0, np.pi]), d1=2e-5, d2=1e-5, d4=-1e-5)
        assert names(dead.info.status) == ["CONVERGED"] * 2
        none = at(methods, 1.0, e=0.0, d1=1e-5, gy=2e-5)
        assert names(none.info.status) == ["CONVERGED"]
        np.testing.assert_allclose(none.coupler_angle, (2e-5 - 1e-5 * np.sin(1)) / SPACING, rtol=1e-3)
        long = at(methods, 1.0, d2=1.0)
        assert names(long.info.status) == ["CONVERGED"]
        np.testing.assert_allclose(long.misfit, -1.0, rtol=1e-12)
        assert long.gap[0] > 0.9
        backwards = at(methods, 1.0, d1=1e-5, b4=2.5)
        assert names(backwards.info.status) == ["CONVERGED"]


@pytest.mark.parametrize("methods", METHODS)
def test_lost_inputs_have_a_status(methods):
    """Every input may be NaN or infinite, every link may have no length."""
    n = 12
    e, spacing, angle, ratio = np.full(n, E), np.full(n, SPACING), np.full(n, 1.0), np.full(n, 5.0)
    deviations = np.full((8, n), 1e-6)
    for i, lost in enumerate((e, spacing, angle, *deviations)):
        lost[i] = np.nan if i % 2 else np.inf
    result = solver(methods)(e, spacing, batch(*deviations), angle, ratio)
    assert names(result.info.status) == ["NONFINITE"] * 11 + ["CONVERGED"]
    assert np.all(np.isnan(result.coupler_angle[:11]))
    assert np.all(np.isnan(result.misfit[:11]))
    assert np.isfinite(result.coupler_angle[11])
    for case in (dict(spacing=0.0), dict(spacing=-1.0), dict(d2=-SPACING), dict(d4=-2 * SPACING)):
        assert names(at(methods, 1.0, **case).info.status) == ["INVALID_GEOMETRY"]


def test_check_speaks_for_a_batch():
    inputs = random_linkages(4, seed=15, away=0.4)
    check(solver(("free", "newton", "open"))(*inputs))
    bad = batch(d2=np.array([0, 2 * MM]))
    with pytest.raises(Exception, match="NOT_ASSEMBLABLE 1"):
        check(solver(("free", "newton", "open"))(np.full(2, E), np.full(2, SPACING), bad, np.full(2, 1.5), np.ones(2)))
