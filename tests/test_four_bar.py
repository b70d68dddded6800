"""One four-bar linkage: values, invariants, derivatives, statuses.

Oracles: a reference file computed with 40 digits by circle intersection and vector sums (tolerances are the
file's own: float64 1e-10 relative, float32 1e-5); the vector loop, intersected circles and a minimised energy
in mpmath over random linkages (1e-11 relative: rounding of the inputs, amplified near the dead points);
closed-form sensitivities; finite differences (steps of 1e-3 of the deviation, so 1e-5 relative).
"""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from four_bar_cases import EXACT, METHODS, MM, batch, columns, linkages, one, padded, random_linkages, slopes, solver
from rvjax import LinkDeviations, Status, check, four_bar

READINGS = {
    "free_open_exact": [("free", "newton", "open"), ("free", "closed_form", "open")],
    "free_crossed_exact": [("free", "newton", "crossed"), ("free", "closed_form", "crossed")],
    "free_open_quadratic": [("free", "quadratic", "open")],
    "free_crossed_quadratic": [("free", "quadratic", "crossed")],
    "free_first_order": [("free", "first_order", "open")],
    "locked": [("phase_locked", "newton", "open"), ("phase_locked", "closed_form", "open")],
    "locked_first_order": [("phase_locked", "first_order", "open")],
}
E, SPACING = 1.3 * MM, 72 * MM
FREE = [methods for methods in METHODS if methods[0] == "free"]


def names(status):
    return [Status(int(value)).name for value in np.atleast_1d(status)]


def at(methods, angle, e=E, spacing=SPACING, ratio=1.0, **deviations):
    """Linkages that share everything but what is given as an array."""
    deviations = batch(**deviations)
    full = np.broadcast_arrays(e, spacing, angle, ratio, *columns(deviations))
    e, spacing, angle, ratio = (np.array(x, float) for x in full[:4])
    arguments = [np.atleast_1d(x) for x in (e, spacing)], batch(*map(np.atleast_1d, full[4:]))
    return solver(methods)(*arguments[0], arguments[1], np.atleast_1d(angle), np.atleast_1d(ratio))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("reading", READINGS)
def test_reference_closures(reference, reading, dtype):
    cases = reference("four_bar")["closure"]
    expected = np.array([np.nan if c["expected"][reading] is None else c["expected"][reading] for c in cases])
    inputs = linkages(cases, dtype)
    relative, absolute = (1e-10, 1e-18) if dtype == np.float64 else (1e-5, 1e-11)
    if dtype == np.float32 and reading == "free_first_order":
        absolute = 1e-9  # cos of 90 deg rounded to float32 is -4e-8
    regular = np.full(len(cases), True) if dtype == np.float64 else np.abs(np.sin(inputs[3])) > 0.3
    for methods in READINGS[reading]:
        result = solver(methods)(*inputs)
        assert result.coupler_angle.dtype == dtype
        np.testing.assert_allclose(result.coupler_angle[regular], expected[regular], relative, absolute)
        if dtype == np.float32:
            continue
        gap = np.array([c["expected"]["gap_mm"] for c in cases]) * MM
        np.testing.assert_allclose(result.gap, gap, 1e-10, 1e-18)
        if methods[0] == "free":
            assert names(result.info.status) == [c["free_status"] for c in cases]
        else:
            misfit = np.array([c["expected"]["locked_misfit_mm"] for c in cases]) * MM
            np.testing.assert_allclose(result.misfit, misfit, 1e-10, 1e-18)
            assert set(names(result.info.status)) == {"CONVERGED"}


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_reference_geared(reference, dtype):
    cases = reference("four_bar")["geared"]
    inputs = linkages(cases, dtype)
    regular = np.full(len(cases), True) if dtype == np.float64 else np.abs(np.sin(inputs[3])) > 0.3
    relative, absolute = (1e-10, 1e-18) if dtype == np.float64 else (1e-5, 1e-9)
    for closure, key in (("newton", "geared"), ("first_order", "geared_first_order")):
        result = solver(("geared", closure, "open"))(*inputs)
        expected = np.array([c["expected"][key] for c in cases])
        np.testing.assert_allclose(result.coupler_angle[regular], expected[regular], relative, absolute)
        assert set(names(result.info.status)) == {"CONVERGED"}
        assert result.coupler_angle.dtype == dtype
        if closure == "newton" and dtype == np.float64:
            misfit = np.array([c["expected"]["geared_misfit_mm"] for c in cases]) * MM
            np.testing.assert_allclose(result.misfit, misfit, 1e-10, 1e-18)


# --- independent geometry ----------------------------------------------------------------------------


def vectors(e, spacing, d, angle):
    """Pin 1 and the axis of crank 3 moved by the joints, as complex numbers, and the link lengths."""
    d1, d2, d3, d4, _, b4, gx, gy = d
    pin = (e + d1) * mpmath.expj(angle)
    axis = (spacing + d4) * mpmath.expj(b4) + mpmath.mpc(gx, gy)
    return pin, axis, spacing + d2, e + d3


def intersected(e, spacing, d, angle, branch):
    """Coupler direction from the intersection of two circles about pin 1 and the axis of crank 3."""
    pin, axis, l2, l3 = vectors(e, spacing, d, angle)
    to_axis = axis - pin
    reach = abs(to_axis)
    along = (l2**2 - l3**2 + reach**2) / (2 * reach)
    across = mpmath.sqrt(l2**2 - along**2)
    # A parallelogram turns the same way round on both sides of the line from pin 1 to the axis of crank 3.
    side = mpmath.sign((pin * mpmath.conj(axis)).imag) * (1 if branch == "open" else -1)
    return mpmath.arg((along + 1j * side * across) * to_axis)


@pytest.mark.parametrize("branch", ["open", "crossed"])
def test_free_linkage_is_an_intersection_of_circles(branch):
    inputs = e, spacing, deviations, angle, _ = random_linkages(40, seed=1, size=10e-6, away=0.5)
    result = solver(("free", "newton", branch))(*inputs)
    rows = np.array(columns(deviations)).T
    with mpmath.workdps(30):
        expected = [float(intersected(*row)) for row in zip(e, spacing, rows.tolist(), angle, [branch] * 40)]
    np.testing.assert_allclose(result.coupler_angle, expected, rtol=1e-11, atol=1e-17)


@pytest.mark.parametrize("cranks", ["phase_locked", "geared"])
def test_geared_cranks_share_the_misfit(cranks):
    inputs = e, spacing, deviations, angle, ratio = random_linkages(12, seed=2)
    result = solver((cranks, "newton", "open"))(*inputs)
    for i, row in enumerate(np.array(columns(deviations)).T.tolist()):
        with mpmath.workdps(30):
            pin, axis, l2, l3 = vectors(e[i], spacing[i], row, angle[i])

            def coupler(slip, pin=pin, axis=axis, l3=l3, psi=row[4], b1=angle[i]):
                return axis + l3 * mpmath.expj(b1 + psi + slip) - pin

            def force(slip, i=i, l2=l2, coupler=coupler):
                stretch = abs(coupler(slip)) - l2
                slope = mpmath.diff(lambda s: abs(coupler(s)), slip)
                return stretch * slope + ratio[i] * e[i] ** 2 * slip

            slip = mpmath.findroot(force, mpmath.mpf(0)) if cranks == "geared" else 0
            vector = coupler(slip)
            np.testing.assert_allclose(result.coupler_angle[i], float(mpmath.arg(vector)), rtol=1e-11)
            np.testing.assert_allclose(result.misfit[i], float(abs(vector) - l2), rtol=1e-9)


# --- invariants --------------------------------------------------------------------------------------


@pytest.mark.parametrize("methods", [m for m in EXACT if m[0] == "free"])
def test_vector_loop_closes(methods):
    inputs = e, spacing, deviations, angle, _ = random_linkages(500, seed=3, away=0.6)
    result = solver(methods)(*inputs)
    d1, d2, d3, d4, _, b4, gx, gy = columns(deviations)
    chain = (e + d1) * np.exp(1j * angle) + (spacing + d2) * np.exp(1j * np.asarray(result.coupler_angle))
    crank_3 = chain - (spacing + d4) * np.exp(1j * b4) - (gx + 1j * gy)
    assert np.max(np.abs(np.abs(crank_3) - (e + d3))) < 1e-15 * 120  # rounding of lengths of 120 mm
    assert set(names(result.info.status)) == {"CONVERGED"}
    assert np.all(np.asarray(result.misfit) == 0)


@pytest.mark.parametrize("methods", METHODS)
def test_parallelogram_stays_at_zero(methods):
    if methods[2] == "crossed":
        pytest.skip("the crossed branch has no zero")
    angle = np.deg2rad(np.arange(1, 360, 7.0))
    exact = at(methods, angle)
    assert np.all(np.asarray(exact.coupler_angle) == 0)
    assert np.all(np.asarray(exact.misfit) == 0)
    equal = at(methods, angle, d1=3e-5, d3=3e-5, d2=-2e-5, d4=-2e-5)  # still a parallelogram
    assert np.max(np.abs(equal.coupler_angle)) < 1e-13  # rounding of lengths over e sin(b1)


@pytest.mark.parametrize("methods", METHODS)
def test_angles_do_not_depend_on_size(methods):
    e, spacing, deviations, angle, ratio = random_linkages(100, seed=4, away=0.3)
    d1, d2, d3, d4, psi, b4, gx, gy = columns(deviations)
    scaled = batch(*(7.3 * x for x in (d1, d2, d3, d4)), psi, b4, 7.3 * gx, 7.3 * gy)
    first = solver(methods)(e, spacing, deviations, angle, ratio).coupler_angle
    second = solver(methods)(7.3 * e, 7.3 * spacing, scaled, angle, ratio).coupler_angle
    np.testing.assert_allclose(first, second, rtol=1e-11)


@pytest.mark.parametrize("methods", METHODS)
def test_mirror(methods):
    e, spacing, deviations, angle, ratio = random_linkages(100, seed=5, away=0.3)
    d1, d2, d3, d4, psi, b4, gx, gy = columns(deviations)
    first = solver(methods)(e, spacing, deviations, angle, ratio)
    second = solver(methods)(e, spacing, batch(d1, d2, d3, d4, -psi, -b4, gx, -gy), -angle, ratio)
    np.testing.assert_allclose(first.coupler_angle, -second.coupler_angle, rtol=1e-12)
    np.testing.assert_allclose(first.gap, second.gap, rtol=1e-12)


@pytest.mark.parametrize("methods", EXACT)
def test_turning_the_whole_linkage(methods):
    e, spacing, deviations, angle, ratio = random_linkages(100, seed=6, away=0.3)
    d1, d2, d3, d4, psi, b4, gx, gy = columns(deviations)
    turn = 0.6
    g = (gx + 1j * gy) * np.exp(1j * turn)
    first = solver(methods)(e, spacing, deviations, angle, ratio)
    second = solver(methods)(e, spacing, batch(d1, d2, d3, d4, psi, b4 + turn, g.real, g.imag), angle + turn, ratio)
    np.testing.assert_allclose(second.coupler_angle, first.coupler_angle + turn, rtol=1e-11)
    np.testing.assert_allclose(second.misfit, first.misfit, rtol=1e-9, atol=1e-16)


def test_swapping_the_cranks():
    inputs = e, spacing, deviations, angle, ratio = random_linkages(100, seed=7, away=0.3)
    d1, d2, d3, d4 = columns(deviations)[:4]
    first = solver(("free", "newton", "open"))(e, spacing, batch(d1, d2, d3, d4), angle, ratio).coupler_angle
    l4 = spacing + d4
    crank_3 = (e + d1) * np.exp(1j * angle) + (spacing + d2) * np.exp(1j * np.asarray(first)) - l4
    second = solver(("free", "newton", "open"))(e, spacing, batch(d3, d2, d1, d4), np.pi - np.angle(crank_3), ratio)
    np.testing.assert_allclose(first, -second.coupler_angle, rtol=1e-10, atol=1e-16)
    assert len(inputs) == 5


def test_quadratic_roots_obey_vieta():
    e, spacing, deviations, angle, ratio = random_linkages(100, seed=8, away=0.3)
    d1, d2, d3, d4 = columns(deviations)[:4]
    deviations = batch(d1, d2, d3, d4)  # no joint, no frame angle: the frame vector is the x axis
    roots = [
        solver(("free", "quadratic", b))(e, spacing, deviations, angle, ratio).coupler_angle
        for b in ("open", "crossed")
    ]
    l1, l2, l3, l4 = e + d1, spacing + d2, e + d3, spacing + d4
    a, b = l2 * (l4 - l1 * np.cos(angle)), 2 * l1 * l2 * np.sin(angle)
    c = l1**2 - l3**2 + 2 * l1 * (l2 - l4) * np.cos(angle) + (l2 - l4) ** 2
    np.testing.assert_allclose(roots[0] + roots[1], -b / a, rtol=1e-12)
    np.testing.assert_allclose(roots[0] * roots[1], c / a, rtol=1e-8)  # the printed c cancels


def test_locked_half_turn_and_coupler():
    e, spacing, deviations, angle, ratio = random_linkages(100, seed=9)
    d1, d2, d3, d4, _, b4, gx, gy = columns(deviations)
    locked = solver(("phase_locked", "closed_form", "open"))
    first = locked(e, spacing, batch(d1, d2, d3, d4, 0.0, b4, gx, gy), angle, ratio)
    opposite = locked(e, spacing, batch(-d1, d2, -d3, d4, 0.0, b4, gx, gy), angle + np.pi, ratio)
    np.testing.assert_allclose(first.coupler_angle, opposite.coupler_angle, rtol=1e-12)
    longer = locked(e, spacing, batch(d1, d2 + 1e-4, d3, d4, 0.0, b4, gx, gy), angle, ratio)
    assert np.array_equal(first.coupler_angle, longer.coupler_angle)
    np.testing.assert_allclose(first.misfit - longer.misfit, 1e-4, rtol=1e-9)


def test_geared_joins_free_and_locked():
    e, spacing, deviations, angle, _ = random_linkages(50, seed=10, size=5e-6, away=0.5)
    geared = solver(("geared", "newton", "open"))
    for methods, ratio, tolerance in (
        (("free", "newton", "open"), 1e-7, 1e-5),
        (("phase_locked", "newton", "open"), 1e9, 1e-6),
    ):
        limit = solver(methods)(e, spacing, deviations, angle, np.ones(50))
        result = geared(e, spacing, deviations, angle, np.full(50, ratio))
        assert set(names(result.info.status)) == {"CONVERGED"}
        np.testing.assert_allclose(result.coupler_angle, limit.coupler_angle, rtol=tolerance)


# --- derivatives -------------------------------------------------------------------------------------


def sensitivities(cranks, angle):
    """Closed-form derivatives of b2 at zero error, in the order of the deviations; float derivations by hand."""
    sine, cosine, one_ = np.sin(angle), np.cos(angle), np.ones_like(angle)
    if cranks == "free":
        cot = cosine / sine
        rows = [-1 / sine, -cot, 1 / sine, cot, 0 * one_, SPACING * one_, cot, one_]
    else:
        rows = [-sine, 0 * one_, sine, 0 * one_, E * cosine, SPACING * one_, 0 * one_, one_]
    return np.array(rows) / SPACING


@pytest.mark.parametrize("methods", [m for m in METHODS if m[2] == "open" and m[0] != "geared"])
def test_sensitivities_at_zero_error(methods, reference):
    angle = np.deg2rad(np.array([90, 30, 60, 137, 211, 300.0]))
    zeros = batch(*np.zeros((8, 6)))
    _, _, found = slopes(methods)((np.full(6, E), np.full(6, SPACING), zeros), angle, np.ones(6))
    np.testing.assert_allclose(columns(found), sensitivities(methods[0], angle), rtol=1e-12, atol=1e-11)
    printed = reference("four_bar")["sensitivities"]
    key = "free_open_exact" if methods[0] == "free" else "locked"
    order = ["crank_1", "coupler", "crank_3", "frame", "crank_phase", "frame_angle", "joint_x", "joint_y"]
    for i, case in enumerate(printed):
        per = [case[key].get(f"{name}_per_mm", case[key].get(f"{name}_per_rad")) for name in order]
        scale = [1 if name in ("crank_phase", "frame_angle") else 1e3 for name in order]
        np.testing.assert_allclose(np.array(columns(found))[:, i], np.multiply(per, scale), rtol=1e-10, atol=1e-11)


def test_locked_zero_error_is_finite_everywhere():
    angle = np.concatenate([np.deg2rad(np.arange(0, 361, 15.0)), [0, np.pi, 2 * np.pi]])
    for methods in (m for m in METHODS if m[0] != "free"):
        n = len(angle)
        result = at(methods, angle)
        assert np.all(np.asarray(result.coupler_angle) == 0)
        numbers = (np.full(n, E), np.full(n, SPACING), batch(*np.zeros((8, n))))
        for leaf in jax.tree.leaves(slopes(methods)(numbers, angle, np.ones(n))):
            assert np.all(np.isfinite(leaf))


@pytest.mark.parametrize("methods", METHODS)
def test_derivatives_equal_differences(methods):
    e, spacing, deviations, angle, ratio = random_linkages(20, seed=11, away=0.4)
    numbers = (e, spacing, deviations)
    found = jax.tree.leaves(slopes(methods)(numbers, angle, ratio))
    leaves, tree = jax.tree.flatten(numbers)
    for i, leaf in enumerate(leaves):
        step = 1e-6 if i in (6, 7) else 1e-8  # rad, m

        def shifted(by, i=i, leaf=leaf):
            moved = tree.unflatten([*leaves[:i], leaf + by, *leaves[i + 1 :]])
            return np.asarray(solver(methods)(*moved, angle, ratio).coupler_angle)

        difference = (8 * (shifted(step) - shifted(-step)) - (shifted(2 * step) - shifted(-2 * step))) / (12 * step)
        np.testing.assert_allclose(found[i], difference, rtol=1e-6, atol=1e-7 if i in (6, 7) else 1e-6)


@pytest.mark.parametrize("methods", [m for m in METHODS if m[1:] == ("newton", "open")])
def test_second_derivatives(methods):
    def gradient(vector, crank_angle):
        def coupler_angle(vector):
            deviations = jax.tree.unflatten(jax.tree.structure(LinkDeviations()), list(vector))
            return one(E, SPACING, deviations, crank_angle, 5.0, methods=methods).coupler_angle

        return jax.grad(coupler_angle)(vector)

    def curvature(vector, direction, crank_angle):
        return jax.jvp(lambda v: gradient(v, crank_angle), (vector,), (direction,))[1]

    first, second = padded(gradient), padded(curvature)
    _, _, deviations, angle, _ = random_linkages(6, seed=12, away=0.6)
    vector = np.array(columns(deviations)).T
    direction = np.random.default_rng(0).normal(size=vector.shape)
    found = second(vector, direction, angle)
    difference = (first(vector + 1e-7 * direction, angle) - first(vector - 1e-7 * direction, angle)) / 2e-7
    np.testing.assert_allclose(found, difference, rtol=1e-4, atol=2e-2)  # of 1/m^2, up to 1e5
    if methods[0] == "free":  # b2 = -d2^2/(2 e l) and the same of d4, nearly, at 90 deg
        zero = second(np.zeros((2, 8)), np.eye(8)[[1, 3]], np.full(2, np.pi / 2))
        np.testing.assert_allclose([zero[0, 1], zero[1, 3]], -1 / (E * SPACING), rtol=2e-2)


def test_newton_equals_closed_form():
    inputs = e, spacing, deviations, angle, ratio = random_linkages(200, seed=13, away=0.2)
    for cranks, branch in (("free", "open"), ("free", "crossed"), ("phase_locked", "open")):
        pair = [(cranks, closure, branch) for closure in ("newton", "closed_form")]
        values = [solver(methods)(*inputs).coupler_angle for methods in pair]
        np.testing.assert_allclose(*values, rtol=1e-11)
        tangents = [jax.tree.leaves(slopes(methods)((e, spacing, deviations), angle, ratio)) for methods in pair]
        for first, second in zip(*tangents):
            np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-10)


# --- outside the ordinary ----------------------------------------------------------------------------


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


@pytest.mark.parametrize("methods", METHODS)
def test_lost_lanes_leave_their_neighbours_alone(methods):
    size = 6
    e, spacing, deviations, angle, _ = random_linkages(2 * size, seed=14, away=0.6)
    e, spacing = jnp.asarray(e[0]), jnp.asarray(spacing[0])  # shared by all lanes
    rows = np.array(columns(deviations))
    lost = rows.copy()
    lost[0, size:] = [np.nan, -1.0, 0, 0, 0, 0]
    lost[1, size:] = [0, 0, 2 * MM, 1.0, np.inf, -1.0]
    lost_angle = angle.copy()
    lost[:, -3], lost_angle[-3] = 0, 0  # no error at the dead point
    lost[:, -1], lost_angle[-1] = 0, np.nan

    @jax.jit
    def gradients(rows, angle):
        def total(shared, deviations):
            def solve(deviations, angle):
                return one(*shared, deviations, angle, 5.0, methods=methods)

            result = jax.vmap(solve)(deviations, angle)
            counted = result.info.status == Status.CONVERGED
            lanes = jnp.where(counted, result.coupler_angle, 0)
            return jnp.sum(lanes[:size]) + 1e-30 * jnp.sum(lanes), (lanes, counted)

        tree = jax.tree.structure(LinkDeviations())
        return jax.grad(total, argnums=(0, 1), has_aux=True)((e, spacing), tree.unflatten(list(rows)))

    (shared, each), (values, _) = gradients(rows, angle)
    (lost_shared, lost_each), (lost_values, counted) = gradients(lost, lost_angle)
    assert np.array_equal(lost_values[:size], values[:size])
    np.testing.assert_allclose(lost_shared, shared, rtol=1e-12)
    assert np.all(counted[:size])
    assert not counted[size]
    assert not counted[-1]
    for lane, lost_lane in zip(columns(each), columns(lost_each)):
        assert np.array_equal(lane[:size], lost_lane[:size])
        assert np.all(np.isfinite(lost_lane))
        assert np.all(np.asarray(lost_lane)[~np.asarray(counted)] == 0)


def test_check_speaks_for_a_batch():
    inputs = random_linkages(4, seed=15, away=0.4)
    check(solver(("free", "newton", "open"))(*inputs))
    bad = batch(d2=np.array([0, 2 * MM]))
    with pytest.raises(Exception, match="NOT_ASSEMBLABLE 1"):
        check(solver(("free", "newton", "open"))(np.full(2, E), np.full(2, SPACING), bad, np.full(2, 1.5), np.ones(2)))
