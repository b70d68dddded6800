"""Errors as excitation of the dynamic model: response, statistics, invariants, extremes.

Oracles: closed forms of statics, sums over pins angle by angle, dense solves in NumPy; identities between calls.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from rvjax import Damping, MeshVariation, RVErrors, Status, dynamics
from rvjax.catalogue import RV_320E
from rvjax.dynamics import error_speeds
from tests.oracles.dynamics import Oracle

OUTPUTS = ("output.rotation", "sun.rotation", "transmission_error")
SPEED, MICRON = 200.0, 1e-6
DESIGN = RV_320E.replace(
    cranks=RV_320E.cranks.replace(count=3),
    cycloid=RV_320E.cycloid.replace(disc_count=2, disc_phase=0.4, pin_circle_radius=0.114),
    damping=Damping(loss_factor=0.04, rayleigh_mass=3.0, rayleigh_stiffness=1e-6, modal_ratio=0.01),
)
SHAPES = {
    "crank_eccentricity": (2, 3), "crank_phase": (3,), "disc_bore": (2, 3, 2), "carrier_bore": (3, 2),
    "pin_offset": (40, 2), "pin_radii": (40,), "ring_centre": (2,), "disc_centre": (2, 2), "sun_runout": (2,),
    "planet_runout": (3, 2), "sun_flank": (3, 2), "planet_flank": (3, 2, 2), "disc_flank": (2, 2, 2),
    "ring_flank": (4, 2),
}  # fmt: skip


def drawn(seed):
    draw = np.random.default_rng(seed).normal
    return {name: MICRON * draw(size=shape) for name, shape in SHAPES.items()}


def none():
    return {name: np.zeros(shape) for name, shape in SHAPES.items()}


def response(design, errors, speed, load):
    return dynamics.transmission_error(design, RVErrors(**errors), sun_speed=speed, load_inertia=load)


program = jax.jit(response)


def respond(errors, speed, design=DESIGN, load=3.0):
    """The response of one unit; designs and errors are traced, so that one program serves."""
    return jax.tree.map(np.asarray, program(design, errors, float(speed), load))


@jax.jit
def excite(errors):
    return dynamics.error_excitation(DESIGN, RVErrors(**errors))


@jax.jit
def transferred(design, frequency, load):
    return dynamics.error_transfer(design, frequency=frequency, load_inertia=load, outputs=OUTPUTS)


@jax.jit
def slopes(errors, weights):
    """Derivatives of the parts of all lines, weighted, and of the peak to peak, weighted."""

    def total(errors):
        found = response(DESIGN, errors, SPEED, 3.0)
        line = found.amplitude[:, 0]
        return jnp.sum(weights[0] * line.real + weights[1] * line.imag) + weights[2, 0] * found.peak_to_peak[0]

    return jax.grad(total)(errors)


SWEPT, SPEEDS = ("disc_centre", "ring_flank"), np.linspace(30, 300, 301)


def swept(scale, *errors):
    errors = RVErrors(**{name: scale * value for name, value in zip(SWEPT, errors)})
    return dynamics.speed_sweep(DESIGN, errors, sun_speeds=SPEEDS, load_inertia=3.0)


@jax.jit
def sweep(scale, *errors):
    """Sweeps of a batch of units."""
    return jax.vmap(lambda *x: swept(scale, *x))(*errors)


@jax.jit
def rises(scale, *errors):
    """Their peaks with the derivatives to the scale of the errors."""
    return jax.jvp(lambda scale: jax.vmap(lambda *x: swept(scale, *x).peak)(*errors), (scale,), (1.0,))


UNITS = MICRON * np.random.default_rng(5).normal(size=(2, 75, 2, 2))


def test_peaks_of_a_batch_are_those_of_its_lines(thorough):
    """A batch of several blocks and a part of one, over a number of speeds whose halves are odd; the slope of a peak is
    that of the line at its speed."""
    found = jax.tree.map(np.asarray, sweep(1.0, *UNITS))
    size_of_lines = np.abs(found.amplitude)  # (units, speeds, orders, outputs)
    np.testing.assert_allclose(found.peak, size_of_lines.max(1), rtol=1e-13)
    np.testing.assert_array_equal(found.peak_speed, SPEEDS[size_of_lines.argmax(1)])
    if thorough:  # by default the slope of the largest alone, below
        value, slope = rises(1.0, *UNITS)
        np.testing.assert_allclose(value, found.peak, rtol=1e-13)
        np.testing.assert_allclose(slope, found.peak, rtol=1e-13)  # lines are linear in the errors
    centre, ring = UNITS[:, 7]
    at = respond(none() | {"disc_centre": centre, "ring_flank": np.concatenate([ring, 0 * ring])}, SPEEDS[100])
    rows = [list(at.order).index(order) for order in found.order[7]]  # others are of errors that are zero here
    np.testing.assert_allclose(found.amplitude[7, 100], at.amplitude[rows], rtol=1e-11)
    nothing = sweep(0.0, *UNITS)
    assert (nothing.peak == 0).all() and (nothing.peak_speed == SPEEDS[0]).all()


def test_the_slope_of_a_peak_is_that_of_the_line_at_its_speed():
    """Squares of lines are of second degree in what excites them, and in the transfer."""
    draw = np.random.default_rng(8).normal
    rows, columns = draw(size=(3, 2, 41, 2, 8)), draw(size=(3, 8))
    moved = draw(size=rows.shape), draw(size=columns.shape)
    largest = np.sum(np.einsum("opskc,oc->opsk", rows, columns) ** 2, axis=1).max(1)

    @jax.jit
    def slope(*toward):
        return jax.jvp(error_speeds.largest, (rows, columns), toward)

    np.testing.assert_allclose(error_speeds.largest(rows, columns), largest, rtol=1e-13)
    for toward in ((rows, 0 * columns), (0 * rows, columns)):
        value, along = slope(*toward)
        np.testing.assert_allclose(value, largest, rtol=1e-13)
        np.testing.assert_allclose(along, 2 * largest, rtol=1e-13)
    ends = (error_speeds.largest(rows + h * moved[0], columns + h * moved[1]) for h in (1e-6, -1e-6))
    due = np.subtract(*ends) / 2e-6
    np.testing.assert_allclose(slope(*moved)[1], due, rtol=1e-6, atol=1e-8 * largest.max())


def test_a_batch_leaves_neighbours_alone(thorough):
    lost = UNITS.copy()
    lost[0, 40, 1, 0] = np.nan
    found, sound = (jax.tree.map(np.asarray, sweep(1.0, *units)) for units in (lost, UNITS))
    others = np.arange(75) != 40
    np.testing.assert_array_equal(found.info.status, np.where(others, Status.CONVERGED, Status.NONFINITE))
    assert np.isnan(found.amplitude[40]).all() and np.isnan(found.peak[40]).all()
    np.testing.assert_array_equal(found.amplitude[others], sound.amplitude[others])
    np.testing.assert_array_equal(found.peak[others], sound.peak[others])
    if thorough:
        (value, slope), (_, due) = (jax.tree.map(np.asarray, rises(1.0, *units)) for units in (lost, UNITS))
        assert np.isnan(value[40]).all()
        np.testing.assert_array_equal(slope[others], due[others])


@pytest.mark.parametrize("speeds", [1, 2, 3, 5, 7, 41])
def test_the_place_of_a_peak_is_the_first_of_the_largest_values(speeds):
    """Small whole numbers are often equal; each place is the largest for some unit."""
    squares = np.random.default_rng(6).integers(0, 4, size=(2, speeds, 1, 500)).astype(float)
    np.testing.assert_array_equal(jax.jit(error_speeds._first)(squares), squares.argmax(1))


def test_static_limit_is_the_closed_form():
    """Rolling of the parts on each other; stiffness leaves it but for the share of the two bearings of a crank."""
    g, s, e = DESIGN.involute, DESIGN.stiffness, DESIGN.cycloid.eccentricity
    al, be, arm, rp = g.pressure_angle, DESIGN.cycloid.force_angle, DESIGN.cranks.circle_radius, g.planet_base_radius
    rolling = 39 * e
    share = 2 * s.turning_arm_bearing / (s.support_bearing + 2 * s.turning_arm_bearing)
    radial = -e / rp * np.sin(al)
    expected = np.array([
        -e / rp, radial * (1 - share), -e / rp * np.cos(al) - rolling / arm,
        radial * share, rolling / arm, np.tan(be), 1, 1 / np.cos(be),
    ]) / (e * (39 + np.cos(al) * arm / rp))  # fmt: skip
    stiffer = DESIGN.replace(stiffness=jax.tree.map(lambda k: 3 * k, s))
    heavier = DESIGN.replace(inertia=jax.tree.map(lambda m: 5 * m, DESIGN.inertia))
    for design in (DESIGN, stiffer, heavier):
        found = transferred(design, 0.0, 0.0)
        np.testing.assert_allclose(found[0], expected, rtol=1e-12)
        np.testing.assert_allclose(found[2], expected, rtol=1e-12)


def test_a_bore_pattern_shifted_as_a_whole_is_a_tooth_error_the_other_way():
    """At standstill; and bores all moved alike along the carrier's turn are a constant angle."""
    angles = np.pi + 2 * np.pi * np.arange(3) / 3  # crank 0 at pi, the frame of RVErrors
    shift = MICRON * np.array([2 - 1j, 0.3 + 1.5j])
    bores = shift[:, None] * np.exp(-1j * angles)
    as_bores = none() | {"disc_bore": np.stack([bores.real, bores.imag], -1)}
    as_teeth = none() | {"disc_centre": -np.stack([shift.real, shift.imag], -1)}
    first, second = respond(as_bores, 0.0), respond(as_teeth, 0.0)
    size = np.abs(first.amplitude).max()
    assert size > 1e-6
    np.testing.assert_allclose(first.amplitude, second.amplitude, rtol=0, atol=1e-12 * size)
    alike = none() | {"disc_bore": np.broadcast_to([0.0, MICRON], (2, 3, 2))}
    found = excite(alike)
    assert np.abs(found.amplitude).max() < 1e-6 * MICRON  # sums of exponentials cancel to rounding
    np.testing.assert_allclose(found.mean, MICRON * np.array([0, 0, 0, 0, 1, 0, 0, 0]), rtol=1e-12, atol=1e-20)
    exact = dynamics.error_excitation(DESIGN, RVErrors(disc_bore=MICRON, crank_eccentricity=MICRON, planet_runout=0.0))
    assert (np.asarray(exact.amplitude) == 0).all()  # one number for all members: by integers


def test_pins_count_by_their_share_of_the_load():
    """Every loaded pin on every one of three discs, angle by angle, and the Fourier series of that: odd harmonics too.

    The sum over pins bends where a pin takes up load: 4096 angles know its harmonics to (9 / 4096)^2 of the largest.
    """
    design = DESIGN.replace(cycloid=DESIGN.cycloid.replace(disc_count=3))
    draw = np.random.default_rng(13).normal
    offset, radius = MICRON * draw(size=(40, 2)), MICRON * draw(size=40)
    found = dynamics.error_excitation(design, RVErrors(pin_offset=offset, pin_radii=radius), pin_harmonics=9)
    turn = 2 * np.pi * np.arange(4096) / 4096  # 39 theta
    pin = np.pi + 2 * np.pi * np.arange(40) / 40  # pin 0 opposite to crank 0
    eccentric = 0.4 + 2 * np.pi * np.arange(3)[:, None] / 3 - turn
    chi = pin[:, None, None] - eccentric
    k1 = design.cycloid.derived_shortening
    size = np.sqrt(1 + k1 * k1 - 2 * k1 * np.cos(chi))
    across, away = -np.sin(chi) / size, (k1 * np.cos(chi) - 1) / size
    share = np.where(across > 0, across, 0)
    even = np.linspace(np.pi, 2 * np.pi, 4001)
    mean = np.trapezoid(np.sin(even) ** 2 / (1 + k1 * k1 - 2 * k1 * np.cos(even)), even) / (2 * np.pi)
    share *= np.cos(design.cycloid.force_angle) / (40 * mean)
    moved = away * offset[:, 0, None, None] + k1 * across * offset[:, 1, None, None] + radius[:, None, None]
    wave = np.fft.rfft((share * moved).sum(axis=0).mean(axis=0)) / 4096
    np.testing.assert_array_equal(found.order, [40, 117, 234, 351])
    expected = np.array([0, *2 * wave[[3, 6, 9]]])
    limit = 10 * (9 / 4096) ** 2 * np.abs(wave).max()
    np.testing.assert_allclose(found.amplitude[:, 7], expected, rtol=0, atol=limit)
    np.testing.assert_allclose(found.mean[7], wave[0].real, rtol=0, atol=limit)
    assert np.abs(expected[1:]).min() > 10 * limit


def test_transfer_is_reciprocal():
    """Over its stiffness, a displaced spring turns the output by what a torque on the output deflects the spring."""
    frequency, stiffness = 300.0, DESIGN.stiffness
    oracle = Oracle(DESIGN)
    w = 2 * np.pi * frequency
    torque = np.zeros(oracle.n)
    torque[-1] = 1.0
    q = oracle.solve(oracle.impedance(w, 1), torque)
    c = 1 + 1j * 0.04 + 1j * w * 1e-6
    found = np.asarray(transferred(DESIGN, frequency, 0.0))[0]
    for column, k, rows in ((0, stiffness.sun_planet_mesh, "planetary"), (7, stiffness.disc_pin_mesh, "cycloid")):
        expected = c * k * sum(row @ q for row in oracle.meshes[rows])
        np.testing.assert_allclose(found[column], expected, rtol=1e-9)


def test_reversed_speed_conjugates_the_transfer_alone():
    there, back = transferred(DESIGN, 250.0, 2.0), transferred(DESIGN, -250.0, 2.0)
    np.testing.assert_allclose(back, np.conj(there), rtol=1e-11)
    errors = drawn(1)
    g = np.asarray(excite(errors).amplitude)
    for speed in (SPEED, -SPEED):
        found = respond(errors, speed)
        f = np.asarray(found.order) * speed / DESIGN.ratio / (2 * np.pi)
        rows = [np.asarray(transferred(DESIGN, float(x), 3.0))[0] @ line for x, line in zip(f, g)]
        np.testing.assert_allclose(found.amplitude[:, 0], rows, rtol=1e-10, atol=1e-20)


def test_response_is_linear_and_its_derivative_gives_it_back():
    a, b = drawn(2), drawn(3)
    mixed = jax.tree.map(lambda x, y: 2 * x - 3 * y, a, b)
    first, second, both = (respond(x, SPEED).amplitude for x in (a, b, mixed))
    size = np.abs(both).max()
    np.testing.assert_allclose(both, 2 * first - 3 * second, rtol=0, atol=1e-12 * size)
    weights = np.random.default_rng(4).normal(size=(3, len(first)))
    weights[2] = 0.0
    along = sum(np.sum(slope * a[name]) for name, slope in jax.device_get(slopes(none(), weights)).items())
    due = np.sum(weights[0] * first[:, 0].real + weights[1] * first[:, 0].imag)
    np.testing.assert_allclose(along, due, rtol=0, atol=1e-12 * np.abs(weights).max() * np.abs(first).sum())


def test_peak_to_peak_is_that_of_the_curve():
    """8192 angles of a turn; between neighbours of the door's own a line of order n_max bends by (pi/16)^2 / 2."""
    found = respond(drawn(4), SPEED)
    angle = 2 * np.pi * np.arange(8192) / 8192
    curve = (np.exp(1j * np.outer(angle, found.order)) @ found.amplitude[:, 0]).real
    np.testing.assert_allclose(found.peak_to_peak[0], np.ptp(curve), rtol=(np.pi / 16) ** 2 / 2)
    assert found.peak_to_peak[0] <= 2 * np.abs(found.amplitude).sum()


@pytest.mark.long  # the reference holds the power by default
def test_power_is_the_mean_square_of_units():
    """Each error by itself, one at a time, gives the sum exactly; so do scalars, each member's own."""
    sigma = drawn(5)
    sizes = RVErrors(**jax.tree.map(np.abs, sigma))
    found = dynamics.error_statistics(DESIGN, sizes, sun_speed=SPEED, load_inertia=3.0)
    flat, back = ravel_pytree(sigma)
    alone = jax.lax.map(lambda row: response(DESIGN, back(row), SPEED, 3.0).amplitude, jnp.diag(flat), batch_size=32)
    np.testing.assert_allclose(found.power, np.sum(np.abs(alone) ** 2, axis=0), rtol=1e-10, atol=1e-30)
    np.testing.assert_allclose(found.pseudo_power, np.sum(np.asarray(alone) ** 2, axis=0), rtol=1e-9, atol=1e-22)
    assert (found.power >= np.abs(found.pseudo_power) * (1 - 1e-12)).all() and found.power[0, 0] > 0
    one, many = (
        dynamics.error_statistics(DESIGN, RVErrors(planet_runout=value), sun_speed=SPEED)
        for value in (MICRON, np.full((3, 2), MICRON))
    )
    np.testing.assert_allclose(one.power, many.power, rtol=1e-12)


def test_what_the_mean_cancels_is_exactly_zero_with_finite_gradients():
    harmless = {name: drawn(6)[name] for name in ("sun_runout", "ring_centre", "crank_phase", "carrier_bore")}
    found = respond(none() | harmless, SPEED)
    assert (np.asarray(found.amplitude) == 0).all() and found.peak_to_peak[0] == 0

    weights = np.ones((3, len(found.order)))
    at_none = slopes(none(), weights)
    assert all(np.isfinite(slope).all() for slope in at_none.values())
    assert (np.asarray(at_none["sun_runout"]) == 0).all() and (np.asarray(at_none["ring_centre"]) == 0).all()
    assert np.abs(slopes(drawn(7), weights)["disc_bore"]).min() > 0


def test_hostile_designs_have_a_status():
    """Put together as a batch is, without the checks of a constructor."""
    leaves, tree = jax.tree.flatten(DESIGN)
    errors = none() | {"disc_centre": np.full((2, 2), MICRON)}
    names = dict(
        torsion=lambda d: d.stiffness.sun_torsion,
        angle=lambda d: d.cycloid.force_angle,
        e=lambda d: d.cycloid.eccentricity,
    )
    places = {name: read(tree.unflatten(range(len(leaves)))) for name, read in names.items()}

    def ask(speed=SPEED, load=0.0, **changes):
        own = list(leaves)
        for name, value in changes.items():
            own[places[name]] = value
        found = respond(errors, speed, tree.unflatten(own), load)
        return found.info.status, found.amplitude, found.static

    assert ask()[0] == Status.CONVERGED
    assert ask(torsion=0.0)[0] == Status.CONVERGED and not np.isnan(ask(torsion=0.0)[2]).any()
    assert ask(speed=0.0, torsion=0.0)[0] == Status.SINGULAR
    assert ask(speed=np.inf)[0] == Status.NONFINITE
    for impossible in (dict(angle=np.pi / 2), dict(e=-1e-3), dict(e=0.1), dict(load=-1.0)):
        state, amplitude, _ = ask(**impossible)
        assert state == Status.INVALID_GEOMETRY and np.isnan(amplitude).all(), impossible
    free = DESIGN.replace(stiffness=DESIGN.stiffness.replace(sun_torsion=0.0))
    assert np.isnan(transferred(free, 0.0, 0.0)).all() and not np.isnan(transferred(free, 1.0, 0.0)).any()


def test_what_cannot_be_asked_is_refused_by_name():
    errors, spin = RVErrors(), dict(sun_speed=SPEED)
    one = DESIGN.replace(cycloid=DESIGN.cycloid.replace(disc_count=1))
    unequal = DESIGN.replace(inertia=DESIGN.inertia.replace(planet_mass=np.array([1.0, 1.0, 1.1])))
    refused = {
        "disc_count": lambda: dynamics.transmission_error(one, errors, **spin),
        "one number in each field": lambda: dynamics.error_transfer(unequal, frequency=1.0),
        "output.x": lambda: dynamics.transmission_error(DESIGN, errors, outputs=("output.x",), **spin),
        "method": lambda: dynamics.transmission_error(DESIGN, errors, method="exact", **spin),
        "stage": lambda: dynamics.transmission_error(DESIGN, errors, stage="third", **spin),
        "harmonics": lambda: dynamics.transmission_error(DESIGN, errors, harmonics=0, **spin),
        "pin_harmonics": lambda: dynamics.error_excitation(DESIGN, errors, pin_harmonics=-1),
        "disc_bore": lambda: dynamics.error_excitation(DESIGN, RVErrors(disc_bore=np.zeros((3, 3, 2)))),
        "planet_flank": lambda: dynamics.error_excitation(DESIGN, RVErrors(planet_flank=np.zeros((2, 1, 2)))),
        "sun_flank": lambda: dynamics.error_excitation(DESIGN, RVErrors(sun_flank=MICRON)),
        "sun_speeds": lambda: dynamics.speed_sweep(DESIGN, errors, sun_speeds=SPEED),
        "standard deviation": lambda: dynamics.error_statistics(DESIGN, RVErrors(pin_radii=-MICRON), **spin),
        "of order": lambda: dynamics.transmission_error(
            DESIGN, RVErrors(planet_flank=np.zeros((3, 180, 2))), method="harmonic_balance", harmonics=1, **spin
        ),
    }
    for words, call in refused.items():
        with pytest.raises(ValueError, match=words):
            call()


@pytest.mark.long  # both methods are held against the reference above
def test_balance_without_swing_is_the_first_order():
    """Errors and load no longer multiply: the error lines stand, the mesh lines vanish; half a period's residue too."""
    still = DESIGN.replace(mesh_variation=MeshVariation(0.0, 0.5, 0.0, 0.0, 0.5, 0.0))
    still = still.replace(involute=still.involute.replace(sun_teeth=16, planet_teeth=4))
    errors = {name: value for name, value in drawn(10).items() if not name.startswith("pin")}
    asked = dict(sun_speed=SPEED, outputs=OUTPUTS)
    linear = dynamics.transmission_error(still, RVErrors(**errors), **asked)
    full = dynamics.transmission_error(
        still, RVErrors(**errors), method="harmonic_balance", harmonics=3, output_torque=-3136.0, **asked
    )
    lines = dict(zip(np.asarray(full.order).tolist(), np.asarray(full.amplitude)))
    own = np.array([lines.pop(n) for n in np.asarray(linear.order).tolist()])
    size = np.abs(linear.amplitude).max(axis=0)
    assert (np.abs(own - linear.amplitude) <= 1e-9 * size).all()
    assert (np.abs(list(lines.values())).max(axis=0) <= 1e-9 * size).all()
