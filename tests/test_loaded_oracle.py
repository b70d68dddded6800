"""The loaded reducer against an independent model in 80-bit numbers, over all laws, supports and counts.

Oracle: `tests.oracles.loaded`, dense rows minimised by SciPy and polished. Tolerance: what the solver's own rule to
stop (a gradient of 1e-13 of the largest force, or the rounding of a gap times its stiffness) moves a result by at most,
from the inverse Hessian of the oracle, times ten; forces besides 1e-10 of the largest, what float64 directions leave.
"""

import itertools

import jax
import numpy as np
import pytest
from loaded_cases import newton_alone

import rvjax
from rvjax import RVErrors, Status, catalogue, loaded
from rvjax.designs import Contact
from tests.oracles import loaded as oracle

LAWS, SUPPORTS = ("hertz", "linear", "palmgren"), ("fixed", "floating")
COUNTS = ((2, 2, 39), (3, 2, 24), (2, 1, 39), (4, 3, 11))  # cranks, discs, teeth
CASES = list(itertools.product(LAWS, zip(SUPPORTS * 2, ("fixed", "fixed", "floating", "floating"))))


def reducer(cranks, discs, teeth):
    """An RV-40E with other counts, every stiffness given, that of a pin too, which no reference case gives."""
    base, like = catalogue.RV_40E, catalogue.RV_320E.stiffness
    cycloid = base.cycloid.replace(
        disc_teeth=teeth, pin_count=teeth + 1, disc_count=discs, eccentricity=0.8 * 64e-3 / (teeth + 1),
        pin_radius=min(3e-3, 0.03 / (teeth + 1) * 3),
    )  # fmt: skip
    return base.replace(
        cycloid=cycloid,
        cranks=base.cranks.replace(count=cranks),
        stiffness=like.replace(output_support=2e9),
        contact=Contact(young_modulus=206e9, poisson_ratio=0.3, face_width=0.012, pin_stiffness=2.5e7, pin_support=4e8),
    )


def drawn(design, rng, play):
    """Errors of every kind, of some micrometres, with play everywhere or with interference."""
    c, d, zc = design.cranks.count, design.cycloid.disc_count, design.cycloid.disc_teeth
    placed = {
        "crank_eccentricity": (d, c), "disc_bore": (d, c, 2), "carrier_bore": (c, 2), "pin_offset": (zc + 1, 2),
        "pin_radii": (zc + 1,), "ring_centre": (2,), "disc_centre": (d, 2), "disc_pitch": (d, zc),
        "disc_profile": (d, 5, 2), "sun_runout": (2,), "planet_runout": (c, 2), "eccentricity": (),
        "pin_circle_radius": (), "pin_radius": (), "equidistant_modification": (), "shift_modification": (),
    }  # fmt: skip
    errors = {name: rng.normal(size=shape) * 2e-6 for name, shape in placed.items()}
    errors |= {"crank_phase": rng.normal(size=c) * 5e-5, "base_tangent_upper": -8e-6 * play}
    errors |= {"bearing_clearance": 2e-6 * play, "support_clearance": 1e-6 * play, "pin_hole_clearance": 1e-6}
    return RVErrors.for_design(design, **errors)


def agree(found, due):
    """Every result of a case within what the rule to stop leaves."""
    assert Status(int(found.info.status)).name == due["status"]
    assert abs(float(found.error) - due["error"]) <= 10 * due["error_allowed"] + 1e-12 * abs(due["error"])
    force = 10 * due["force_allowed"] + 1e-10 * due["largest"]
    for name in ("pins", "disc_bearing", "support_bearing", "gear"):
        np.testing.assert_allclose(getattr(found, name), due[name], rtol=0, atol=force, err_msg=name)
    np.testing.assert_allclose(found.disc_torque, due["disc_torque"], rtol=0, atol=force * 0.064)
    np.testing.assert_allclose(found.input_torque, due["input_torque"], rtol=0, atol=force * 0.064)
    # the stiffness jumps where a contact closes and moves with every force: a millionth, as the forces a billionth
    np.testing.assert_allclose(found.stiffness, due["stiffness"], rtol=1e-6)
    top = due["pressure"].max()
    np.testing.assert_allclose(np.asarray(found.pressure) ** 2, due["pressure"] ** 2, rtol=0, atol=1e-8 * top**2)


DEFAULT = (11,)  # test_loaded_reference.py has other laws; each case is a program of its own
LONG = [c if k in DEFAULT else pytest.param(*c, marks=pytest.mark.long) for k, c in enumerate(CASES)]


@pytest.mark.parametrize(("law", "supports"), LONG)
def test_agrees_with_the_oracle(law, supports):
    carrier, sun = supports
    number = CASES.index((law, supports))
    rng = np.random.default_rng(number)
    design = reducer(*COUNTS[number % len(COUNTS)])
    options = dict(contact=law, carrier=carrier, sun=sun)
    solve = jax.jit(newton_alone()(lambda errors, angle, torque: loaded.equilibrium(
        design, errors, input_angle=angle, output_torque=torque, **options)))  # fmt: skip
    for torque, play in ((412.0, 1.0), (-12.0, 1.0), (150.0, 0.0)):
        errors, angle = drawn(design, rng, play), rng.uniform(0, 600)
        due = oracle.equilibrium(design, errors, input_angle=angle, output_torque=torque, **options)
        agree(solve(errors, angle, torque), due)


def test_oracle_judges_positions():
    """Gradients in 80-bit numbers are differences of the energy; they vanish at the answer and nowhere near."""
    design = reducer(2, 2, 39)
    errors = drawn(design, np.random.default_rng(5), 1.0)
    options = dict(input_angle=102.0, output_torque=412.0, carrier="floating", sun="floating")
    q = oracle.equilibrium(design, errors, **options)["q"]
    _, slope, largest = oracle.gradient_at(design, errors, q, **options)
    assert np.abs(slope).max() < 1e-15 * largest
    machine = oracle.Machine(oracle.read(design, errors, **options))
    moved = q + 1e-7 * np.random.default_rng(6).normal(size=q.shape).astype(oracle.REAL) / machine.length[0]
    _, slope, _ = oracle.gradient_at(design, errors, moved, **options)
    assert np.abs(slope / machine.length[0]).max() > 1.0
    for i in range(len(q)):
        step = np.zeros_like(q)
        step[i] = 1e-11 / machine.length[0, i]
        energies = [machine.state((moved + sign * step)[None] * machine.length).energy[0] for sign in (1, -1)]
        difference = (energies[0] - energies[1]) / (2 * step[i])
        # steps of 1e-11 m: the third derivative leaves (1e-11 / 1e-6)^2, rounding 1e-19 J / 1e-11 m of some N
        assert abs(difference - slope[i]) < 1e-6 * np.abs(slope / machine.length[0]).max() * machine.length[0, i]


def test_contact_is_exported():
    assert rvjax.Contact is Contact
