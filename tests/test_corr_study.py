"""The roller stage in a study: 26 independent rollers, peak cam force and contact pressure, the cheapest tolerances.

Oracles: the model itself for one unit, NumPy for the statistics of a batch, the study's own limits.
"""

import dataclasses

import jax
import numpy as np
import pytest

from rvjax import mesh_force, models, study
from rvjax.catalogue import CORR
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, allocate, for_design, monte_carlo, sample
from rvjax.units import um

CONDITIONS = models.kind(CORR).conditions(input_torque=109.56, contact="linear")


@pytest.fixture(scope="module")
def response():
    return Response.of(CORR, ("cam_force", "contact_pressure"), CONDITIONS)


@pytest.fixture(scope="module")
def tolerances():
    return for_design(
        CORR,
        cam_radius=Tolerance.symmetric(4 * um),
        eccentricity=Tolerance.symmetric(4 * um),
        roller_radius=Tolerance.symmetric(2 * um),
    )


@pytest.mark.long  # the study below draws every roller on its own
def test_monte_carlo_of_26_independent_rollers(response, tolerances):
    """Radius errors of single rollers raise the peak force of a unit over that of a unit without errors."""
    found = monte_carlo(response, tolerances, samples=1000, seed=1, chunk=1000, keep=True)
    errors = jax.jit(jax.vmap(lambda i: sample(tolerances, i, seed=1)))(np.arange(1000))
    assert np.unique(errors.roller_radius[3]).size == 26

    def cycle(errors):
        return mesh_force.cycle_statistics(CORR, errors, input_torque=109.56, contact="linear", samples=1)

    nothing = jax.tree.map(np.zeros_like, errors)
    both = jax.tree.map(lambda one, other: np.concatenate([one, other[:1]]), errors, nothing)
    alone = jax.jit(jax.vmap(cycle))(both)
    for name, field in (("cam_force", "cam_peak"), ("contact_pressure", "pressure_peak")):
        values, nominal = np.split(np.asarray(getattr(alone, field)), [1000])
        np.testing.assert_allclose(found.values[name], values, rtol=1e-12)
        assert found.mean[name].value == pytest.approx(float(np.mean(values)), rel=1e-12)
        assert found.mean[name].value > 1.1 * nominal[0]
    assert found.failed == 0


@pytest.mark.long  # test_check.py has its response
def test_the_embedded_study_finds_cheaper_tolerances():
    """Small: linear contacts and few units; the requirement is the peak cam force."""
    whole = study.load("corr", solve=False)
    assert "corr" in study.embedded_names() and whole.conditions.contact == "palmgren"
    assert whole.tolerances.roller_radius.shape == (26,)
    fewer = whole.text.replace('base = "corr"', 'base = "corr"\ngear_teeth = 3')  # 26 rollers compile for 16 s
    assert fewer != whole.text
    question = study.parse_study(fewer, name="fewer", solve=False)
    assert question.tolerances.roller_radius.shape == (4,)
    question = dataclasses.replace(question, conditions=dataclasses.replace(whole.conditions, contact="linear"))
    limit = {"cam_force": dataclasses.replace(whole.requirements["cam_force"], upper=18.6e3, target=0.95)}
    response = Response.of(question.design, ("cam_force",), question.conditions)
    found = allocate(
        response, question.tolerances, limit, costs=question.costs, samples=1024, seed=0, certificate_samples=4096
    )
    assert found.status == "OPTIMAL" and found.cost < 0.8 * found.start_cost
    assert found.certificate.yield_["cam_force"].lower >= 0.95
    assert found.multipliers["cam_force"] < 0


def test_fields_of_the_stage_can_be_changed():
    changed = 'base = "corr"\ngear_teeth = 3\nroller_length = "14 mm"'
    text = study.load("corr", solve=False).text.replace('base = "corr"', changed)
    assert study.parse_study(text, name="x", solve=False).design.roller_length == pytest.approx(0.014)
    with pytest.raises(study.StudyError, match=r"design.roller_length = '14 N'.*m"):
        study.parse_study(text.replace("14 mm", "14 N"), name="x")
    with pytest.raises(study.StudyError, match="UNDERCUT"):
        study.parse_study(
            text.replace('roller_length = "14 mm"', 'roller_radius = "60 mm"\neccentricity = "90 mm"'), name="x"
        )
