"""An identification in words: combinations with what else is in them, and doubts beside the result."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rvjax import catalogue
from rvjax.commands.identify.identified import Identified
from rvjax.commands.identify.tables import _elements_plotted
from rvjax.commands.identify.words import combinations, doubts
from rvjax.identify import Direction
from rvjax.identify.elements import Elements
from rvjax.tolerances import Tolerance
from rvjax.units import um

STUDY = SimpleNamespace(design=catalogue.CYCLOIDAL_17, name="unit", text="", seed=0)
PRIOR = {  # standard deviations 10 and 5 um
    "disc_centre": Tolerance(0.0, 30 * um, distribution="rayleigh", shape=(2, 2)),
    "hole_position": Tolerance(0.0, 15 * um, distribution="rayleigh", shape=(2, 6, 2)),
}
CENTRE = {"disc_centre[0,0]": math.sqrt(0.35), "disc_centre[1,0]": -math.sqrt(0.35)}
HOLES = {f"hole_position[{i},{j},0]": math.sqrt(0.3 / 12) for i in range(2) for j in range(6)}


def seen(loadings, **others):
    """An identification with one combination, known to a tenth."""
    check = SimpleNamespace(directions=(Direction(99.0, loadings),))
    return SimpleNamespace(study=STUDY, problem=SimpleNamespace(prior=PRIOR), check=check, **others)


def posterior(values, sd, covariance):
    """Of the named elements, their standard deviations, and the covariance of standard numbers."""
    arrays = [{name: np.zeros(tolerance.shape) for name, tolerance in PRIOR.items()} for _ in range(3)]
    for (name, value), own in zip(values.items(), sd):
        field, place = name[:-1].split("[")
        for array, number in zip(arrays, (value, value - 1.96 * own, value + 1.96 * own)):
            array[field][tuple(map(int, place.split(",")))] = number
    value, lower, upper = arrays
    return SimpleNamespace(
        names=tuple(values), u_sd=np.sqrt(np.diag(covariance)), u_covariance=covariance,
        value=value, lower=lower, upper=upper,
    )  # fmt: skip


def test_a_combination_names_what_else_is_in_it_its_value_and_interval():
    """Sum of two normal numbers with correlation -0.6: variance 8^2 + 8^2 + 2 * 0.6 * 8 * 8 for the difference."""
    found = posterior(
        {"disc_centre[0,0]": 7.1 * um, "disc_centre[1,0]": -3.1 * um},
        [8 * um, 8 * um],
        np.array([[0.64, -0.384], [-0.384, 0.64]]),
    )
    (one,) = combinations(seen(CENTRE | HOLES, posterior=found))
    half = 1.96 * math.sqrt(3.2) * 8 * um
    assert one.terms == {"disc_centre[0,0]": 1.0, "disc_centre[1,0]": -1.0}
    assert one.rest == {"hole_position": pytest.approx(0.3)}
    assert one.value.value == pytest.approx(10.2 * um)
    assert (one.value.lower, one.value.upper) == pytest.approx((10.2 * um - half, 10.2 * um + half))
    assert one.text() == (
        "disc centre [0,0] - [1,0] = 10.2 um [-17.85, 38.25] with hole position 30 % of its square: "
        "to 10 % of the range of the drawing"
    )


def test_factors_are_those_of_the_sum_and_not_of_standard_deviations():
    """A number of half the spread counts twice in micrometres; of many elements only fields are named."""
    loadings = {"disc_centre[0,0]": math.sqrt(0.5), "hole_position[0,0,0]": math.sqrt(0.5)}
    (one,) = combinations(seen(loadings, posterior=None))
    assert one.text() == "0.5 disc centre [0,0] + 1 hole position [0,0,0]: to 10 % of the range of the drawing"
    (many,) = combinations(seen({name: size / math.sqrt(0.3) for name, size in HOLES.items()}, posterior=None))
    assert many.text() == "hole position 100 % of its square: to 10 % of the range of the drawing"


def test_several_solutions_and_intervals_that_do_not_hold_stand_beside_the_result():
    modes = [SimpleNamespace(weight=weight) for weight in (0.62, 0.375, 0.005)]
    laplace = SimpleNamespace(pareto_k=7.9)
    found = SimpleNamespace(modes=modes, laplace=laplace)
    lines = doubts(SimpleNamespace(posterior=found, draws=None))
    assert lines == [
        "warning: 2 solutions explain the data, with the probabilities 62 %, 37.5 %: values and intervals are those of "
        "the first; run again with --sample",
        "warning: Pareto k = 7.9, above 0.7: the intervals do not hold; run again with --sample",
    ]
    good = SimpleNamespace(modes=modes[:1], laplace=SimpleNamespace(pareto_k=0.7))
    assert doubts(SimpleNamespace(posterior=good, draws=None)) == []
    for status, fine in (("MULTIMODAL", False), ("CONVERGED", True)):
        assert Identified(None, None, posterior=SimpleNamespace(status=status)).converged is fine


def test_components_of_a_vector_are_plotted_between_both_signs_of_its_length():
    """Normal components, sd a third of the limit: 95 % of the drawing reach 0.653 of it to both sides."""
    held = Elements.of(PRIOR)
    zero, some = ({name: np.full(t.shape, size) for name, t in PRIOR.items()} for size in (0.0, 3 * um))
    found = SimpleNamespace(
        posterior=SimpleNamespace(
            problem=SimpleNamespace(elements=held), value=zero, lower={n: -x for n, x in some.items()}, upper=some
        ),
        problem=SimpleNamespace(prior=PRIOR, nuisance=()),
        check=SimpleNamespace(resolution=dict.fromkeys(held.names, 0.0), verdict=dict.fromkeys(held.names, "unseen")),
    )
    bars = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in _elements_plotted(found).patches if bar.get_width()]
    reach = 1.959964 / 3
    assert bars[0] == pytest.approx((-reach, reach), rel=1e-6)
    assert {round(high, 6) for _, high in bars} == {round(reach, 6), 0.1, 0.2}  # 3 um of 30 and of 15
