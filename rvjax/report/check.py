"""What can be said of a study before anything is computed: is it the reducer that was meant, how long will it take?"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from rvjax import levels, models
from rvjax.designs import CamRollerReducer, InvoluteStage, RVReducer
from rvjax.levels import Choice
from rvjax.progress import spelled
from rvjax.report.text import assumed_text, limits, plain, table, tolerance_text
from rvjax.study.answer import CERTIFYING, PRICING, SAMPLING, SEARCHING, solved_units
from rvjax.study.plausible import KNOWN_DESIGNS, TORQUE, numbers, shown
from rvjax.study.question import Study

CHUNK = 32_768  # units at once


def choices(question: Study) -> dict[str, Choice]:
    """How each response will be computed: as the accuracy asks, else as the conditions say."""
    outputs = tuple(question.requirements)
    given = levels.as_given(question.design, outputs, question.conditions, tolerances=question.tolerances)
    return given | question.choices()


def level_lines(question: Study) -> list[str]:
    """One line for each response: its level, that level's error, and why."""
    lines = []
    for name, choice in choices(question).items():
        unit, size = question.output(name).shown
        error = "" if choice.bound is None else f"error < {choice.bound / size:.2g} {unit}; "
        lines.append(f"{name}: {choice.level} ({error}{choice.why})")
    return lines


def checked(question: Study) -> str:
    """Facts of the design, magnitudes beside known reducers, play, levels, and the time it will take, as text."""
    lines = [f"Study {question.name}: {type(question.design).__name__}", *filter(None, [question.about.line()]), ""]
    lines += [f"{name:32} {value}" for name, value in facts(question.design)]
    lines += ["", table(["number", "this study", "known reducers"], _magnitudes(question))]
    lines += ["", table(["error", "limits", "law"], _tolerances(question)), "", "How it will be computed:"]
    lines += [f"  {line}" for line in [*level_lines(question), expected(question)]]
    lines += ["", f"Assumed, for nobody printed them: {assumed_text(question)}"] if question.assumed else []
    lines += ["", "Not in the models asked:", *(f"  {line}" for line in question.left_out)]
    doubts = question.doubts
    return "\n".join([*lines, "", *(f"doubtful: {line}" for line in doubts), *([] if doubts else ["No doubts."])])


def as_json(question: Study) -> dict[str, Any]:
    """The same as `checked` as JSON values; numbers are SI with their unit beside them."""
    stated = {name: {"value": value, "unit": unit} for name, (value, unit) in numbers(question.design)}
    levels_ = {
        name: {"level": choice.level, "error": choice.bound, "unit": question.output(name).unit, "why": choice.why}
        for name, choice in choices(question).items()
    }
    return plain(
        {
            "study": question.name,
            "about": question.about,
            "design": type(question.design).__name__,
            "facts": dict(facts(question.design)),
            "numbers": stated,
            "conditions": dataclasses.asdict(question.conditions),
            "tolerances": {
                field: {"unit": question.unit(field)} | limits(getattr(question.tolerances, field))
                for field in question.fields
            },
            "levels": levels_,
            "time": expected(question),
            "left_out": question.left_out,
            "doubts": question.doubts,
        }
    )


def facts(design: Any) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design; nothing for a kind that is not in the catalogue."""
    if isinstance(design, CamRollerReducer):
        yield "rollers", str(design.gear_teeth + 1)
    if not isinstance(design, RVReducer):
        return
    cycloid, stage = design.cycloid, design.involute
    gap = 2 * (cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count) - cycloid.pin_radius)
    least = least_curvature_radius(cycloid.shortening_coefficient, cycloid.pin_count) * cycloid.pin_circle_radius
    yield "ratio", f"{design.ratio:.6g}"
    yield "K1", f"{float(cycloid.shortening_coefficient):.4g}"
    yield "gap between pins", shown(gap, "m")
    sharp = "undercut" if cycloid.pin_radius >= least else "no undercut"
    yield (
        "largest pin without undercut",
        f"{shown(least, 'm')} radius; the pins have {shown(cycloid.pin_radius, 'm')}: {sharp}",
    )
    yield "contact ratio of the gears", f"{contact_ratio(stage):.3g} (teeth without shift)"


def least_curvature_radius(shortening: float, pins: int) -> float:
    """Least radius of convex curvature of the pins' path around a disc, in pin circle radii.

    The path is an epitrochoid of curvature (K1 (zp + 1) c - 1 - zp K1^2)/(1 + K1^2 - 2 K1 c)^(3/2), c the cosine of the
    pin's angle from the eccentric; a disc is the path offset by the pin radius, so that its flank has a cusp where the
    pin is larger than the radius of the path on the side of the disc.

    Args:
        shortening: K1.
        pins: zp.
    """
    c = np.linspace(-1.0, 1.0, 4001)
    bend = 1 + pins * shortening**2 - shortening * (pins + 1) * c  # > 0: convex, seen from the disc
    radius = (1 + shortening**2 - 2 * shortening * c) ** 1.5 / np.where(bend > 0, bend, np.nan)
    return float(np.nanmin(radius))


def contact_ratio(stage: InvoluteStage) -> float:
    """Transverse contact ratio of sun and planet at their centre distance, with tips of standard height."""
    bases = float(stage.sun_base_radius), float(stage.planet_base_radius)
    working = math.acos(min(1.0, sum(bases) / float(stage.centre_distance)))
    tips = (float(stage.module) * (teeth + 2) / 2 for teeth in (stage.sun_teeth, stage.planet_teeth))
    path = sum(math.sqrt(max(0.0, tip**2 - base**2)) for tip, base in zip(tips, bases))
    pitch = float(stage.module) * math.pi * math.cos(float(stage.pressure_angle))
    return (path - float(stage.centre_distance) * math.sin(working)) / pitch


def expected(question: Study) -> str:
    """Time and memory of an allocation, from the measured time of a unit, in words."""
    unit = unit_seconds(question)
    if unit is None:
        return "time: unknown, for nobody has measured these levels"
    return (
        f"time: about {spelled(unit * sum(solved_units(question).values()))} of computation on the two cores of the "
        "measured table, besides tracing and compilation (20 s for an RV-40E, 45 s at the first run); "
        f"chunks of {CHUNK:,} units, memory does not grow with their number"
    )


def phases_of(question: Study, before: str, *after: str) -> dict[str, float]:
    """Seconds of each phase of an answer, on the machine of the measured table, its compilation included."""
    unit, compiling = unit_seconds(question) or 0.0, {SEARCHING: 20.0, CERTIFYING: 1.0, SAMPLING: 16.0, PRICING: 12.0}
    spent = {phase: compiling[phase] + unit * units for phase, units in solved_units(question).items()}
    return {before: 6.0} | spent | dict.fromkeys(after, 10.0)


def unit_seconds(question: Study) -> float | None:
    """Time of one unit on two cores, or None where a level was never measured."""
    found = [choice.ns for choice in choices(question).values()]
    return None if None in found else 1e-9 * sum(ns for ns in found if ns is not None)


def drawn(question: Study, path: str) -> None:
    """Draw the reducer to scale.

    Raises:
        ValueError: nothing draws this kind of reducer.
    """
    from matplotlib.figure import Figure

    from rvjax.plotting import drawings

    if not isinstance(question.design, RVReducer):
        raise ValueError(f"--picture {path}: only RV reducers are drawn, not a {type(question.design).__name__}")
    figure = Figure(figsize=(7, 7), layout="constrained")
    drawings.reducer(question.design, axes=figure.add_subplot())
    figure.savefig(path, dpi=120)


def _magnitudes(question: Study) -> list[list[str]]:
    known = [dict(numbers(one)) for one in KNOWN_DESIGNS if type(one) is type(question.design)]
    rows = []
    for name, (value, unit) in numbers(question.design):
        seen = [one[name][0] for one in known if name in one]
        rows.append(
            [name, shown(value, unit), f"{shown(min(seen), unit)} to {shown(max(seen), unit)}" if seen else "-"]
        )
    kind = models.kind(question.design)
    for f in dataclasses.fields(kind.conditions):
        value = getattr(question.conditions, f.name)
        if f.name in kind.conditions_of(tuple(question.requirements)) and value is not None:
            number = shown(value, f.metadata["unit"]) if isinstance(value, float) else str(value)
            rows.append(
                [f"conditions.{f.name}", number, f"up to {shown(TORQUE[1], 'N m')}" if _rated(question, f) else "-"]
            )
    return rows


def _rated(question: Study, condition: dataclasses.Field[object]) -> bool:
    return bool(condition.metadata["torque"]) and isinstance(question.design, RVReducer)


def _tolerances(question: Study) -> list[list[str]]:
    rows = []
    for field in question.fields:
        tolerance = getattr(question.tolerances, field)
        rows.append([field, tolerance_text(tolerance, question.unit(field)), tolerance.distribution])
    return rows
