"""Forecast of a computation: warnings, levels, seconds of a unit."""

import dataclasses
import sys
from typing import Any

from rvjax import levels
from rvjax.commands.speak import say
from rvjax.levels import Choice
from rvjax.study import Study
from rvjax.units import with_unit


def choices(study: Study) -> dict[str, Choice]:
    """Level of each response: selected by its accuracy, else by the conditions."""
    outputs = tuple(study.requirements)
    given = levels.as_given(study.design, outputs, study.conditions, tolerances=study.tolerances)
    return given | study.choices()


def level_lines(study: Study) -> list[str]:
    """One line for each response: its level, that level's error, and why."""
    lines = []
    for name, choice in choices(study).items():
        unit, size = study.output(name).shown
        error = "" if choice.bound is None else f"error < {with_unit(choice.bound / size, unit, '.2g')}; "
        lines.append(f"{name}: {choice.level} ({error}{choice.why})")
    return lines


def unit_seconds(study: Study) -> float | None:
    """Time of one unit on two cores, or None where a level was never measured."""
    found, results = 0.0, dict[tuple[Any, Any], None]()  # several outputs read one result
    for name, choice in choices(study).items():
        if sources := levels.sources_of(study.design, choice.instead or name):
            given = dataclasses.replace(study.conditions, **dict(choice.settings))
            results |= dict.fromkeys((source, given) for source in sources)
        elif choice.ns is None:
            return None
        else:
            found += 1e-9 * choice.ns
    solved = levels.seconds(study.design, results)
    return None if solved is None else found + solved


def forewarn(study: Study, time: str = "") -> None:
    """Print warnings on input values, and the level of each response with an accuracy, before any work.

    Args:
        study: as read.
        time: expected time of the command, shown next to the levels; "" for none.
    """
    for line in study.doubts:
        say(f"rvjax: warning: {line}", file=sys.stderr)
    if study.accuracy:
        for line in filter(None, [*level_lines(study), time]):
            say(f"rvjax: {line}", file=sys.stderr)
