"""Outputs, coordinates and errors that a study does not require: no part of its result, and no cause of a failure.

Oracle: NaN. What is computed from it is NaN or fails, so a result that stays finite does not depend on it.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Status, dynamics, four_bar, study
from rvjax.catalogue import RV_320E
from rvjax.errors import RVErrors, read_by
from rvjax.population.population import Population
from rvjax.response.response import response_names
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.units import um

STUDY = study.load("rv-40e", solve=False)
CONDITIONS = replace(STUDY.conditions, angles=8, closure="first_order")  # which closure decides nothing here
MODEL = dict(transmission_error="four_bar", misfit="four_bar", lost_motion="lost_motion")


@cache
def program(outputs):
    return jax.jit(Response.of(STUDY.design, outputs, CONDITIONS))


def outcome(outputs, errors):
    return program(outputs)(errors)


@pytest.fixture(scope="module")
def unit():
    """One unit with the errors of the study, and its outcome of all outputs."""
    errors = jax.tree.map(lambda x: np.asarray(x, float), jax.jit(lambda n: sample(STUDY.tolerances, n, seed=0))(1))
    return errors, outcome(tuple(MODEL), errors)


@pytest.mark.parametrize("name", MODEL)
def test_errors_of_another_model_cannot_change_or_fail_an_output(unit, name):
    errors, everything = unit
    assert set(MODEL) == set(STUDY.requirements) and int(everything.status) == Status.CONVERGED
    unread = [field for field in vars(errors) if field not in read_by(RVErrors, MODEL[name])]
    broken = errors.replace(**{field: np.full_like(getattr(errors, field), np.nan) for field in unread})
    found = outcome((name,), broken)
    assert set(found.value) == {name} and int(found.status) == Status.CONVERGED
    assert float(found.value[name]) == pytest.approx(float(everything.value[name]), rel=1e-12)
    assert int(outcome(tuple(MODEL), broken).status) == Status.NONFINITE


@pytest.mark.long  # outputs of a study alone, above, are these figures
@pytest.mark.parametrize("closure", ["first_order", None])
def test_error_alone_and_misfit_alone_equal_both_together(closure):
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


def test_what_cannot_be_asked_alone_is_refused():
    with pytest.raises(ValueError, match="only = 'mean': must be None for both, or one of error, misfit"):
        four_bar.figures(STUDY.design, STUDY.design.error_record(), only="mean")


def test_the_names_of_a_response_are_those_of_its_values():
    response = replace(STUDY, conditions=CONDITIONS).response()
    traced = jax.eval_shape(response, STUDY.design.error_record()).value
    assert response_names(response, Population.of(STUDY.tolerances)) == tuple(sorted(traced))


SPIN = dict(sun_speed=150.0, output_torque=-3136.0, harmonics=4)


@pytest.mark.long  # the rotation alone is that of all outputs, and sensitivities are as zero, in tests of the dynamics
def test_rotation_of_the_output_does_not_depend_on_radial_supports():
    """By symmetry the mesh variation turns the output and pushes it nowhere: only the rotational block is solved."""

    def rotation(sun_support):
        design = RV_320E.replace(stiffness=RV_320E.stiffness.replace(sun_support=sun_support))
        found = dynamics.response(design, outputs=("output.rotation",), **SPIN)
        return jnp.sum(jnp.abs(found.amplitude))

    support = jnp.asarray(RV_320E.stiffness.sun_support, float)
    value, slope = jax.jit(jax.value_and_grad(rotation))(support)
    assert float(value) > 0 and float(slope) == 0
    everything = dynamics.assemble(RV_320E).labels
    every = dynamics.response(RV_320E, outputs=everything, **SPIN).amplitude
    own = np.abs(np.asarray(every)[:, everything.index("output.rotation")]).sum()
    assert float(value) == pytest.approx(own, rel=1e-9)


def test_an_error_without_tolerance_draws_no_numbers():
    for fields, numbers in ((("crank_phase",), 2), (("crank_phase", "carrier_bore"), 6)):
        tolerances = for_design(STUDY.design, **dict.fromkeys(fields, Tolerance.symmetric(um)))
        assert Population.of(tolerances).numbers == numbers
        drawn = sample(tolerances, 3, seed=0)
        assert {name for name, value in vars(drawn).items() if np.any(value)} == set(fields)
