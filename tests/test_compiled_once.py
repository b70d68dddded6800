"""Every public function of the models and of `roots` is compiled once: equal shapes compile nothing further.

Oracle: JAX's own events. A program traced or compiled anew reports its duration to `jax.monitoring`, whether or not it
was found in a cache on disk; a second call with other numbers must report nothing, so it costs what the program costs.
JAX 0.10 and later do not report a program that is traced inside another one. There the calls are compiled by default.
"""

import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import (
    CamRollerErrors,
    Friction,
    LinkDeviations,
    RollerBearing,
    RVErrors,
    dynamics,
    four_bar,
    geometry,
    life,
    loaded,
    lost_motion,
    mesh_force,
    roots,
    running,
)
from rvjax.catalogue import CORR, RV_20E, RV_40E, RV_320E
from rvjax.loaded.cases import MACHINE
from rvjax.status import SolveInfo
from rvjax.units import deg, mm, rpm, um

INNER_TRACES = tuple(map(int, jax.__version__.split(".")[:2])) < (0, 10)  # are reported
PACKAGES = (four_bar, lost_motion, mesh_force, dynamics, life, running, geometry, roots)


def residual(x, p):
    return x**3 - p


RATED = MACHINE.replace(bearings=RV_40E.bearings)


def roller(x):
    return RollerBearing(14, 5 * mm, x * 10 * mm, 32 * mm)


def units(x):
    return RVErrors.for_design(RV_40E, crank_eccentricity=x * um, carrier_bore=-x * um, bearing_clearance=x * um)


def rubbing(x):
    return Friction(ring_pins=0.1 * x, arm_bearings=0.01 * x, output_drag=x)


def placed(x):
    return RVErrors(planet_runout=x * um, disc_bore=jnp.full((3, 4, 2), x * um), sun_flank=jnp.full((4, 2), x * um))


FEW = CORR.replace(gear_teeth=3)  # every roller is traced for itself


def rollers(x):
    return CamRollerErrors(cam_radius=x * um, eccentricity=0.0, roller_radius=jnp.full(FEW.gear_teeth + 1, x * um))


def links(x):
    return LinkDeviations(crank_1=x * um, coupler=-x * um)


def sounder(x):
    """A reducer of other masses."""
    return RV_320E.replace(inertia=RV_320E.inertia.replace(sun_mass=RV_320E.inertia.sun_mass * (1 + x)))


SPIN = dict(sun_speed=1000 * rpm, output_torque=-500.0)
CALLS = {  # name: one call of the function for each way that is decided before the program runs; x is what differs
    "four_bar.solve_closure": [
        lambda x: four_bar.solve_closure(1.3 * mm, 72 * mm, links(x), crank_angle=x),
        lambda x: four_bar.solve_closure(1.3 * mm, 72 * mm, links(x), crank_angle=x, cranks="free"),
        lambda x: four_bar.solve_closure(
            1.3 * mm, 72 * mm, links(x), crank_angle=x, cranks="geared", gear_stiffness_ratio=x
        ),
    ],
    "four_bar.transmission_error": [
        lambda x: four_bar.transmission_error(RV_40E, units(x), crank_angle=x),
        lambda x: four_bar.transmission_error(RV_40E, units(x), crank_angle=x, output_torque=100 * x),
    ],
    "four_bar.revolution": [
        lambda x: four_bar.revolution(RV_40E, units(x)),
        lambda x: four_bar.revolution(RV_40E, units(x), angles=8, output_torque=100 * x, closure="first_order"),
    ],
    "four_bar.figures": [
        lambda x: four_bar.figures(RV_40E, units(x), closure="first_order"),
        lambda x: four_bar.figures(RV_40E, units(x), angles=8, cranks="geared", gear_stiffness_ratio=x),
    ],
    "lost_motion.geometric": [
        lambda x, profile=profile: lost_motion.geometric(RV_20E, RVErrors(pin_radius=x * um), profile=profile)
        for profile in ("first_order", "closed_form", "contact")
    ]
    + [lambda x: lost_motion.geometric(RV_20E, RVErrors(), reading="as_printed", normal_force=x)],
    "lost_motion.shaft_tilt": [lambda x: lost_motion.shaft_tilt(x * mm, 10 * mm)],
    "lost_motion.hysteresis_loop": [
        lambda x: lost_motion.hysteresis_loop(
            jnp.array([x, 0.0, -x]), play=x, stiffness=1.0, friction=0.1, smoothing=0.1
        ),
    ],
    "lost_motion.loop_figures": [
        lambda x: lost_motion.loop_figures(
            torque_threshold=x, torque_max=10.0, play=x, stiffness=1.0, friction=0.1, smoothing=0.1
        ),
    ],
    "mesh_force.solve": [
        lambda x, law=law: mesh_force.solve(FEW, rollers(x), input_torque=100 * x, output_angle=x, contact=law)
        for law in ("linear",)
    ],
    "mesh_force.contact_pressure": [lambda x: mesh_force.contact_pressure(FEW, pressed(x), output_angle=x)],
    "mesh_force.cycle_statistics": [
        lambda x: mesh_force.cycle_statistics(
            FEW, CamRollerErrors(x * um, 0.0, 0.0), input_torque=100 * x, contact="linear", samples=2
        )
    ],
    "mesh_force.sweep": [
        lambda x: mesh_force.sweep(
            FEW,
            rollers(x),
            "cam_radius",
            jnp.array([149.0, 150.0 + x]) * mm,
            input_torque=100.0,
            samples=1,
            contact="linear",
        )
    ],
    "mesh_force.cycle_angles": [lambda x: mesh_force.cycle_angles(25, samples=round(10 * x))],
    "mesh_force.largest_roller_radius": [lambda x: mesh_force.largest_roller_radius(FEW.replace(cam_radius=x))],
    "mesh_force.undercut_margin": [lambda x: mesh_force.undercut_margin(FEW.replace(cam_radius=x))],
    "mesh_force.tooth_profile": [lambda x: mesh_force.tooth_profile(FEW, x * deg)],
    "dynamics.assemble": [lambda x: dynamics.assemble(sounder(x))],
    "dynamics.blocks": [lambda x: dynamics.blocks(sounder(x))],
    "dynamics.lump": [lambda x: dynamics.lump(sounder(x))],
    "dynamics.with_deviations": [lambda x: dynamics.with_deviations(RV_320E, {"inertia.sun_mass": x})],
    "dynamics.modes": [lambda x: dynamics.modes(sounder(x), load_inertia=x)],
    "dynamics.static": [lambda x: dynamics.static(sounder(x), output_torque=x)],
    "dynamics.response": [lambda x: dynamics.response(sounder(x), harmonics=1, **SPIN)],
    "dynamics.constant_forcing": [lambda x: dynamics.constant_forcing(sounder(x), harmonics=1, **SPIN)],
    "dynamics.log_sensitivities": [
        lambda x: dynamics.log_sensitivities(sounder(x), harmonics=1, outputs=("output.x",), **SPIN)
    ],
    "dynamics.periodic": [lambda x: dynamics.periodic(rectangular(x), samples=4, **SPIN)],
    "dynamics.floquet": [lambda x: dynamics.floquet(rectangular(x), sun_speed=100 * x)],
    "dynamics.error_excitation": [lambda x: dynamics.error_excitation(sounder(x), placed(x))],
    "dynamics.error_transfer": [lambda x: dynamics.error_transfer(sounder(x), frequency=100 * x)],
    "dynamics.transmission_error": [
        lambda x: dynamics.transmission_error(sounder(x), placed(x), sun_speed=100 * x, load_inertia=x),
        lambda x: dynamics.transmission_error(
            sounder(x), placed(x), sun_speed=100 * x, method="harmonic_balance", harmonics=1, output_torque=-x
        ),
    ],
    "dynamics.speed_sweep": [
        lambda x: dynamics.speed_sweep(sounder(x), placed(x), sun_speeds=jnp.array([100.0, 200.0 * x]))
    ],
    "dynamics.speed_range": [
        lambda x: dynamics.speed_range(
            sounder(x), placed(x), slowest_sun_speed=50.0, fastest_sun_speed=200 * x, load_inertia=x, speeds=4
        )
    ],
    "dynamics.error_statistics": [
        lambda x: dynamics.error_statistics(sounder(x), placed(x), sun_speed=100 * x, load_inertia=x)
    ],
    "life.dynamic_rating": [lambda x: life.dynamic_rating(roller(x))],
    "life.static_rating": [lambda x: life.static_rating(roller(x))],
    "life.bearing_life": [
        lambda x, method=method: life.bearing_life(roller(x), jnp.full((4, 2), 100 * x), method=method)
        for method in ("basic", "raceway", "slices")
    ],
    "life.rating": [lambda x: life.rating(RATED, units(x), life.Duty([100 * x], [x], [1.0]), samples=2)],
    "life.rated_torque": [lambda x: life.rated_torque(RATED, units(x), life=1e7 * x, output_speed=x, samples=2)],
    "running.losses": [
        lambda x: running.losses(RATED, units(x), rubbing(x), output_torque=100 * x, output_speed=x, samples=2)
    ],
    "running.back_driving": [lambda x: running.back_driving(RATED, units(x), rubbing(x), samples=2)],
    "running.hysteresis": [lambda x: running.hysteresis(RATED, units(x), rubbing(x), input_angle=x)],
    "running.joint": [lambda x: running.joint(RATED, units(x), rubbing(x), rated_torque=100 * x, samples=2)],
    "running.fit_drag": [lambda x: running.fit_drag(np.array([1.0, 2.0, -1.0, -2.0]), x * np.array([1.0, 2, -1, -2]))],
    "geometry.figures": [lambda x: geometry.figures(MACHINE, 100 * x)],
    "geometry.outline": [lambda x: geometry.outline(MACHINE, errors=units(x), points=4)],
    "roots.bracketed": [lambda x: roots.bracketed(residual, x, 0.0, 2.0)],
}


def pressed(x):
    """Forces such as `solve` returns, of which what reads them makes something whatever they are."""
    force = jnp.full(FEW.gear_teeth + 1, 100.0 * x)
    return mesh_force.MeshForces(cam=force, cage=force, gear=force, windup=x, info=SolveInfo(0, 5, 1e-15))


def rectangular(x):
    """Meshes that switch between two levels, no loss factor: what the exact periodic solution asks for."""
    variation = dict(planetary_ramp=0.0, cycloid_ramp=0.0)
    return sounder(x).replace(
        mesh_variation=RV_320E.mesh_variation.replace(**variation),
        damping=dynamics.lump(RV_320E).damping.replace(loss_factor=0.0, rayleigh_mass=10.0),
    )


def test_every_exported_function_has_its_calls():
    exported = {
        f"{package.__name__.removeprefix('rvjax.')}.{name}"
        for package in PACKAGES
        for name in package.__all__
        if callable(getattr(package, name)) and not inspect.isclass(getattr(package, name))
    }
    assert set(CALLS) == exported


DEAR = (  # to trace; others of the same packages run by default
    "four_bar.revolution", "four_bar.figures", "lost_motion.geometric", "mesh_force.cycle_statistics",
    "dynamics.log_sensitivities", "dynamics.transmission_error", "dynamics.speed_range", "dynamics.error_statistics",
    "life.rating", "life.rated_torque", "running.losses", "running.hysteresis", "running.joint",
)  # fmt: skip
assert set(DEAR) < set(CALLS)


@pytest.mark.skipif(not INNER_TRACES, reason="JAX reports no inner traces: the test below sees them compile")
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] if n in DEAR else []) for n in CALLS])
def test_a_second_call_traces_nothing(name, compiled):
    """And what is not traced anew is not compiled anew. Nothing is compiled here, but for that a trace is enough."""
    for number, call in enumerate(CALLS[name]):
        jax.eval_shape(lambda call=call: call(0.3))
        compiled.clear()
        jax.eval_shape(lambda call=call: call(0.7))
        assert len(compiled) == 1, f"{name}, way {number}"  # that of the lambda


@(pytest.mark.long if INNER_TRACES else lambda test: test)  # dear, and follows from the test above
@pytest.mark.parametrize("name", CALLS)
def test_a_second_call_compiles_nothing(name, compiled):
    for number, call in enumerate(CALLS[name]):
        call(0.3)
        compiled.clear()
        call(0.7)
        assert not compiled, f"{name}, way {number}"


def test_a_program_that_is_compiled_reports_it(compiled):
    """The oracle of this page sees what it is to see: a closure made in the call is traced and compiled anew."""

    def call(x):
        return jax.jit(lambda p: p * x)(1.0)

    for x in (0.3, 0.7):
        compiled.clear()
        call(x)
        assert any("compile" in event for event in compiled)
        compiled.clear()
        jax.eval_shape(lambda x=x: call(x))
        assert len(compiled) == 1 + INNER_TRACES


WRONG = {  # functions that take a design, each called with one of another kind
    "four_bar.transmission_error": lambda d, e: four_bar.transmission_error(d, e, crank_angle=0.0),
    "four_bar.revolution": lambda d, e: four_bar.revolution(d, e),
    "four_bar.figures": lambda d, e: four_bar.figures(d, e),
    "lost_motion.geometric": lambda d, e: lost_motion.geometric(d, e),
    "loaded.equilibrium": lambda d, e: loaded.equilibrium(d, e, input_angle=0.0, output_torque=1.0),
    "loaded.revolution": lambda d, e: loaded.revolution(d, e, output_torque=1.0),
    "loaded.torsion": lambda d, e: loaded.torsion(d, e, input_angle=0.0, rated_torque=1.0),
    "life.rating": lambda d, e: life.rating(d, e, life.Duty(1.0, 1.0, 1.0)),
    "life.rated_torque": lambda d, e: life.rated_torque(d, e, life=1.0, output_speed=1.0),
    "running.losses": lambda d, e: running.losses(d, e, output_torque=1.0, output_speed=1.0),
    "running.back_driving": lambda d, e: running.back_driving(d, e),
    "running.hysteresis": lambda d, e: running.hysteresis(d, e),
    "running.joint": lambda d, e: running.joint(d, e, rated_torque=1.0),
    "dynamics.modes": lambda d, e: dynamics.modes(d),
    "dynamics.response": lambda d, e: dynamics.response(d, **SPIN),
    "dynamics.periodic": lambda d, e: dynamics.periodic(d, **SPIN),
    "dynamics.log_sensitivities": lambda d, e: dynamics.log_sensitivities(d, **SPIN),
    "dynamics.transmission_error": lambda d, e: dynamics.transmission_error(d, e, sun_speed=100.0),
    "dynamics.error_excitation": lambda d, e: dynamics.error_excitation(d, e),
    "RVErrors.for_design": lambda d, e: RVErrors.for_design(d),
    "mesh_force.solve": lambda d, e: mesh_force.solve(d, e, input_torque=1.0, output_angle=0.0),
    "mesh_force.cycle_statistics": lambda d, e: mesh_force.cycle_statistics(d, e, input_torque=1.0),
    "mesh_force.sweep": lambda d, e: mesh_force.sweep(d, e, "eccentricity", np.ones(2), input_torque=1.0),
    "mesh_force.tooth_profile": lambda d, e: mesh_force.tooth_profile(d, 0.0),
    "mesh_force.undercut_margin": lambda d, e: mesh_force.undercut_margin(d),
    "mesh_force.largest_roller_radius": lambda d, e: mesh_force.largest_roller_radius(d),
    "CamRollerErrors.for_design": lambda d, e: CamRollerErrors.for_design(d),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_design_of_another_kind_is_refused_by_name(name):
    of_rollers = name.startswith(("mesh_force", "Cam"))
    wrong, errors = (RV_40E, RVErrors()) if of_rollers else (CORR, CamRollerErrors())
    takes, got = ("CamRollerReducer", "RVReducer") if of_rollers else ("RVReducer", "CamRollerReducer")
    with pytest.raises(ValueError, match="takes a design") as refused:
        WRONG[name](wrong, errors)
    told = rf"{name.split('.')[0]}\S*: takes a design of kind {takes}( or Lumped| or CycloidalReducer)?, got {got}"
    assert re.fullmatch(told, str(refused.value))


def test_errors_in_the_place_of_a_design_are_refused():
    with pytest.raises(ValueError, match="takes a design of kind RVReducer, got RVErrors"):
        four_bar.transmission_error(RVErrors(), RV_40E, crank_angle=0.0)
