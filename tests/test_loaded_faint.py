"""Torques far below any that a bench knows: a status of the loaded reducer is a promise there too.

A gap of 10 um is rounded to 1e-21 m; times a spring of 1e9 N/m that is 1e-12 N. A torque of 1e-12 N m makes forces as
small. Oracle: minima of the energy in 80-bit numbers, used where their own residual is below 1e-8.
"""

import jax
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, solve

from census import loaded as census
from oracles import loaded as oracle
from rvjax.status import Status

LAYOUT = dict(contact="palmgren", cranks=2, discs=3, teeth=8, carrier="fixed", sun="fixed")
LANES = 64
SEEDS = (1, 5, 13, 16, 19, 20, 23)  # five of them with a torque that rounding hides
TEETH = ("sun_teeth", "planet_teeth")


def reducers(seed):
    """Steel reducers of one size, errors of 0.1 to 10 um in four of five, torques of 1e-14 to 1e-6 N m."""
    rng = np.random.default_rng(seed)
    case = census.draw(rng, LANES, **LAYOUT, given=False)
    involute = census.catalogue.RV_40E.involute
    base = 0.036 * np.cos(0.35) / sum(getattr(involute, name) for name in TEETH)
    fixed = dict(
        pin_circle_radius_of_design=0.06, pin_radius_of_design=0.003, circle_radius=0.036, pressure_angle=0.35,
        young_modulus=2e11, poisson_ratio=0.3, face_width=0.01, planet_crank_torsion=1e6,
        sun_base_radius=base * involute.sun_teeth, planet_base_radius=base * involute.planet_teeth,
    )  # fmt: skip
    case |= {name: np.full(case[name].shape, value) for name, value in fixed.items()}
    case["eccentricity_of_design"] = rng.uniform(0.3, 0.8, LANES) * 0.06 / (LAYOUT["teeth"] + 1)
    for name in ("turning_arm_bearing", "support_bearing", "sun_planet_mesh", "planet_crank_bending"):
        lanes = (LANES,) + (1,) * (case[name].ndim - 1)
        case[name] = 10 ** rng.uniform(7.5, 9, lanes) * rng.uniform(0.9, 1.1, case[name].shape)
    flawed = rng.uniform(size=LANES) > 0.2
    for name, shape in census.error_shapes(LAYOUT["cranks"], LAYOUT["discs"], LAYOUT["teeth"]).items():
        size = 10 ** rng.uniform(-7, -5, LANES) * flawed * (100 if name == "crank_phase" else 1)
        case[name] = size.reshape((LANES,) + (1,) * len(shape)) * rng.normal(size=(LANES, *shape))
    for name in ("bearing_clearance", "support_clearance"):
        case[name] = np.abs(case[name])
    case["torque"] = 10 ** rng.uniform(-14, -6, LANES) * rng.choice([-1, 1], LANES)
    return case | {"angle": rng.uniform(-700, 700, LANES)}


def minima(case):
    """The oracle's."""
    part = census.parts(case)
    spare = dict.fromkeys(("sun_support", "sun_torsion", "disc_pin_mesh"), 1.0)
    involute = census.catalogue.RV_40E.involute
    count = dict(disc_teeth=LAYOUT["teeth"], pin_count=LAYOUT["teeth"] + 1, disc_count=LAYOUT["discs"])
    design = {
        "involute": part["involute"] | {name: getattr(involute, name) for name in TEETH},
        "cycloid": part["cycloid"] | count,
        "cranks": part["cranks"] | {"count": LAYOUT["cranks"]},
        "stiffness": spare | part["stiffness"],
        "contact": part["contact"],
    }
    read = dict(input_angle=case["angle"], output_torque=case["torque"])
    methods = {name: LAYOUT[name] for name in ("contact", "carrier", "sun")}
    with np.errstate(all="ignore"):
        return oracle.equilibria(design, part["errors"], LANES, steps=100, **read, **methods)


@pytest.mark.long  # another layout is another program, half a minute to compile
def test_converged_cases_have_forces_and_failed_cases_keep_their_error():
    """A clearance of 10 um holds a part by 1e-8 of a spring: rounding moves it by up to 1e-9 rad."""
    solve = jax.jit(jax.vmap(lambda case: census.run(case, **LAYOUT, given=False)))
    lost = known = 0
    for seed in SEEDS:
        case = reducers(seed)
        out, due = jax.tree.map(np.asarray, solve(case)), minima(case)
        certain, status = due["residual"] < 1e-8, out["status"]
        assert np.isin(status, (Status.CONVERGED, Status.UNLOADED)).all()
        pairs = [
            (value.reshape(LANES, -1), due[name].reshape(LANES, -1))
            for name, value in zip(census.RESULTS, out["values"][1:])
        ]
        largest = np.max([np.abs(value).max(1) for value, _ in pairs], axis=0)
        off = np.max([np.abs(value - best).max(1) for value, best in pairs], axis=0) / largest
        sure = certain & (status == Status.CONVERGED)
        assert (off[sure] < 1e-6).all()
        assert (out["residual"][status == Status.CONVERGED] < 1.5e-8).all()
        np.testing.assert_allclose(out["windup"][0][certain], due["error"][certain], rtol=1e-6, atol=1e-9)
        lost, known = lost + np.sum(status == Status.UNLOADED), known + np.sum(sure)
    assert lost > 0 and known > 0.9 * LANES * len(SEEDS)


@pytest.mark.parametrize("law", ["linear", "palmgren"])
def test_a_torque_that_the_centring_springs_carry_is_no_load(law):
    """Clearances of 10 um and 1e-9 N m: before, some angles were CONVERGED with a residual of 1e33.

    Every force is one of rounding. The angle is the torque over the centring springs alone, the same at every angle.
    """
    design = design_of(NAMED["rv40: all errors, rated, hertz"])
    names = ("bearing_clearance", "support_clearance", "pin_hole_clearance")
    errors = errors_of({"errors": dict.fromkeys(names, 1e-5)}, design)
    for torque in (1e-13, 1e-9):
        found = [solve(design, errors, angle, torque, contact=law) for angle in np.linspace(0, 600, 5)]
        assert {int(case.info.status) for case in found} == {Status.UNLOADED}
        assert max(float(np.max(case.pins)) for case in found) < 1e-9 * torque
        np.testing.assert_allclose([case.error for case in found], found[0].error, rtol=1e-9)
    loaded_again = solve(design, errors, 0.0, 1e-2, contact=law)
    assert loaded_again.info.status == Status.CONVERGED and loaded_again.info.residual < 1e-9
    assert np.max(loaded_again.pins) > 1e-3
