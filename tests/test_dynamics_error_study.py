"""Errors as excitation over a range of speeds, and in studies: outputs, conditions, series as tolerances.

Oracles: fine sweeps at given speeds (`speed_sweep`, held to independent cases elsewhere), NumPy sums over their lines,
second moments in closed form (`error_statistics`), extrapolated differences.
"""

import re
from dataclasses import replace
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Damping, RVErrors, Status, dynamics, models, study
from rvjax.catalogue import RV_40E, RV_320E
from rvjax.study.response import Response
from rvjax.tolerances import sample
from rvjax.units import rpm

MICRON = 1e-6
TEXT = (resources.files("rvjax.study") / "embedded" / "rv-40e-joint.toml").read_text("utf-8")
JOINT = study.load("rv-40e-joint", solve=False)
SHAPES = {name: getattr(JOINT.tolerances, name).shape for name in JOINT.fields}
RANGE = ("slowest_sun_speed", "fastest_sun_speed")
RANGES = [(20.0, 700.0), (-600.0, -40.0), pytest.param((-620.0, 650.0), marks=pytest.mark.long)]


def numbers(tree):
    """Every number as an array, so that designs and units share programs."""
    return jax.tree.map(lambda x: np.asarray(x, float), tree)


def stiffened(design):
    """A design as outputs of a study have it, whose stiffness a unit makes its own: their programs serve all tests."""
    return numbers(RVErrors()).stiffened(numbers(design))


DESIGN = stiffened(JOINT.design)
ETA = float(DESIGN.damping.loss_factor)
GIVEN = dict(load_inertia=100.0, speeds=12)
ENDS = dict(slowest_sun_speed=20.0, fastest_sun_speed=500.0)


def drawn(seed):
    draw = np.random.default_rng(seed).normal
    return {name: 3 * MICRON * draw(size=shape) for name, shape in SHAPES.items()}


def unit(errors):
    return numbers(RVErrors(**errors))


@pytest.mark.parametrize("ends", RANGES)
def test_the_worst_of_a_range_is_that_of_a_fine_sweep(ends):
    """2001 speeds lie within a twelfth of a width (2 %) of a peak: 1.4 % of its height; ours to 1 % of these cases."""
    errors = unit(drawn(1))
    found = dynamics.speed_range(DESIGN, errors, **dict(zip(RANGE, ends)), **GIVEN)
    assert found.info.status == Status.CONVERGED
    speeds = np.asarray(found.sun_speeds)
    assert (np.diff(speeds) >= 0).all() and speeds[0] == ends[0] and speeds[-1] == ends[1]
    fine = np.geomspace(*ends, 2001) if ends[0] * ends[1] > 0 else np.linspace(*ends, 2001)
    sweep = dynamics.speed_sweep(DESIGN, errors, sun_speeds=fine, load_inertia=100.0)
    size, order = np.abs(np.asarray(sweep.amplitude)[:, :, 0]), np.asarray(sweep.order)
    shaken = np.sqrt(np.sum((size * (order * fine[:, None] / DESIGN.ratio) ** 2) ** 2, axis=1) / 2)
    assert 0.99 * shaken.max() < found.acceleration < 1.01 * shaken.max()
    np.testing.assert_allclose(np.abs(found.acceleration_speed), np.abs(fine[shaken.argmax()]), rtol=ETA / 2)
    if ends[0] * ends[1] < 0:  # both senses of rotation have their resonances
        assert np.isclose(speeds, -found.acceleration_speed, rtol=1e-12).any()
    angle = 2 * np.pi * np.arange(4096) / 4096  # orders are whole numbers here
    waves = np.exp(1j * angle[:, None] * order)
    likely = np.argsort(-size.sum(axis=1))[:40]
    curves = (waves @ np.asarray(sweep.amplitude)[likely, :, 0].T).real
    largest = np.ptp(curves, axis=0).max()
    assert 0.99 * largest < found.peak_to_peak < 1.01 * largest


def figures(share, loss, errors):
    """Both figures of a range, its pins stiffer by a share."""
    stiffness = DESIGN.stiffness.replace(disc_pin_mesh=DESIGN.stiffness.disc_pin_mesh * (1 + share))
    design = DESIGN.replace(stiffness=stiffness, damping=DESIGN.damping.replace(loss_factor=loss))
    found = dynamics.speed_range(design, RVErrors(**errors), **ENDS, **GIVEN)
    return jnp.stack([found.acceleration, found.peak_to_peak])


def plain_figures(share, loss, errors):
    """The same by the program of all other tests."""
    stiffness = DESIGN.stiffness.replace(disc_pin_mesh=DESIGN.stiffness.disc_pin_mesh * (1 + share))
    design = stiffened(DESIGN.replace(stiffness=stiffness, damping=DESIGN.damping.replace(loss_factor=loss)))
    found = dynamics.speed_range(design, unit(errors), **ENDS, **GIVEN)
    return np.array([found.acceleration, found.peak_to_peak])


slopes = jax.jit(jax.jacrev(figures, argnums=(0, 1, 2)))


@pytest.mark.long  # the slope of a peak, test_dynamics_error.py, and second derivatives of the modes run by default
def test_the_worst_of_a_range_has_derivatives():
    """The speeds move with the modes, and their derivatives with them: those of errors, stiffness and damping.

    Steps are small: the largest of the sampled curve changes its place, and bends, every 1e-5 or so.
    """
    h = 1e-6
    errors, toward = drawn(1), drawn(2)
    found = slopes(0.0, ETA, errors)
    along = sum(np.tensordot(found[2][name], toward[name], toward[name].ndim) for name in toward)
    for place, slope in enumerate((found[0], found[1], along)):

        def off(step, place=place):
            moved = {name: value + (place == 2) * step * h * toward[name] for name, value in errors.items()}
            return plain_figures((place == 0) * step * h, ETA + (place == 1) * step * h, moved)

        central = [(off(n) - off(-n)) / (2 * n * h) for n in (1, 2)]
        due = (4 * central[0] - central[1]) / 3
        np.testing.assert_allclose(slope, due, rtol=1e-6, atol=1e-9 * np.abs(due).max())


def test_no_error_shakes_nothing_and_an_undamped_mode_is_singular(thorough):
    none = {name: np.zeros(shape) for name, shape in SHAPES.items()}
    assert (plain_figures(0.0, ETA, none) == 0).all()
    if thorough:  # the program of the derivatives; those of one speed are finite in test_dynamics_error.py
        assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes(0.0, ETA, none)))

    bare, errors = stiffened(DESIGN.replace(damping=Damping())), unit(drawn(1))
    found = dynamics.speed_range(bare, errors, **ENDS, **GIVEN)
    assert found.info.status == Status.SINGULAR
    apart = dynamics.speed_range(bare, errors, slowest_sun_speed=0.1, fastest_sun_speed=1.0, **GIVEN)
    assert apart.info.status == Status.CONVERGED
    # One speed, right on the mode: SINGULAR, and no longer so next to it.
    heavy = bare.replace(inertia=bare.inertia.replace(output_inertia=bare.inertia.output_inertia + 100.0))
    found = dynamics.modes(heavy)
    rotational = np.asarray(found.frequency)[[kind == "rotational" for kind in found.kind]]
    on = float(2 * np.pi * rotational[rotational > 1][0] / 40 * bare.ratio)
    for speed, status in ((on, Status.SINGULAR), (1.001 * on, Status.CONVERGED)):
        found = dynamics.transmission_error(bare, errors, sun_speed=speed, load_inertia=100.0)
        assert found.info.status == status
    with pytest.raises(ValueError, match="speeds = 1"):
        dynamics.speed_range(DESIGN, errors, speeds=1, **ENDS)


def one_speed(errors, speed):
    """Order, frequency, line and peak to peak of a joint at one speed."""
    found = dynamics.transmission_error(errors.stiffened(DESIGN), errors, sun_speed=speed, load_inertia=100.0)
    return found.order, found.frequency, found.amplitude[:, 0], found.peak_to_peak[0]


def test_a_joint_is_asked_for_standstill_and_its_worst_speed():
    """Outputs of one unit against lines at speeds, and where the speeds lie: 5 and 60 r/min of the output."""
    design, conditions = DESIGN, JOINT.conditions
    assert conditions.slowest_sun_speed == pytest.approx(5 * design.ratio * rpm)
    assert conditions.fastest_sun_speed == pytest.approx(60 * design.ratio * rpm)
    errors = numbers(jax.jit(lambda i: sample(JOINT.tolerances, i, seed=0))(3))
    names = ("static_transmission_error", "dynamic_transmission_error", "dynamic_vibration")
    over_range = Response.of(design, names, conditions)(errors)
    assert over_range.status == Status.CONVERGED
    speed = 300.0
    order, frequency, lines, whole = (np.asarray(x) for x in one_speed(errors, speed))
    at_speed = Response.of(design, names, replace(conditions, sun_speed=speed, **dict.fromkeys(RANGE)))(errors)
    np.testing.assert_allclose(frequency, order * speed / design.ratio / (2 * np.pi), rtol=1e-12)
    rms = np.sqrt(np.sum(np.abs(lines * (2 * np.pi * frequency) ** 2) ** 2) / 2)
    np.testing.assert_allclose(at_speed.value["dynamic_vibration"], rms, rtol=1e-12)
    np.testing.assert_allclose(at_speed.value["dynamic_transmission_error"], whole, rtol=1e-12)
    np.testing.assert_allclose(over_range.value["static_transmission_error"], one_speed(errors, 0.0)[3], rtol=1e-12)
    for name in names[1:]:
        assert over_range.value[name] > at_speed.value[name] > 0
    worst = dynamics.speed_range(
        errors.stiffened(design),
        errors,
        **{name: getattr(conditions, name) for name in RANGE},
        **GIVEN,
    )
    np.testing.assert_allclose(over_range.value["dynamic_vibration"], worst.acceleration, rtol=1e-12)
    np.testing.assert_allclose(over_range.value["dynamic_transmission_error"], worst.peak_to_peak, rtol=1e-12)


@pytest.mark.long  # the reference holds the second moments, the outputs above the lines
def test_random_joints_scatter_as_their_second_moments_say():
    """Mean square of the acceleration at one speed, and how many are far out at one order: 4 standard errors.

    Order 208 has one error, a vector of any phase: |B|^2 is exponential.
    """
    speed, units = 150.0, 4096
    drawn_units = jax.jit(jax.vmap(lambda i: sample(JOINT.tolerances, i, seed=5)))(np.arange(units))
    order, frequency, lines, _ = map(np.asarray, jax.jit(jax.vmap(one_speed, (0, None)))(drawn_units, speed))
    square = np.sum(np.abs(lines * (2 * np.pi * frequency) ** 2) ** 2, axis=1) / 2
    sigma = {}
    for name in JOINT.fields:
        tolerance = getattr(JOINT.tolerances, name)
        sigma[name] = np.full(tolerance.shape, tolerance.half_width / 3)
    found = dynamics.error_statistics(JOINT.design, RVErrors(**sigma), sun_speed=speed, load_inertia=100.0)
    np.testing.assert_array_equal(found.order, order[0])
    due = np.sum(np.asarray(found.power)[:, 0] * (2 * np.pi * frequency[0]) ** 4) / 2
    assert abs(square.mean() - due) < 4 * square.std() / np.sqrt(units)
    sun = list(order[0]).index(208)
    assert abs(found.pseudo_power[sun, 0]) < 1e-9 * found.power[sun, 0]
    beyond = np.mean(np.abs(lines[:, sun]) ** 2 > np.log(20) * float(found.power[sun, 0]))
    assert abs(beyond - 0.05) < 4 * np.sqrt(0.05 * 0.95 / units)


@pytest.mark.long  # the modes with a load, test_dynamics.py, and the outputs of a joint above run by default
def test_the_load_decides_where_the_meshes_meet_a_mode_too():
    """`vibration` and `resonance_margin` with a load inertia are those of a heavier output."""
    design = numbers(RV_320E.replace(damping=Damping(modal_ratio=0.02)))
    heavy = design.replace(inertia=design.inertia.replace(output_inertia=design.inertia.output_inertia + 60.0))
    given = dict(sun_speed=100.0, slowest_sun_speed=100.0, fastest_sun_speed=120.0, output_torque=1000.0)
    kind = models.kind(design)

    @jax.jit
    def evaluate(design, load):
        conditions = kind.conditions(**given, load_inertia=load)
        names = ("vibration", "resonance_margin")
        return jnp.stack([kind.outputs[name].evaluate(design, RVErrors(), conditions)[0] for name in names])

    there, due, without = (evaluate(*case) for case in ((design, 60.0), (heavy, 0.0), (design, 0.0)))
    np.testing.assert_allclose(there, due, rtol=1e-9)
    assert (np.abs(without / due - 1) > 1e-3).all()


def test_series_are_tolerances_of_a_study():
    shapes = {"disc_flank": (2, 2, 2), "sun_flank": (2, 2), "ring_flank": (2, 2), "disc_centre": (2, 2)}
    for name, shape in shapes.items():
        tolerance = getattr(JOINT.tolerances, name)
        assert tolerance.shape == shape, name
    assert JOINT.tolerances.disc_flank.half_width == pytest.approx(3 * MICRON)
    random_phase = TEXT.replace(
        '[tolerances.ring_flank] # an oval ring: what two discs meet together, 78 times in a turn\nhalf_width = "5 um"',
        '[tolerances.ring_flank]\nlower = "0 um"\nupper = "5 um"\ndistribution = "rayleigh"',
    )
    assert random_phase != TEXT
    ring = study.parse_study(random_phase, name="joint", solve=False).tolerances.ring_flank
    assert ring.shape == (2, 2) and ring.is_vector


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('half_width = "3 um"\nharmonics = 2', 'half_width = "3 um"', "tolerances.disc_flank.harmonics is missing"),
        ("harmonics = 2", "harmonics = 0", "tolerances.disc_flank.harmonics = 0: must be an integer of at least 1"),
        ("harmonics = 2", 'harmonics = "2"', "tolerances.disc_flank.harmonics = '2': must be an integer"),
        (
            'half_width = "10 um"',
            'half_width = "10 um"\nharmonics = 2',
            "unknown key tolerances.planet_runout.harmonics",
        ),
        ('load_inertia = "100 kg m2"', "", "conditions.load_inertia is missing: dynamic_vibration needs it"),
        ('"100 kg m2"', '"-1 kg m2"', "conditions.load_inertia = '-1 kg m2': must be at least 0 kg m2"),
        ('slowest_sun_speed = "525 rpm"', "", "conditions.slowest_sun_speed is missing"),
        ("speeds = 12", "speeds = 1", "conditions.speeds = 1: must be an integer of at least 2"),
        ('base = "rv-40e"', 'base = "rv-40e"\ncycloid.disc_count = 1', "disc_count = 1"),
        ('planet_mass = "0.18 kg"', 'planet_mass = ["0.18 kg", "0.2 kg"]', "one number in each field"),
    ],
)
def test_a_study_of_a_joint_says_what_is_wrong(old, new, words):
    assert old in TEXT
    with pytest.raises(study.StudyError, match=re.escape(words)):
        study.parse_study(TEXT.replace(old, new, 1), name="joint")


def test_a_joint_that_nothing_holds_at_standstill_is_told():
    """Its static transmission error alone is required: a program of half the size."""
    free = re.sub(r"\[requirement\.dynamic_vibration\][^\[]*", "", TEXT)
    free = free.replace('sun_torsion = "2000 N m/rad"', 'sun_torsion = "0 N m/rad"')
    with pytest.raises(study.StudyError, match="the unit without errors cannot be solved: SINGULAR"):
        study.parse_study(free, name="joint")


def test_a_reducer_without_masses_cannot_be_asked():
    kind = models.kind(RV_40E)
    with pytest.raises(ValueError, match=r"RVReducer\.inertia"):
        kind.outputs["dynamic_vibration"].evaluate(RV_40E, RVErrors(), kind.conditions(sun_speed=1.0, load_inertia=0.0))
