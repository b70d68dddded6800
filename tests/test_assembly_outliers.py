"""Parts that a slip of units or of the sign has made: by their limits and by their lot, and lots that have none."""

import warnings

import numpy as np
import pytest
from assembly_cases import UNIT, kind, measured, square

from rvjax.assembly import Kind, Part, UnusualPart, outliers, plan
from rvjax.tolerances import Tolerance

LOT = np.array([0.1, -0.4, 0.3, 0.0, -0.2, 0.5, -0.1, 0.2, -0.3, 0.4])


def changed(place, value, lot=LOT):
    return np.where(np.arange(len(lot)) == place, value, lot)


@pytest.mark.parametrize(
    ("lot", "population", "expected"),
    [
        (changed(3, 400.0), UNIT, ("p3", 400 / 3, "half-widths")),  # UNIT has the limits -3 and 3
        (changed(3, -9.5), UNIT, ("p3", 9.5 / 3, "half-widths")),
        (changed(3, 8.0), UNIT, ("p3", None, "standard deviations of the lot")),  # beyond the limits, and the lot
        (changed(3, 8.0), None, ("p3", None, "standard deviations of the lot")),
        (changed(3, 25.4 * 0.4), None, ("p3", None, "standard deviations of the lot")),
        (2.5 + changed(3, -2 * 2.5 - 0.2, LOT / 10), UNIT, ("p3", None, "standard deviations of the lot")),  # its sign
        (2.5 + changed(3, -1.5, LOT / 10), UNIT, None),  # within the limits: a good part
        (changed(3, 2.9), UNIT, None),
        (np.concatenate([LOT, LOT + 0.05, LOT[:6] + 50]), None, None),  # two lots
        (np.array([0.0] * 9 + [1.0]), None, None),  # readings of a dial
        (changed(3, 8.0)[:5], None, None),  # five parts show no spread
    ],
)
def test_what_lies_beyond_limits_or_lot(lot, population, expected):
    parts = Kind(
        [Part(f"p{i}", {"x": float(x)}) for i, x in enumerate(lot)], population=population and {"x": population}
    )
    found = outliers(parts)
    assert len(found) == (expected is not None)
    if expected is not None:
        id, away, measure = expected
        assert found[0].id == id and found[0].name == "x" and found[0].measure.startswith(measure)
        assert away is None or found[0].away == pytest.approx(away)


def test_the_furthest_comes_first_and_a_gauge_is_allowed_for():
    """Two slips, elements by place; four standard deviations of a gauge are no slip, nor is an unmeasured value."""
    values = np.tile(LOT[:, None], 2)
    values[2, 1], values[5, 0] = 40.0, -70.0
    population = {"x": Tolerance(-3.0, 3.0, shape=(2,))}
    parts = [Part(i, {"x": row}) for i, row in enumerate(values)]
    found = outliers(Kind(parts, population=population))
    assert [(one.id, one.name, one.value) for one in found] == [(5, "x[0]", -70.0), (2, "x[1]", 40.0)]
    assert (
        outliers(Kind([Part(p.id, p.errors, {"x": np.array([20.0, 12.0])}) for p in parts], population=population))
        == ()
    )
    unseen = [Part(p.id, p.errors, {"x": np.array([np.inf, 0.0])}) for p in parts]
    assert [one.id for one in outliers(Kind(unseen, population=population))] == [2]
    vectors = {"x": Tolerance(0.0, 3.0, distribution="rayleigh", shape=(2,))}
    edge = [Part(i, {"x": np.array([-3.4, 0.0])}) for i in range(4)]
    assert outliers(Kind(edge, population=vectors)) == ()  # both sides of zero


def test_a_plan_warns_of_the_part_and_not_of_a_usual_lot():
    with pytest.warns(UnusualPart, match="^a: part 'p3': x = 400 lies 899 standard deviations of the lot"):
        plan(square, {"a": kind(changed(3, 400.0)), "b": kind(LOT)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan(square, {"a": measured(LOT, 0 * LOT, 0.1), "b": kind(LOT)}, certificate_draws=4, draws=2)
