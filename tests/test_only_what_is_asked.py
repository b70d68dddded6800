"""What is not asked for is not computed: floating-point operations of the programs.

Oracle: XLA's own count (`cost_analysis`). It counts the body of a loop once, so programs of one kind are compared with
each other and no ratio is taken across different loops. Counts do not depend on the load of the machine.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Status, dynamics, four_bar, study
from rvjax.catalogue import RV_320E
from rvjax.population.population import Population
from rvjax.response.response import response_names
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.units import um

UNITS = 64
STUDY = study.load("rv-40e", solve=False)
CONDITIONS = replace(STUDY.conditions, angles=16)


def operations(function, *arguments, compiled=False):
    """Of the program as it is traced, where what nobody reads counts too, or as it runs."""
    lowered = jax.jit(function).lower(*arguments)
    return (lowered.compile() if compiled else lowered).cost_analysis()["flops"]


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


@pytest.mark.parametrize("closure", [None, pytest.param("first_order", marks=pytest.mark.long)])
def test_half_of_the_figures_of_a_turn_are_those_of_the_whole(closure):
    """To the rounding of another program; a unit whose shafts hold the discs far apart fails alike in both."""
    errors = STUDY.design.error_record().replace(bearing_clearance=5 * um)
    errors = jax.tree.map(lambda x: jnp.asarray(x, float), errors)
    turn = dict(angles=8, output_torque=412.0, closure=closure)
    whole, error, misfit = (four_bar.figures(STUDY.design, errors, only=o, **turn) for o in (None, "error", "misfit"))
    for name in ("maximum", "minimum", "peak_to_peak"):
        assert float(getattr(error, name)) == pytest.approx(float(getattr(whole, name)), rel=1e-12, abs=1e-18)
        assert np.isnan(getattr(misfit, name))
    assert float(misfit.largest_misfit) == pytest.approx(float(whole.largest_misfit), rel=1e-12, abs=1e-18)
    assert np.isnan(error.largest_misfit) and float(whole.peak_to_peak) > 0
    assert {int(found.info.status) for found in (whole, error, misfit)} == {Status.CONVERGED}
    nothing = errors.replace(crank_eccentricity=jnp.full_like(errors.crank_eccentricity, jnp.nan))
    for o in ("error", "misfit"):
        assert int(four_bar.figures(STUDY.design, nothing, only=o, **turn).info.status) == Status.NONFINITE
    with pytest.raises(ValueError, match="only = 'mean': must be one of error, misfit, or None for both"):
        four_bar.figures(STUDY.design, errors, only="mean")


def test_a_record_says_the_names_that_tracing_finds():
    response = STUDY.response()
    traced = jax.eval_shape(response, STUDY.design.error_record()).value
    assert response_names(response, Population.of(STUDY.tolerances)) == tuple(sorted(traced))


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
        half_widths = {name: jnp.asarray(5 * um) for name in names}
        return operations(jax.value_and_grad(program), half_widths, compiled=True)

    return count(("crank_phase",)), count(("crank_phase", "carrier_bore"))


@pytest.mark.long  # the test below counts the numbers drawn
def test_an_error_without_tolerance_costs_neither_draw_nor_derivative(sampled):
    one, two = sampled
    assert one < 0.75 * two


def test_an_error_without_tolerance_draws_no_numbers():
    for fields, numbers in ((("crank_phase",), 2), (("crank_phase", "carrier_bore"), 6)):
        tolerances = for_design(STUDY.design, **dict.fromkeys(fields, Tolerance.symmetric(um)))
        assert Population.of(tolerances).numbers == numbers
