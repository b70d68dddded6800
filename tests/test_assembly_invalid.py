"""What assembly refuses, in one line."""

import math

import pytest
from assembly_cases import UNIT, kind, square

from rvjax.assembly import Kind, Part, believed, opening, plan
from rvjax.tolerances import Requirement

ONE = kind([1.0, 2.0])


BAD = [
    (lambda: Kind([Part("a", 1.0), Part("a", 2.0)]), "part 'a': duplicate id"),
    (lambda: Kind([]), "parts: must hold"),
    (lambda: kind([1.0], indices=0), "indices = 0: must be a whole number of at least 1"),
    (lambda: kind([1.0], indices=1.5), "indices = 1.5: must be a whole number of at least 1"),
    (lambda: kind([1.0], stock=[1, 2]), "stock: 2 numbers for 1 parts"),
    (lambda: kind([1.0], stock=[-1]), "stock = -1 of part 'p0': must be a whole number, 0 or more"),
    (lambda: kind([1.0], stock=[0]), "stock: must hold"),
    (lambda: Part("a", {"x": math.nan}), "part 'a': x = nan: must be finite"),
    (lambda: Part("a", {"x": 1.0}, -1e-6), "part 'a': sd of x = -1e-06: must be zero or positive"),
    (lambda: Part("a", {"x": 1.0}, {"x": math.nan}), "part 'a': sd of x = nan: must be zero or positive"),
    (lambda: Part("a", {}), "part 'a': errors = {}: holds no number"),
    (lambda: plan(square, {"a": ONE}), "kinds: 1 slots, must be at least 2"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, objective="best"), "objective = 'best': must be one of mean, bott"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, objective="yield"), "requirement = None: objective 'yield' needs"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, draws=0), "draws = 0: must be a whole number of at least 1"),
    (lambda: plan(square, {"a": ONE, "b": ONE}, confidence=1.0), "confidence = 1.0: must lie between 0 and 1"),
    (
        lambda: plan(square, {s: kind([1.0] * 300) for s in "abc"}),
        "300 x 300 x 300 combinations are more than 16777216",
    ),
    (
        lambda: plan(square, {"a": Kind([Part(0, 1.0), Part(1, {"x": 1.0})]), "b": ONE}),
        "a: the errors of part 1 must have",
    ),
    (lambda: believed(math.nan, 0.1, UNIT), "value = nan: must be finite"),
    (lambda: believed(1.0, -0.1, UNIT), "sd = -0.1: must be zero or positive"),
    (
        lambda: opening(square, {"a": ONE, "b": ONE}, {"y": UNIT}, requirement=Requirement(upper=1.0)),
        "tolerances: must hold a Tolerance",
    ),
]


@pytest.mark.parametrize(("call", "message"), BAD, ids=lambda item: item if isinstance(item, str) else "")
def test_bad_input_is_one_line(call, message):
    with pytest.raises(ValueError, match=r".*") as error:
        call()
    assert message in str(error.value) and "\n" not in str(error.value)
