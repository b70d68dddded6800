"""One four-bar linkage: values and invariants.

Oracles: a reference file computed with 40 digits by circle intersection and vector sums (tolerances are the
file's own: float64 1e-10 relative, float32 1e-5); the vector loop, intersected circles and a minimised energy
in mpmath over random linkages (1e-11 relative: rounding of the inputs, amplified near the dead points).
"""

import mpmath
import numpy as np
import pytest
from four_bar_cases import EXACT, METHODS, MM, at, batch, columns, linkages, names, random_linkages, solver

READINGS = {
    "free_open_exact": [("free", "newton", "open"), ("free", "closed_form", "open")],
    "free_crossed_exact": [("free", "newton", "crossed"), ("free", "closed_form", "crossed")],
    "free_open_quadratic": [("free", "quadratic", "open")],
    "free_crossed_quadratic": [("free", "quadratic", "crossed")],
    "free_first_order": [("free", "first_order", "open")],
    "locked": [("phase_locked", "newton", "open"), ("phase_locked", "closed_form", "open")],
    "locked_first_order": [("phase_locked", "first_order", "open")],
}


SINGLE = ("free_open_exact",)  # in single precision by default: its statuses depend on the rounding


@pytest.mark.parametrize(
    ("dtype", "reading"),
    [
        *((np.float64, reading) for reading in READINGS),
        *(pytest.param(np.float32, r, marks=[] if r in SINGLE else [pytest.mark.long]) for r in READINGS),
    ],
)
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


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
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
