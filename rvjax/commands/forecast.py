"""Forecast of a computation: levels, phases, seconds."""

from rvjax import levels
from rvjax.commands.allocate import CERTIFYING, PRICING, SAMPLING, SEARCHING, solved_units
from rvjax.levels import Choice
from rvjax.progress import spelled
from rvjax.study import Study

CHUNK = 32_768  # units at once


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
        error = "" if choice.bound is None else f"error < {choice.bound / size:.2g} {unit}; "
        lines.append(f"{name}: {choice.level} ({error}{choice.why})")
    return lines


def expected(study: Study) -> str:
    """Time and memory of an allocation, from the measured time of a unit, in words."""
    unit = unit_seconds(study)
    if unit is None:
        return "time: unknown, these levels are not measured"
    return (
        f"time: about {spelled(unit * sum(solved_units(study).values()))} of computation on the two cores of the "
        "measured table, besides tracing and compilation (20 s for an RV-40E, 45 s at the first run); "
        f"chunks of {CHUNK:,} units, memory does not grow with their number"
    )


def phases_of(study: Study, before: str, *after: str) -> dict[str, float]:
    """Seconds of each phase of a run, on the computer of the measured table, including compilation."""
    unit, compiling = unit_seconds(study) or 0.0, {SEARCHING: 20.0, CERTIFYING: 1.0, SAMPLING: 16.0, PRICING: 12.0}
    spent = {phase: compiling[phase] + unit * units for phase, units in solved_units(study).items()}
    return {before: 6.0} | spent | dict.fromkeys(after, 10.0)


def unit_seconds(study: Study) -> float | None:
    """Time of one unit on two cores, or None where a level was never measured."""
    found = [choice.ns for choice in choices(study).values()]
    return None if None in found else 1e-9 * sum(ns for ns in found if ns is not None)
