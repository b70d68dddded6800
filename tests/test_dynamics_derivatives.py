"""Sensitivities of the dynamic model.

Oracles: the closed-form total derivative Z dB = dA - dZ B, with A and Z differentiated by complex steps of the
NumPy model (dynamics_oracle.py), to 1e-7; central finite differences to 1e-7; forward against reverse mode;
independent log-sensitivities (tests/reference/dynamics.json); the zero-sensitivity theorems of Section 4 of the
source, to rounding.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Damping, dynamics
from rvjax.catalogue import RV_320E
from rvjax.dynamics.assembly import lump
from rvjax.dynamics.error_speeds import _modes
from rvjax.dynamics.modes import DynamicStiffness, ModalSector, matrix_root, on_resonance
from rvjax.dynamics.symmetry import KINDS
from rvjax.units import rpm
from tests.oracles.dynamics import Oracle, layout

TORQUE, RATED = -3136.0, 1000 * rpm
DAMPED = RV_320E.replace(damping=Damping(0.02, 30.0, 2e-7, 0.01))
FIELDS = {  # a field of the design and its step for finite differences, relative
    "cycloid.eccentricity": 1e-3,
    "cycloid.force_angle": 1e-3,
    "involute.pressure_angle": 1e-3,
    "involute.planet_base_radius": 1e-3,
    "cranks.circle_radius": 1e-3,
    "stiffness.sun_support": 3e-3,
    "stiffness.turning_arm_bearing": 3e-3,
    "stiffness.disc_pin_mesh": 3e-3,
    "inertia.planet_mass": 3e-3,
    "inertia.disc_inertia": 3e-3,
    "mesh_variation.planetary_swing": 1e-2,
    "damping.loss_factor": 1e-2,
    "damping.modal_ratio": 1e-2,
}


def changed(design, name, value):
    part, field = name.split(".")
    return design.replace(**{part: getattr(design, part).replace(**{field: value})})


def get(design, name):
    part, field = name.split(".")
    return getattr(getattr(design, part), field)


def sixth_order(function, x, h):
    """Central difference of sixth order."""
    pairs = [(function(x + k * h) - function(x - k * h)) / (2 * k * h) for k in (1, 2, 3)]
    return 1.5 * pairs[0] - 0.6 * pairs[1] + 0.1 * pairs[2]


def amplitudes_of(method, design=DAMPED, stage="planetary", harmonics=3, outputs=("output.x", "output.rotation")):
    """Real and imaginary parts as a function of the numbers FIELDS, and those of the design."""

    def amplitudes(values):
        full = design
        for name, value in zip(FIELDS, values):
            full = changed(full, name, value)
        conditions = dict(sun_speed=RATED, output_torque=TORQUE, stage=stage)
        found = dynamics.response(full, **conditions, harmonics=harmonics, method=method, outputs=outputs)
        return jnp.stack([found.amplitude.real, found.amplitude.imag])

    return amplitudes, np.array([get(design, name) for name in FIELDS])


LAYOUTS = {"cyclic": layout(DAMPED, 3, 3), "mesh": layout(DAMPED, 3, 2, disc_phase=0.3)}


def test_the_root_of_a_matrix_turns_as_differences_say():
    """Modal damping is a root of the stiffness; two of its squares are equal. Both modes of differentiation."""
    square, draw = np.array([4.0, 9.0, 9.0, 0.25]), np.random.default_rng(8).normal
    along, weights = ((x := draw(size=(4, 4)) + 1j * draw(size=(4, 4))) + x.conj().T for _ in range(2))

    def plain(step):
        values, vectors = np.linalg.eigh(np.diag(square) + step * along)
        return vectors * np.sqrt(values) @ vectors.conj().T

    @jax.jit
    def both(matrix):
        _, forward = jax.jvp(lambda m: matrix_root(m, square), (matrix,), (along,))
        _, pull = jax.vjp(lambda m: matrix_root(m, square), matrix)
        return forward, pull(weights)[0]

    forward, reverse = map(np.asarray, both(np.diag(square).astype(complex)))
    np.testing.assert_allclose(forward, sixth_order(plain, 0.0, 1e-3), atol=1e-9)
    np.testing.assert_allclose(np.sum(reverse * along), np.sum(weights * forward), rtol=1e-12)


@pytest.mark.long  # its only rule, the root of a matrix, runs by default
@pytest.mark.parametrize("form", ["cyclic", "mesh"])
def test_derivatives_of_harmonic_balance_equal_finite_differences(form, thorough):
    """Reverse mode, which is forward mode transposed; in the long profile forward mode itself too."""
    function, point = amplitudes_of("harmonic_balance", LAYOUTS[form])
    run = jax.jit(function)
    reverse = np.asarray(jax.jit(jax.jacrev(function))(point))
    steps = np.array(list(FIELDS.values())) * point
    grid = [point + k * h * one for one, h in zip(np.eye(len(point)), steps) for k in (-3, -2, -1, 0, 1, 2, 3)]
    rows = np.stack([run(place) for place in grid]).reshape(len(point), 7, *reverse.shape[:-1])
    size = np.abs(rows[0, 3]).max(axis=(0, 1), keepdims=True)[..., None]
    scale = size / np.abs(point)  # of the output, per relative change of the field
    pairs = [(rows[:, 3 + k] - rows[:, 3 - k]) / (2 * k * steps[:, None, None, None]) for k in (1, 2, 3)]
    slope = np.moveaxis(1.5 * pairs[0] - 0.6 * pairs[1] + 0.1 * pairs[2], 0, -1)
    np.testing.assert_allclose(reverse / scale, slope / scale, atol=1e-7)
    if thorough:
        forward = jax.jit(jax.jacfwd(function))(point)
        np.testing.assert_allclose(forward / scale, reverse / scale, atol=1e-10)
    if form == "mesh":
        return
    # Full coupling mixes the motions: the support of the sun reaches the rotation of the output (l = 3 of 3 planets).
    support = list(FIELDS).index("stiffness.sun_support")
    assert np.abs((reverse / scale)[:, 2, 1, support]).max() > 1e-4


@pytest.mark.long  # those of the modes, below, run by default
def test_second_derivatives():
    """Forward over reverse against second differences, of sixth order, of the plain squared amplitude.

    Steps of 1.5e-3 leave 2e-8 of the fourth harmonic, a sixty-fourth of what 3e-3 leave; values are good to 1e-13,
    over 2e-6.
    """
    function, point = amplitudes_of("first_order", harmonics=4, outputs=("output.rotation",))
    direction = point * np.linspace(0.5, 1.5, len(point))

    def power(share):
        return jnp.sum(function(point + share * direction) ** 2) * 1e16  # the fourth harmonic alone turns the output

    h, weights, value = 1.5e-3, np.array([2, -27, 270, -490, 270, -27, 2]) / 180, jax.jit(power)
    due = weights @ [float(value(share)) for share in h * np.arange(-3.0, 4.0)] / h**2
    second = jax.jit(lambda share: jax.jvp(jax.grad(power), (share,), (1.0,))[1])
    assert float(second(0.0)) == pytest.approx(due, rel=1e-6)


OUTPUTS = ("output.x", "output.y", "output.rotation", "planet1.y")


@cache
def logs(stage="planetary", harmonics=1, outputs=("output.x",)):
    """Log-sensitivities of the lumped parameters, in which the eccentricity leaves the force arm alone."""
    found = dynamics.log_sensitivities(
        dynamics.lump(RV_320E),
        **dict(sun_speed=RATED, output_torque=TORQUE, stage=stage, outputs=outputs, harmonics=harmonics),
    )
    return jax.tree.map(np.asarray, found)


def test_closed_form_total_derivative():
    """Z dB = dA - dZ B with dA = -d(dK_l) qbar - dK_l Kbar^-1 (dF - dKbar qbar), matrices differentiated apart."""
    found = logs()
    names = [name for name in FIELDS if name.split(".")[0] in ("cycloid", "involute", "cranks", "stiffness", "inertia")]
    w, order = Oracle(RV_320E).frequency("planetary", RATED), 1

    def pieces(design):
        oracle = Oracle(design, force_arm=dynamics.lump(RV_320E).force_arm)
        rows, k, phase, a = oracle.stage("planetary", 1)
        change = k * a[0] * (rows.T * np.exp(1j * order * phase)) @ rows  # dK_l
        return np.column_stack([oracle.K, np.diag(oracle.m), change, oracle.load(TORQUE)])

    def apart(columns):
        return *np.split(columns[:, :-1], 3, axis=1), columns[:, -1]

    K, M, dK, F = apart(pieces(RV_320E))
    mean = np.linalg.solve(K, F)
    Z = K - (order * w) ** 2 * M
    B = np.linalg.solve(Z, -dK @ mean)
    labels = dynamics.assemble(RV_320E).labels
    for name in names:
        x = get(RV_320E, name)
        by_K, by_M, by_dK, by_F = apart(sixth_order(lambda v, n=name: pieces(changed(RV_320E, n, v)), x, 1e-3 * x))
        dA = -by_dK @ mean - dK @ np.linalg.solve(K, by_F - by_K @ mean)
        expected = x * np.linalg.solve(Z, dA - (by_K - (order * w) ** 2 * by_M) @ B)[labels.index("output.x")]
        amplitude = B[labels.index("output.x")]
        lumped = name if name.split(".")[0] in ("stiffness", "inertia") else name.split(".")[1]
        assert complex(found[lumped][0, 0]) == pytest.approx(expected / amplitude, rel=1e-7, abs=1e-9)


NAMES = {
    "e": "eccentricity",
    "rc": "force_arm",
    "rs": "sun_base_radius",
    "rp": "planet_base_radius",
    "rH": "circle_radius",
    "alpha": "pressure_angle",
    "beta": "force_angle",
}


def test_log_sensitivities_are_those_of_the_reference(reference):
    data = reference("dynamics")
    case = next(case for case in data["cases"] if case["id"] == 38)["out"]
    apart = logs()
    for symbol, value in case.items():
        name = NAMES.get(symbol) or data["symbols"].get(symbol, "").split(" ")[0]
        found = apart["eccentricity"] + apart["force_arm"] if symbol == "rc=eZc" else apart[name]
        assert complex(found[0, 0]) == pytest.approx(complex(*value), rel=1e-7, abs=1e-9), symbol
    assert np.abs(apart["disc_phase"][0]).max() < 1e-11


@pytest.mark.long
def test_log_sensitivities_of_a_whole_reducer():
    """Its eccentricity takes the force arm along; what the model does not read counts for nothing.

    Discs given one by one, and so solved without their symmetry, share the sensitivity of all.
    """
    one_by_one = changed(RV_320E, "stiffness.disc_pin_mesh", np.full(3, RV_320E.stiffness.disc_pin_mesh))
    together = dynamics.log_sensitivities(
        one_by_one, sun_speed=RATED, output_torque=TORQUE, harmonics=1, outputs=("output.x",)
    )
    apart, discs = logs(), together["stiffness.disc_pin_mesh"]
    assert discs.shape == (1, 1, 3)
    np.testing.assert_allclose(discs.sum(axis=2), apart["stiffness.disc_pin_mesh"][:1, :1], rtol=1e-9)
    expected = (apart["eccentricity"] + apart["force_arm"])[0, 0]
    np.testing.assert_allclose(together["cycloid.eccentricity"][0, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(together["involute.pressure_angle"][0, 0], apart["pressure_angle"][0, 0], rtol=1e-9)
    for name in ("involute.centre_distance", "cycloid.pin_radius", "cycloid.pin_circle_radius"):
        assert np.all(together[name] == 0)


@pytest.mark.long  # a formula of the source, kept to reproduce it
@pytest.mark.parametrize(
    ("stage", "printed", "total"),
    [
        ("planetary", {(1, "output.x"): 0.7548}, {(1, "output.x"): 1.7243}),
        (
            "cycloid",
            {(1, "output.x"): 0.2636, (3, "output.rotation"): -2.5294},
            {(1, "output.x"): -1.0298, (3, "output.rotation"): -2.2693},
        ),
    ],
)
def test_eq_14_leaves_out_the_forcing(stage, printed, total):
    """Right for inertia and stiffness, wrong for geometry; the eccentricity alone (planetary) and with rc (cycloid)."""
    count, outputs = (3, OUTPUTS) if stage == "cycloid" else (1, ("output.x",))
    whole = logs(stage, count, outputs)
    lumped = jax.tree.map(np.asarray, dynamics.lump(RV_320E))
    names = ("eccentricity", "force_arm", "stiffness.sun_support", "inertia.disc_inertia")

    def amplitude(shares):
        design = lumped
        for name, share in zip(names, shares):
            if "." in name:
                design = changed(design, name, get(lumped, name) * (1 + share))
            else:
                design = design.replace(**{name: getattr(lumped, name) * (1 + share)})
        conditions = dict(sun_speed=RATED, output_torque=TORQUE, stage=stage, harmonics=count, outputs=outputs)
        found = dynamics.constant_forcing(design, **conditions).amplitude
        return found, found

    slopes, value = jax.jit(jax.jacfwd(amplitude, has_aux=True))(np.zeros(4))
    without = dict(zip(names, np.moveaxis(np.asarray(slopes), -1, 0) / np.where(value == 0, 1, value)))
    for found, expected in ((without, printed), (whole, total)):
        slope = found["eccentricity"] + (found["force_arm"] if stage == "cycloid" else 0)
        for (harmonic, output), number in expected.items():
            assert slope[harmonic - 1, outputs.index(output)].real == pytest.approx(number, abs=6e-5)
    for name in names[2:]:
        np.testing.assert_allclose(without[name], whole[name], rtol=1e-9, atol=1e-10, err_msg=name)


CENTRAL_ROTATION = [f"stiffness.{part}_torsion" for part in ("sun", "output")]
CENTRAL_ROTATION += [f"inertia.{part}_inertia" for part in ("sun", "output")]


def test_translations_ignore_central_torsion_and_inertia():
    found = logs()
    assert all(abs(found[name][0, 0]) < 1e-12 for name in CENTRAL_ROTATION)
    assert min(abs(found[name][0, 0]) for name in ("stiffness.sun_support", "inertia.output_mass")) > 1e-2


@pytest.mark.long  # kinds of modes, test_dynamics.py, have the same zeros
def test_zero_sensitivities():
    """Section 4: rotational responses ignore central supports and masses, translational ones central torsion and
    inertia, planetary ones all central values; harmonic balance mixes them."""
    translation = [f"stiffness.{part}_support" for part in ("sun", "output")]
    translation += [f"inertia.{part}_mass" for part in ("sun", "output")]
    found = logs(harmonics=4, outputs=OUTPUTS)
    x, turn, planet = (OUTPUTS.index(n) for n in ("output.x", "output.rotation", "planet1.y"))
    for name in translation:
        assert np.all(found[name][3, turn] == 0) and abs(found[name][1, planet]) < 1e-12
    for name in CENTRAL_ROTATION:
        assert abs(found[name][0, x]) < 1e-12 and abs(found[name][1, planet]) < 1e-12
    assert min(abs(found[name][3, turn]) for name in ("stiffness.sun_torsion", "inertia.sun_inertia")) > 0.1
    assert all(value[1, x] == 0 for value in found.values())  # a suppressed output


@pytest.mark.parametrize("method", ["first_order", pytest.param("harmonic_balance", marks=pytest.mark.long)])
def test_no_nan_at_pairs_of_modes_or_empty_excitation_nor_next_to_a_failed_lane(method):
    """Zero torque, zero swing, zero rigid mode, no damping: all derivatives are numbers, and lanes stay apart.

    The support of the sun is shared, so that a lane without a number could spoil its derivative.
    """

    def total(shared, lanes):
        def lane(torque, swing, torsion, support):
            design = changed(RV_320E, "mesh_variation.planetary_swing", swing)
            design = changed(design, "stiffness.sun_torsion", torsion)
            design = changed(design, "stiffness.sun_support", shared + support)
            full = dynamics.response(design, sun_speed=RATED, output_torque=torque, method=method, harmonics=2)
            parts = [full.amplitude.real, full.amplitude.imag, full.mean, jnp.minimum(full.resonance_distance, 1e3)]
            return sum(jnp.sum(jnp.sin(1e3 * part + 1)) for part in parts)

        return jnp.nansum(jax.vmap(lane)(*lanes))

    gradient = jax.jit(jax.grad(total, argnums=(0, 1)))
    s = RV_320E.stiffness
    nominal, still = (TORQUE, 0.3, s.sun_torsion, s.sun_support), (0.0, 0.0, 0.0, s.sun_support)
    lost = (TORQUE, 0.3, s.sun_torsion, np.nan)
    (shared, with_lost), (_, sound) = (
        jax.tree.map(np.asarray, gradient(0.0, tuple(np.array(row) for row in zip(nominal, third, still))))
        for third in (lost, nominal)
    )
    for found, expected in zip(with_lost, sound):
        assert np.isfinite(expected).all()
        np.testing.assert_allclose(found[[0, 2]], expected[[0, 2]], rtol=1e-12)
    np.testing.assert_allclose(shared, sound[3][[0, 2]].sum(), rtol=1e-12)
    assert sound[3][1] != 0


def test_frequencies_and_shapes_of_modes_turn_as_differences_say():
    """phi^T (dK - lambda dM) phi, and shapes of simple rotational modes, in size, for a shape has no sign.

    Sixth order leaves rounding over the step.
    """
    names = ("stiffness.sun_support", "cycloid.eccentricity", "inertia.planet_mass", "stiffness.disc_pin_mesh")

    @jax.jit
    def motion(shares):
        design = RV_320E
        for name, share in zip(names, shares):
            design = changed(design, name, get(RV_320E, name) * (1 + share))
        found = dynamics.modes(design)
        order = jnp.argsort(jnp.where(found.kind_index == KINDS.index("rotational"), found.frequency, jnp.inf))[1:6]
        return found.frequency, jnp.abs(found.shape[2, order])  # rotation of the sun

    frequency, shape = jax.jit(jax.jacfwd(motion))(np.zeros(4))
    expected = [[], []]
    for one in np.eye(4):
        for part, column in enumerate(expected):
            column.append(sixth_order(lambda v, one=one, part=part: np.asarray(motion(v * one)[part]), 0.0, 1e-3))
    for slope, column in zip(frequency.T, expected[0]):
        np.testing.assert_allclose(slope, column, atol=1e-7 * np.abs(column).max())
    turn, due = shape[:, 3], expected[1][3]
    assert np.abs(turn / motion(np.zeros(4))[1]).max() > 1e-2
    np.testing.assert_allclose(turn, due, rtol=1e-6, atol=1e-8 * np.abs(due).max())


def test_a_frequency_that_meets_a_mode_is_told():
    """Undamped, w^2 equal to a square or one rounding beside; damped never."""
    modal, met_by = ModalSector(None, None, None, None, np.array([4.0, 9.0])), jax.jit(on_resonance)
    for square, met in ((9.0, True), (9.0 * (1 + 2e-16), True), (9.0 * (1 + 1e-12), False), (6.0, False)):
        z = [np.array([complex(x)]) for x in (1.0, 0.0, -square)]
        assert bool(met_by(modal, DynamicStiffness(*z))) == met
        assert not met_by(modal, DynamicStiffness(z[0] * (1 + 1e-6j), *z[1:]))


def test_second_derivatives_of_modes_are_slopes_of_the_first():
    """A peak of a speed range moves with its mode: its size, at that speed, has a second derivative of its own."""

    def modes(x):
        stiffness, inertia = RV_320E.stiffness, RV_320E.inertia
        softer = stiffness.replace(sun_planet_mesh=stiffness.sun_planet_mesh * (1 + x))
        design = RV_320E.replace(stiffness=softer, inertia=inertia.replace(planet_mass=inertia.planet_mass * (1 + x)))
        return _modes(lump(design))

    slope = jax.jit(jax.jacfwd(modes))
    found = jax.jit(jax.jacfwd(jax.jacfwd(modes)))(0.1)
    np.testing.assert_allclose(found, sixth_order(slope, 0.1, 1e-3), rtol=1e-7, atol=1e-6)
    assert np.abs(found).max() > 100
