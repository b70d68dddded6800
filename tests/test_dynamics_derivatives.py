"""Sensitivities of the dynamic model.

Oracles: the closed-form total derivative Z dB = dA - dZ B, with A and Z differentiated by complex steps of the
NumPy model (dynamics_oracle.py), to 1e-7; central finite differences to 1e-7; forward against reverse mode;
independent log-sensitivities (tests/reference/dynamics.json); the zero-sensitivity theorems of Section 4 of the
source, to rounding.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynamics_oracle import Oracle, layout
from rvjax import Damping, dynamics
from rvjax.catalogue import RV_320E
from rvjax.units import rpm

TORQUE, RATED = -3136.0, 1000 * rpm
DAMPED = RV_320E.replace(damping=Damping(0.02, 30.0, 2e-7, 0.01))
FIELDS = {  # a field of the design and its step for finite differences, relative
    "cycloid.eccentricity": 1e-3,
    "cycloid.force_angle": 1e-3,
    "involute.pressure_angle": 1e-3,
    "involute.planet_base_radius": 1e-3,
    "cranks.circle_radius": 1e-3,
    "stiffness.sun_support": 1e-2,
    "stiffness.turning_arm_bearing": 1e-2,
    "stiffness.disc_pin_mesh": 1e-2,
    "inertia.planet_mass": 1e-2,
    "inertia.disc_inertia": 1e-2,
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


def speed_up(method, design=DAMPED, stage="planetary", harmonics=4, outputs=("output.x", "output.rotation")):
    def amplitudes(values):
        full = design
        for name, value in zip(FIELDS, values):
            full = changed(full, name, value)
        found = dynamics.response(
            full,
            sun_speed=RATED,
            output_torque=TORQUE,
            stage=stage,
            harmonics=harmonics,
            method=method,
            outputs=outputs,
        )
        return jnp.stack([found.amplitude.real, found.amplitude.imag])

    return amplitudes, jnp.array([get(design, name) for name in FIELDS])


@pytest.mark.parametrize(
    ("method", "design", "stage"),
    [
        ("harmonic_balance", layout(DAMPED, 3, 3), "planetary"),
        ("harmonic_balance", layout(DAMPED, 3, 2, disc_phase=0.3), "planetary"),
    ],
    ids=["cyclic", "mesh"],
)
def test_forward_reverse_and_finite_differences_agree(method, design, stage):
    function, point = speed_up(method, design, stage)
    forward, reverse = jax.jit(lambda x: (jax.jacfwd(function)(x), jax.jacrev(function)(x)))(point)
    run = jax.jit(jax.vmap(function))
    value = np.abs(np.asarray(run(jnp.stack([point] * 6))[0])).max(axis=(0, 1), keepdims=True)[..., None]
    scale = value / np.abs(point)  # of the output, per relative change of the field
    np.testing.assert_allclose(forward / scale, reverse / scale, atol=1e-10)
    for k, step in enumerate(FIELDS.values()):
        h = step * point[k]
        rows = run(jnp.stack([point.at[k].add(j * h) for j in (-3, -2, -1, 1, 2, 3)]))
        slope = (
            1.5 * (rows[3] - rows[2]) / (2 * h)
            - 0.6 * (rows[4] - rows[1]) / (4 * h)
            + 0.1 * (rows[5] - rows[0]) / (6 * h)
        )
        np.testing.assert_allclose(
            forward[..., k] / scale[..., 0], slope / scale[..., 0], atol=1e-7, err_msg=list(FIELDS)[k]
        )


def test_second_derivatives():
    """The Hessian of a squared amplitude is the finite difference of its gradient."""
    function, point = speed_up("first_order")

    def power(values):
        return jnp.sum(function(values)[:, :, 1] ** 2) * 1e16

    direction = point * jnp.linspace(0.5, 1.5, len(point))
    gradient = jax.jit(jax.grad(lambda s: power(point + s * direction)))
    hessian = jax.jit(jax.grad(jax.grad(lambda s: power(point + s * direction))))
    slope = sixth_order(gradient, 0.0, 1e-3)
    assert float(hessian(0.0)) == pytest.approx(float(slope), rel=1e-6)


def test_closed_form_total_derivative():
    """Z dB = dA - dZ B with dA = -d(dK_l) qbar - dK_l Kbar^-1 (dF - dKbar qbar), matrices differentiated apart."""
    found = dynamics.log_sensitivities(RV_320E, sun_speed=RATED, output_torque=TORQUE)
    names = [name for name in FIELDS if name.split(".")[0] in ("cycloid", "involute", "cranks", "stiffness", "inertia")]
    w, order = Oracle(RV_320E).frequency("planetary", RATED), 1

    def pieces(design):
        oracle = Oracle(design)
        rows, k, phase, a = oracle.stage("planetary", 1)
        change = k * a[0] * (rows.T * np.exp(1j * order * phase)) @ rows  # dK_l
        return oracle.K, np.diag(oracle.m), oracle.load(TORQUE), change

    K, M, F, dK = pieces(RV_320E)
    mean = np.linalg.solve(K, F)
    Z = K - (order * w) ** 2 * M
    B = np.linalg.solve(Z, -dK @ mean)
    labels = dynamics.assemble(RV_320E).labels
    for name in names:
        x = get(RV_320E, name)
        slopes = [
            sixth_order(lambda v, i=i, name=name: pieces(changed(RV_320E, name, v))[i], x, 1e-3 * x) for i in range(4)
        ]
        dA = -slopes[3] @ mean - dK @ np.linalg.solve(K, slopes[2] - slopes[0] @ mean)
        expected = x * np.linalg.solve(Z, dA - (slopes[0] - (order * w) ** 2 * slopes[1]) @ B)[labels.index("output.x")]
        amplitude = B[labels.index("output.x")]
        assert complex(found[name][0, 0]) == pytest.approx(expected / amplitude, rel=1e-7, abs=1e-9)


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
    options = dict(sun_speed=RATED, output_torque=TORQUE)
    apart = dynamics.log_sensitivities(dynamics.lump(RV_320E), **options)
    together = dynamics.log_sensitivities(RV_320E, **options)
    for symbol, value in case.items():
        name = NAMES.get(symbol) or data["symbols"].get(symbol, "").split(" ")[0]
        found = together["cycloid.eccentricity"] if symbol == "rc=eZc" else apart[name]
        assert complex(found[0, 0]) == pytest.approx(complex(*value), rel=1e-7, abs=1e-9), symbol
    for name in ("involute.centre_distance", "cycloid.pin_radius", "cycloid.pin_circle_radius"):
        assert np.all(together[name] == 0)
    assert np.abs(together["cycloid.disc_phase"]).max() < 1e-11


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
    design = dynamics.lump(RV_320E) if stage == "planetary" else RV_320E
    name = "eccentricity" if stage == "planetary" else "cycloid.eccentricity"
    options = dict(sun_speed=RATED, output_torque=TORQUE, stage=stage)
    without = dynamics.log_sensitivities(design, **options, formula="constant_forcing")
    whole = dynamics.log_sensitivities(design, **options)
    for found, expected in ((without, printed), (whole, total)):
        for (harmonic, output), value in expected.items():
            column = dynamics.response(design, **options).outputs.index(output)
            assert float(found[name][harmonic - 1, column].real) == pytest.approx(value, abs=6e-5)
    for field, value in whole.items():
        if field.startswith(("stiffness", "inertia")):
            np.testing.assert_allclose(without[field], value, rtol=1e-9, atol=1e-10, err_msg=field)


def test_zero_sensitivities():
    """Section 4: rotational responses ignore central supports and masses, translational ones central torsion and
    inertia, planetary ones all central values; harmonic balance mixes them."""
    translation = [f"stiffness.{part}_support" for part in ("sun", "output")]
    translation += [f"inertia.{part}_mass" for part in ("sun", "output")]
    rotation = [f"stiffness.{part}_torsion" for part in ("sun", "output")]
    rotation += [f"inertia.{part}_inertia" for part in ("sun", "output")]
    outputs = ("output.x", "output.rotation", "planet1.y")
    found = dynamics.log_sensitivities(RV_320E, sun_speed=RATED, output_torque=TORQUE, harmonics=4, outputs=outputs)
    for name in translation:
        assert np.all(found[name][3, 1] == 0) and abs(found[name][1, 2]) < 1e-12
    for name in rotation:
        assert abs(found[name][0, 0]) < 1e-12 and abs(found[name][1, 2]) < 1e-12
    assert min(abs(found[name][3, 1]) for name in ("stiffness.sun_torsion", "inertia.sun_inertia")) > 0.1
    assert all(value[1, 0] == 0 for value in found.values())  # a suppressed output

    def turned(k):
        design = RV_320E.replace(stiffness=RV_320E.stiffness.replace(sun_support=k), damping=Damping(loss_factor=0.04))
        full = dynamics.response(
            design, sun_speed=RATED, output_torque=TORQUE, method="harmonic_balance", outputs=["output.rotation"]
        )
        return jnp.abs(full.amplitude[3, 0])

    value, slope = jax.value_and_grad(turned)(4.19e7)
    assert abs(float(slope * 4.19e7 / value)) > 1e-3


def test_no_nan_at_repeated_eigenvalues_or_empty_excitation():
    """Pairs, zero torque, zero swing, zero damping, zero rigid mode: all derivatives are numbers."""

    def everything(design, torque, speed):
        modes = dynamics.modes(design)
        static = dynamics.static(design, output_torque=torque)
        full = dynamics.response(design, sun_speed=speed, output_torque=torque, method="harmonic_balance", harmonics=2)
        parts = [modes.frequency, modes.shape, static.deflection, static.cycloid_force]
        parts += [full.amplitude.real, full.amplitude.imag, full.mean, full.resonance_distance]
        return sum(jnp.sum(jnp.sin(1e3 * part + 1)) for part in parts)

    still = RV_320E.replace(
        mesh_variation=RV_320E.mesh_variation.replace(planetary_swing=0.0),
        stiffness=RV_320E.stiffness.replace(sun_torsion=0.0),
    )
    gradient = jax.jit(jax.grad(everything, argnums=(0, 1, 2)))
    for case in ((RV_320E, TORQUE, RATED), (still, 0.0, RATED)):
        for leaf in jax.tree.leaves(gradient(*jax.tree.map(jnp.asarray, case))):
            assert np.isfinite(leaf)


def test_frequency_derivatives():
    """phi^T (dK - lambda dM) phi; and a failed lane leaves its neighbours' gradients alone."""
    slope = jax.jacrev(lambda d: dynamics.modes(d).frequency)(RV_320E)
    for name in ("stiffness.sun_support", "cycloid.eccentricity", "inertia.planet_mass"):
        x = get(RV_320E, name)
        expected = sixth_order(
            lambda v, name=name: np.asarray(dynamics.modes(changed(RV_320E, name, v)).frequency), x, 1e-3 * x
        )
        np.testing.assert_allclose(get(slope, name), expected, atol=1e-7 * np.abs(expected).max())

    def first(k):
        design = changed(RV_320E, "stiffness.sun_support", k)
        found = dynamics.response(design, sun_speed=RATED, output_torque=TORQUE)
        return jnp.abs(found.amplitude[0, 0])

    lanes = jax.jit(jax.grad(lambda k: jnp.nansum(jax.vmap(first)(k))))(jnp.array([4.19e7, jnp.nan, 5e7]))
    alone = jax.grad(first)(4.19e7)
    assert lanes[0] == pytest.approx(float(alone), rel=1e-9) and np.isfinite(lanes[2])
