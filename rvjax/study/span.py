"""Part of a turn of the output along which the value of a response is read: in words, and a whole turn in its place."""

import dataclasses
from collections.abc import Iterable

from rvjax import models
from rvjax.loaded import DriveConditions
from rvjax.records import Design

SPAN, WHOLE = "the span", "a turn of the output"  # in the meaning of an output; the longest span


def _turns(design: Design, conditions: object, name: str) -> float | None:
    curve = models.kind(design).described[name].curve
    return None if curve is None or curve.turns is None else curve.turns(design, conditions)


def span_of(design: Design, conditions: object, name: str) -> str:
    """Part of a turn of the output over which a response is read, in words; "" for a response of no curve.

    Args:
        design: the reducer.
        conditions: of the study.
        name: of the response.
    """
    turns = _turns(design, conditions, name)
    return "" if turns is None else WHOLE if turns == 1 else f"{360 * turns:.3g} deg of the output"


def spans_of(design: Design, conditions: object, names: Iterable[str]) -> dict[str, str]:
    """Span in words by response, of those whose value is read along a span.

    Args:
        design: the reducer.
        conditions: of the study.
        names: of responses.
    """
    known = models.kind(design).outputs
    found = {name: span_of(design, conditions, name) for name in names if SPAN in known[name].meaning}
    return {name: span for name, span in found.items() if span}


def over_a_turn(design: Design, conditions: DriveConditions, name: str, times: int = 1) -> DriveConditions:
    """Conditions of a whole turn of the output at angles as dense as the given ones, or `times` as dense.

    With one angle more, the angles of each crank turn differ, and no order of pins or holes looks like the mean.

    Args:
        design: the reducer.
        conditions: of the study.
        name: of a response in `spans_of`.
        times: angles over those of the study, in a part of a turn.
    """
    turns = _turns(design, conditions, name)
    assert turns is not None
    return dataclasses.replace(conditions, span="output_turn", samples=times * round(conditions.samples / turns) + 1)
