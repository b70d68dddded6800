"""Play between cycloid flank and pins: first-order minimum and exact contact.

Oracle: a search of its own, with nothing in common with the library's formulas. A disc is generated as the inner
envelope of its pins; for every crank angle the pin centre is brought onto the offset curve by bisection on the
distance from the crank axis; the rotation this takes is scanned over the crank angle and the scan refined. In
extended precision (80 bit on x86), so 1e-10 relative is far from its own rounding; where the minimum is flat
(d near s D) the library promises 1e-7.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lost_motion_cases import solve as solve_reducer

from rvjax import RVErrors
from rvjax.catalogue import RV_20E
from rvjax.lost_motion import geometric, terms as flanks
from rvjax.units import arcmin, mm, um

E, RING, TEETH = 0.9 * mm, 52 * mm, 39
K = E * (TEETH + 1) / RING
S = np.sqrt(1 - K**2)


def make(D, d, e=E, ring=RING, teeth=TEETH):
    D, d, e, ring, teeth = (jnp.asarray(x, float) for x in (D, d, e, ring, teeth))
    return flanks.Flank(e, ring, e * (teeth + 1) / (ring + d), D, d, teeth)


class Search:
    """Free rotation of a disc against pins, by generating it and turning it until they touch."""

    def __init__(self, D, d, e=E, ring=RING, teeth=TEETH):
        self.e, self.ring, self.D = (np.longdouble(x) for x in (e, ring, D))
        self.ground, self.teeth = self.ring + np.longdouble(d), teeth

    def curve(self, angle):
        """Where a pin centre must be to touch, in the frame of the disc: the trochoid of the pins that ground it,
        offset by the difference of the pin radii along the normal into the disc."""
        turn = np.exp(1j * angle / self.teeth)
        arm = self.e * np.exp(1j * angle)
        tangent = 1j * turn * ((self.ground - arm) / self.teeth - arm)
        return (self.ground - arm) * turn + self.D * 1j * tangent / np.abs(tangent)

    def rotation(self, crank, side):
        """Free rotation at one crank angle against one flank, inf where the pin misses it."""
        pin = self.ring - self.e * np.exp(1j * crank)
        low, high = np.zeros_like(crank), np.full_like(crank, np.pi)

        def outside(x):
            return np.abs(self.curve(side * x)) - np.abs(pin)

        reached = (outside(low) <= 0) & (outside(high) >= 0)
        for _ in range(64):
            middle = (low + high) / 2
            beyond = outside(middle) > 0
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        turn = np.angle(self.curve(side * low) * np.conj(pin) * np.exp(-1j * crank / self.teeth))
        return np.where(reached, side * turn, np.inf)

    def one_side(self, side):
        ends = np.linspace(-9, 9, 361, dtype=np.longdouble)  # ln tan(crank / 2)
        for _ in range(9):
            value = self.rotation(2 * side * np.arctan(np.exp(ends)), side)
            best = int(np.argmin(value))
            ends = np.linspace(ends[max(best - 1, 0)], ends[min(best + 1, len(ends) - 1)], 25)
        return value.min()

    def play(self):
        return float(self.one_side(1) + self.one_side(-1))


def cases():
    """(D, d, e, ring, teeth) over six decades of deviation and all regions; seeded."""
    rng = np.random.default_rng(11)
    for size in 10 ** np.linspace(-9, -4.2, 8):
        D = size * rng.uniform(-1, 1)
        e = rng.uniform(0.5, 1.15) * mm
        yield D, D - size * rng.uniform(0.02, 1), e, RING, TEETH
    for r in (0.8, 0.9, 0.98):  # two minima
        yield 20 * um, r * 20 * um, E, RING, TEETH
    yield 5 * um, 1 * um, 2.2 * mm, 64 * mm, 11  # few teeth
    yield 100 * um, -50 * um, E, RING, TEETH  # large modification


def relative_error(case):
    found = solve(*case[:4], case[4])
    assert found.converged
    D, d, e, _, teeth = case
    exact = Search(*case).play()
    return abs(float(found.play) - exact) / abs(exact), (abs(D) + abs(d)) / (e * teeth) / abs(exact)


minimum = jax.jit(lambda *case: flanks.minimum(make(*case)))


def solve(*case):
    """In one program."""
    return minimum(*map(np.float64, case))


def test_exact_contact_equals_a_brute_force_search():
    for case in cases():
        error, cancelled = relative_error(case)
        assert error < 1e-10 * max(1, cancelled), case


@pytest.mark.parametrize("near", [0, 1e-7, -1e-7, 1e-5, -1e-5, 1e-3, -1e-3])
def test_exact_contact_where_two_minima_merge(near):
    for D in (1 * um, 30 * um):
        error, _ = relative_error((D, S * D * (1 + near), E, RING, TEETH))
        assert error < 1e-7


def test_reference_element(reference):
    """The first-order minimum at the shortening coefficient of the disc as ground."""
    checked = 0
    for case in reference("lost_motion")["cases"]:
        if case["kind"] == "geometric" and "closed_form_profile_arcmin" in case["expect"]:
            given = {name: value * mm for name, value in case["errors"].items()}
            design, error = case["design"], RVErrors(**given)
            D = design["equidistant_modification"] * mm + error.equidistant_modification
            D = D - error.pin_radius + error.pin_hole_clearance / 2
            d = design["shift_modification"] * mm + error.shift_modification - error.pin_circle_radius
            sizes = (E + error.eccentricity, RING + error.pin_circle_radius)
            flank = make(D, d, *sizes)
            value = flanks.first_order_minimum(flank) / arcmin
            np.testing.assert_allclose(value, case["expect"]["closed_form_profile_arcmin"], rtol=1e-12)
            found = solve(D, d, *sizes, TEETH)
            np.testing.assert_allclose(found.play / arcmin, case["expect"]["profile_arcmin"], rtol=1e-12)
            there = flanks.free_rotation(jnp.log(jnp.tan(case["expect"]["flank_angle_rad"] / 2)), flank)
            np.testing.assert_allclose(2 * there, found.play, rtol=1e-12)  # the other of two equal minima counts too
            checked += 1
    assert checked == 4


def test_a_ring_of_forty_pins_lies_a_little_above_the_flank_minimum():
    search = Search(10 * um, -2 * um)
    least = search.play()
    pins = 2 * np.pi * np.arange(40) / 40
    ring = []
    for crank in 2 * np.pi / 40 * np.arange(16) / 16:
        angles = (crank + pins + np.pi) % (2 * np.pi) - np.pi
        sides = [search.rotation(angles[side * angles > 0].astype(np.longdouble), side).min() for side in (1, -1)]
        ring.append(float(sum(sides)) / least - 1)
    assert min(ring) >= 0 and max(ring) < 6e-3 and 5e-4 < np.mean(ring) < 3e-3


def test_first_order_minimum_is_a_minimum():
    phi = np.linspace(1e-4, np.pi - 1e-4, 400001)
    for D, d in [(10e-6, 3e-6), (-3e-6, -9e-6), (10e-6, 8e-6), (10e-6, 9.9e-6), (0.0, -5e-6)]:
        flank = make(D, d)._replace(k=jnp.asarray(K))
        free = D * np.sqrt(1 + K**2 - 2 * K * np.cos(phi)) - d * (1 - K * np.cos(phi))
        scan = 2 * np.min(free / (E * TEETH * np.sin(phi)))
        np.testing.assert_allclose(flanks.first_order_minimum(flank), scan, rtol=1e-8)


def test_first_order_minimum_is_continuous_with_its_slope():
    D = 10 * um

    def play(d):
        return flanks.first_order_minimum(make(D, 0.0)._replace(k=jnp.asarray(K), d=d))

    both = jax.jit(jax.value_and_grad(play))
    (below, slope_below), (above, slope_above) = (both(S * D * (1 + side)) for side in (-1e-9, 1e-9))
    np.testing.assert_allclose(below, above, rtol=1e-7)
    np.testing.assert_allclose(slope_below, slope_above, rtol=1e-7)
    value, slope = both(D)
    assert value == 0 and np.isfinite(slope)


def test_contact_approaches_the_sum_as_the_square_of_the_errors():
    design = RV_20E.replace(
        cycloid=RV_20E.cycloid.replace(shortening=None, equidistant_modification=0.0, shift_modification=0.0)
    )

    def remainder(factor):
        errors = RVErrors(pin_circle_radius=8 * um * factor, pin_radius=-6 * um * factor)
        return solve_reducer(design, errors, profile="contact").terms.contact_remainder

    sizes = np.array([remainder(factor) for factor in (0.1, 0.01, 0.001, 0.0001)])
    np.testing.assert_allclose(sizes[1:] / sizes[:-1], 0.01, rtol=0.06)


def test_closed_form_equals_the_sum_without_eccentricity_error():
    errors = RVErrors(pin_circle_radius=8 * um, pin_hole_clearance=3 * um, disc_runout=2 * um, bearing_clearance=1 * um)
    totals = [solve_reducer(RV_20E, errors, profile=profile).total for profile in ("first_order", "closed_form")]
    np.testing.assert_allclose(*totals, rtol=1e-13)


@pytest.mark.long  # the levels' errors are measured and held in test_accuracy.py
def test_levels_differ_as_documented():
    """Errors uniform in the Table 9 bands, K1 derived: what the package's docstring says, in arcmin."""
    rng = np.random.default_rng(3)
    bands = dict(pin_circle_radius=10, pin_radius=4, eccentricity=5, equidistant_modification=1, shift_modification=3)
    drawn = {name: rng.uniform(-band, band, 20000) * um for name, band in bands.items()}
    drawn["pin_hole_clearance"] = rng.uniform(0, 5, 20000) * um
    design = RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=None))

    def level(profile):
        return jax.jit(jax.vmap(lambda e: geometric(design, RVErrors(**e), profile=profile)))(drawn)

    exact, closed, first = (level(profile) for profile in ("contact", "closed_form", "first_order"))
    np.testing.assert_array_equal(exact.valid, closed.valid)
    assert np.all(first.valid) and 0.32 < 1 - np.mean(exact.valid) < 0.36
    for result, rms, largest in ((first, 6e-3, 2.6e-2), (closed, 1.6e-4, 3e-4)):
        error = np.asarray((result.total - exact.total) / arcmin)[np.asarray(exact.valid)]
        assert rms / 2 < np.sqrt(np.mean(error**2)) < rms and np.abs(error).max() < largest


def test_gradient_of_the_minimum(thorough):
    """Central differences of the exact play, in one region, the other, and next to the merging."""

    def play(x):
        return flanks.minimum(make(x[0], x[1], x[2], x[3])).play

    points = np.array([[10e-6, -2e-6, E, RING], [20e-6, 18e-6, E, RING], [-4e-6, -9e-6, 1.1 * mm, RING]])
    step = np.array([1e-9, 1e-9, 1e-7, 1e-6])
    up = (points[:, None] + np.diag(step)[None]).reshape(-1, 4)
    down = (points[:, None] - np.diag(step)[None]).reshape(-1, 4)
    merging = np.array([[10e-6, float(S) * 10e-6, E, RING]])
    both = jax.jit(jax.value_and_grad(play))
    values, slopes = (np.stack(part) for part in zip(*map(both, np.concatenate([points, up, down, merging]))))
    difference = (values[3:15] - values[15:27]).reshape(3, 4)
    np.testing.assert_allclose(slopes[:3] * step[None] * 2, difference, rtol=1e-6, atol=2e-15)
    assert np.all(np.isfinite(slopes[-1]))
    if thorough:  # a program twice as large as that of the slopes
        hessian = jax.jit(jax.vmap(jax.jacfwd(jax.grad(play))))(points)
        second = (slopes[3:15] - slopes[15:27]).reshape(3, 4, 4) / (2 * step[None, :, None])
        scale = np.outer(step, step)[None]
        np.testing.assert_allclose(hessian * scale, second * scale, rtol=1e-4, atol=1e-5 * np.abs(second * scale).max())


def test_picometre_deviations_keep_their_digits():
    """Small enough for the sum to be exact; the flank angle plays no part."""
    for scale in (1e-12, 1e-15):
        D, d = 3 * scale, -2 * scale
        np.testing.assert_allclose(solve(D, d, E, RING, TEETH).play, 2 * (D - S * d) / (E * TEETH), rtol=1e-8)


def test_both_ends_of_the_room_to_assemble():
    design = RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=None))
    tight = partial(solve_reducer, design, profile="contact")
    base = -2 * um  # modifications are -10 and -12 um: D - d = 2 um
    fits = tight(RVErrors(equidistant_modification=base * (1 - 1e-9)))
    not_any_more = tight(RVErrors(equidistant_modification=base * (1 + 1e-9)))
    assert fits.valid and not not_any_more.valid
