"""What is not asked for is not computed: floating-point operations of the compiled programs.

Oracle: XLA's own count (`cost_analysis`). It counts the body of a loop once, so programs of one kind are compared with
each other and no ratio is taken across different loops. Counts do not depend on the load of the machine.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import dynamics, four_bar, study
from rvjax.catalogue import RV_320E
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.tolerances.population.population import Population
from rvjax.units import um

UNITS = 64
STUDY = study.load("rv-40e")
CONDITIONS = replace(STUDY.conditions, angles=16)


def operations(function, *arguments):
    return jax.jit(function).lower(*arguments).compile().cost_analysis()["flops"]


def units(tolerances):
    return jax.vmap(lambda k: sample(tolerances, k, seed=0))(jnp.arange(UNITS))


def full(errors):
    return jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, float), (UNITS, *np.shape(x)[1:])), errors)


def cost_of(outputs, errors):
    response = Response.of(STUDY.design, outputs, CONDITIONS)
    return operations(lambda e: jax.vmap(lambda unit: response(unit).value)(e), errors)


def test_an_output_costs_only_itself(thorough):
    """Two models share nothing, and one asked for alone brings nothing of the other."""
    errors = full(units(STUDY.tolerances))
    error, free = (cost_of((name,), errors) for name in ("transmission_error", "lost_motion"))
    assert cost_of(("transmission_error", "lost_motion"), errors) == pytest.approx(error + free, rel=0.01)
    if not thorough:  # three programs of the dearest outputs
        return
    together, misfit = cost_of(tuple(STUDY.requirements), errors), cost_of(("misfit",), errors)
    assert together > 1.25 * max(error, misfit)  # each alone leaves out the other's search; 1 if it did not
    assert together > 15 * free
    assert cost_of(("misfit", "lost_motion"), errors) == pytest.approx(misfit + free, rel=0.01)
    # Transmission error and misfit share their linkage; the misfit's own search comes on top.
    assert together - (error + free) > 0.35 * misfit


def test_a_misfit_leaves_out_the_search_of_the_error():
    """All figures share one status, which needs the errors' extremes; a study that asks for the misfit has its own."""
    errors = full(units(STUDY.tolerances))

    def of_all_figures(unit):
        return four_bar.figures(STUDY.design, unit, angles=CONDITIONS.angles).largest_misfit

    with_search = operations(lambda e: jax.vmap(of_all_figures)(e), errors)
    assert with_search > 1.2 * cost_of(("misfit",), errors)  # 1 if both searched


@pytest.mark.long  # speed; right or wrong is held elsewhere
def test_rotation_of_the_output_costs_a_tenth_of_all_coordinates():
    """The symmetry of the reducer leaves the rotational block alone for the rotation of the output wheel."""

    def sweep(design, speeds, outputs):
        def one(speed):
            return dynamics.response(design, sun_speed=speed, output_torque=-3136.0, outputs=outputs).amplitude

        return jax.vmap(one)(speeds)

    arguments = jax.tree.map(jnp.asarray, RV_320E), jnp.linspace(100.0, 400.0, 1000)
    everything = dynamics.assemble(RV_320E).labels
    one, every = (operations(lambda *a, o=o: sweep(*a, o), *arguments) for o in (("output.rotation",), everything))
    assert every >= 10 * one


@pytest.fixture(scope="module")
def sampled():
    """Operations to draw units with some fields active and to differentiate the mean to their half-widths."""
    response = Response.of(STUDY.design, ("transmission_error",), CONDITIONS)

    def program(half_widths):
        tolerances = for_design(STUDY.design, **{n: Tolerance.symmetric(h) for n, h in half_widths.items()})
        return jnp.mean(jax.vmap(lambda e: response(e).value["transmission_error"])(full(units(tolerances))))

    def count(names):
        return operations(jax.value_and_grad(program), {name: jnp.asarray(5 * um) for name in names})

    return count(("crank_phase",)), count(("crank_phase", "carrier_bore"))


@pytest.mark.long  # the test below counts the numbers drawn
def test_an_error_without_tolerance_costs_neither_draw_nor_derivative(sampled):
    one, two = sampled
    assert one < 0.75 * two


def test_an_error_without_tolerance_draws_no_numbers():
    for fields, numbers in ((("crank_phase",), 2), (("crank_phase", "carrier_bore"), 6)):
        tolerances = for_design(STUDY.design, **dict.fromkeys(fields, Tolerance.symmetric(um)))
        assert Population.of(tolerances).numbers == numbers
