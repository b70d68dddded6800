"""Public functions that know no gears name the argument that is no number, no function or of another kind."""

import inspect

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import RVErrors, assembly, catalogue, compensation, designs, four_bar, identify, roots, tolerances
from rvjax.tolerances import ReciprocalPower, Requirement, Tolerance
from rvjax.units import um

PARTS = {"a": Tolerance.symmetric(10 * um), "b": Tolerance.symmetric(5 * um)}
NOISE, DATA = identify.Noise(1e-6), {"y": np.array([1e-6, 2e-6])}
FIRST = compensation.correction([1, 2], [1e-5, 2e-5j], ratio=81.0)
SLOTS = {"x": assembly.Kind([assembly.Part(1, {"a": 1e-6})])}
COST = ReciprocalPower(finest=1 * um, coarsest=100 * um)


def response(errors):
    return errors["a"]


CALLS = {  # function: arguments that are right; each is replaced in turn
    tolerances.worst_case: dict(response=response, tolerances=PARTS, refine=True),
    tolerances.rss: dict(response=response, tolerances=PARTS, order=1),
    tolerances.monte_carlo: dict(
        response=response, tolerances=PARTS, samples=9, seed=0, quantiles=(0.5,), confidence=0.95
    ),
    tolerances.sobol_indices: dict(response=response, tolerances=PARTS, samples=9, seed=0),
    tolerances.failure_probability: dict(response=response, tolerances=PARTS, requirement=None, samples=9, seed=0),
    tolerances.allocate: dict(
        response=response, tolerances=PARTS, requirements=None, costs=None, samples=100, seed=0, confidence=0.95,
        joint_target=0.9, grades=False,
    ),
    tolerances.cost_curve: dict(response=response, tolerances=PARTS, requirements=None, costs=None, values=(1.0,)),
    tolerances.it_width: dict(grade="IT6", size=0.02),
    tolerances.Middle: dict(lower=0.0, upper=1.0, scale=0.0),
    Tolerance.symmetric: dict(half_width=1e-6),
    identify.identifiability: dict(model=response, prior=PARTS, noise=NOISE, nuisance=()),
    identify.solve: dict(model=response, prior=PARTS, data=DATA, noise=NOISE, starts=1, confidence=0.95, nuisance=()),
    identify.solve_many: dict(model=response, prior=PARTS, data=DATA, noise=NOISE, chunk=2, confidence=0.9, shared=()),
    identify.predict: dict(posterior=object.__new__(identify.Posterior), response=response, draws=9, confidence=0.95),
    identify.orders: dict(angle=np.arange(9.0), value=np.arange(9.0), orders=[1.0, 2.0], drift=False),
    assembly.plan: dict(response=response, kinds=SLOTS, draws=2, seed=0),
    assembly.opening: dict(
        response=response, kinds=SLOTS, tolerances=PARTS, requirement=Requirement(upper=1.0), sets=3, seed=0
    ),
    assembly.believed: dict(value=1e-6, sd=1e-6, tolerance=PARTS["a"]),
    compensation.correction: dict(order=[1, 2], value=[1e-5, 2e-5], ratio=81.0, sd=1e-7, angle_sd=0.0, shrink=True),
    compensation.residual: dict(correction=FIRST, order=[1, 2], value=[1e-5, 2e-5], shift=0.0),
    compensation.phase_residual: dict(order=[1, 2], shift=0.1),
    compensation.predicted: dict(correction=FIRST, draws=9, confidence=0.95),
    compensation.table: dict(correction=FIRST, points=64),
    compensation.schedule: dict(corrections={(1.0, 1): FIRST}),
    roots.bracketed: dict(residual=response, params=0.5, lower=0.0, upper=1.0),
}  # fmt: skip
FREE = {"tolerances", "prior", "data", "requirements", "requirement", "costs"}  # of no declared kind
BAD = {"text": "0.3x", "object": object(), "complex": 0.3 + 1j, "complex of JAX": jnp.asarray(1j)}
COMPLEX = {"value"}  # amplitudes


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("function", CALLS, ids=lambda function: function.__qualname__)
def test_an_argument_of_another_kind_is_refused_by_name(function, bad):
    rights = CALLS[function]
    for name in rights.keys() - FREE:
        if ("complex" in bad and name in COMPLEX) or (bad == "text" and name in ("nuisance", "shared")):
            continue  # a name is text
        with pytest.raises(ValueError, match=rf"(^|\.){name}\b.*must (be|hold)|{name} = .*unknown") as error:
            function(**rights | {name: BAD[bad]})
        assert "\n" not in str(error.value) and len(str(error.value)) < 200


@pytest.mark.parametrize("function", CALLS, ids=lambda function: function.__qualname__)
def test_an_array_for_one_number_names_the_way_to_sweep(function):
    """`jax.vmap` is what a batch of cases needs."""
    for name, right in CALLS[function].items():
        if isinstance(right, float) and name not in COMPLEX | {"sd", "params"}:
            with pytest.raises(ValueError, match=rf"{name}\b.*one real number; sweep arrays with jax\.vmap$"):
                function(**CALLS[function] | {name: np.array([0.1, 0.2])})


@pytest.mark.parametrize(
    "bad", [0.3 + 1j, np.array(1j), jnp.asarray(1j), object(), {"q": 1}], ids=lambda bad: type(bad).__name__
)
def test_a_field_of_a_record_holds_real_numbers(bad):
    """Of a cost, a tolerance and a design: before, a complex number became part of the record."""
    for made in (
        lambda: COST.replace(scale=bad),
        lambda: Tolerance(lower=bad, upper=1.0),
        lambda: designs.CrankStage(count=2, circle_radius=bad),
    ):
        with pytest.raises(ValueError, match=r"\w+\.(scale|lower|circle_radius).*numbers? in"):
            made()


def test_every_listed_function_has_these_arguments():
    for function, rights in CALLS.items():
        assert rights.keys() <= inspect.signature(function).parameters.keys()


def test_sequences_of_every_kind_pass():
    """Lists, tuples and arrays for a sequence; `values` of a curve and `quantiles` of a sample."""
    for kind in (list, tuple, np.array):
        found = tolerances.monte_carlo(response, PARTS, samples=9, seed=0, quantiles=kind([0.25, 0.5]))
        assert list(found.quantiles) == [0.25, 0.5]
        assert len(identify.orders(np.arange(9.0), np.arange(9.0) ** 2, kind([1.0, 2.0])).value) == 2
        with pytest.raises(ValueError, match="requirements = None: must be a requirement"):  # the values have passed
            tolerances.cost_curve(response, PARTS, None, costs=None, values=kind([1.0, 2.0]))


LIMIT = tolerances.Requirement(upper=1.0)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: tolerances.monte_carlo(response, PARTS, LIMIT, samples=100), "requirements is"),
        (lambda: tolerances.monte_carlo(response, PARTS, {"": LIMIT}, samples=100, seed=0), "requirements is"),
        (lambda: tolerances.monte_carlo(response, PARTS, 100, 0), "samples and seed are"),
        (lambda: tolerances.rss(response, PARTS, LIMIT), "requirements is"),
        (lambda: tolerances.rss(response, PARTS, {("a", "b"): 0.5}), "correlation is"),
        (lambda: tolerances.rss(response, PARTS, 2, LIMIT), "order is"),
        (lambda: tolerances.allocate(response, PARTS, LIMIT, {"q": COST}), "costs is"),
        (lambda: tolerances.cost_curve(response, PARTS, LIMIT, {"q": COST}), "costs is"),
        (lambda: tolerances.failure_probability(response, PARTS, LIMIT, 1000, 0), "samples and seed are"),
        (lambda: tolerances.failure_probability(response, PARTS, LIMIT, 1000, seed=0), "samples is"),
        (lambda: tolerances.sobol_indices(response, PARTS, 1024, seed=0), "samples is"),
        (lambda: tolerances.worst_case(response, PARTS, False), "refine is"),
        (lambda: assembly.plan(response, {}, LIMIT), "requirement is"),
        (lambda: four_bar.transmission_error(catalogue.RV_40E, RVErrors(), 0.3), "crank_angle is"),
    ],
)
def test_an_argument_in_the_place_of_another_is_told_its_name(call, named):
    """Before, a requirement was checked as the number of samples; Python itself tells no name."""
    with pytest.raises(TypeError, match=rf"^\w+\.\w+: {named} keyword-only; write ") as error:
        call()
    assert "\n" not in str(error.value) and len(str(error.value)) < 200


def test_an_argument_that_fits_nowhere_or_has_a_wrong_name_is_told_the_others():
    with pytest.raises(
        TypeError, match=r"worst_case: Requirement\(.*one too many, .* response, tolerances; .*: refine"
    ):
        tolerances.worst_case(response, PARTS, LIMIT)
    with pytest.raises(TypeError, match=r"no argument 'requirement' \(did you mean requirements\?\)"):
        tolerances.monte_carlo(response, PARTS, samples=9, seed=0, requirement=LIMIT)
    assert tolerances.Tolerance.symmetric(1.0, distribution="uniform").distribution == "uniform"  # options of any name
