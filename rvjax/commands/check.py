"""`rvjax check`: the values that follow from a study, before anything is computed."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from rvjax import models, study
from rvjax.base.progress import begin
from rvjax.commands import READING, Inputs, option, study_argument, switch
from rvjax.commands.cells import assumed_text, condition_text, limit_text, limits_data, limits_of
from rvjax.commands.forecast import choices, doubts_of_unit, expected, level_lines, missed_at_mid_points
from rvjax.levels import Choice
from rvjax.loaded import DriveConditions
from rvjax.outputs import Output
from rvjax.population import Population, root_key
from rvjax.render import Figure, Limits, Note, Number, Report, Table, Text
from rvjax.response import respond_units
from rvjax.status import SUCCESS, Status, worst
from rvjax.study import (
    KINDS,
    Response,
    Study,
    facts_of,
    kind_of,
    mid_points,
    number_at,
    numbers,
    outcome_of,
    shown,
)


@dataclass(kw_only=True)
class CheckInputs(Inputs):
    """Print within seconds what follows from a study: ratio, K1, pin gaps, undercut, contact ratio, values compared
    with known reducers, limits, levels and run time, and warnings for probable input errors.

    examples:
      rvjax check mine.toml
      rvjax check mine.toml --picture mine.png
      rvjax check mine.toml --turn

    Impossible values (overlapping pins, a negative clearance) are bad input, exit code 2. Values far from all known
    reducers give a line that begins with "warning", exit code 0.
    """

    source: str = study_argument(": rv-40e-whole (default), rv-40e, corr", default="rv-40e-whole")
    picture: Path | None = option("draw the reducer to scale (default: none)", "FILE.png", type=Path, ends=".png")
    turn: bool = switch(
        "measure eight units over a whole turn of the output at four times the angles: how much larger are the "
        "values that are limited along a span?"
    )

    def __post_init__(self) -> None:
        """Read the study; a drawing needs a kind of reducer that has one."""
        self.study = study.load(self.source, solve=False)
        self.phases = (READING, SOLVING, *([TURNING] if self.turn else []))
        if self.picture and kind_of(self.study.design).drawing is None:
            able = " and ".join(kind.plural for kind in KINDS.values() if kind.drawing)
            raise ValueError(f"--picture {self.picture}: plots {able} only, not a {type(self.study.design).__name__}")


@dataclasses.dataclass(frozen=True)
class Checked:
    """Derived values of a study.

    Attributes:
        facts: (name, value) of what follows from the design.
        magnitudes: (number, value, range of known reducers or None), as text in suited units.
        levels: of each response.
        values: required outputs of the unit at the mid-points of all tolerances, SI.
        status: of this unit.
        turning: lines on the share that jams; of drives.
        remedies: text on an assumed number, by limit that this unit misses.
        larger: values over a whole turn over those of the study, of some units, by response; empty unless measured.
    """

    facts: list[tuple[str, str]]
    magnitudes: list[tuple[str, str, str | None]]
    levels: dict[str, Choice]
    values: dict[str, float]
    status: Status
    turning: list[str]
    remedies: dict[str, str]
    larger: dict[str, list[float]]


SOLVING, TURNING = "unit at the mid-points", "a turn of the output"
TURNED, FINER = 8, 4  # units over a whole turn; their angles over those of the study
FIT, TRIED = "fit_clearance", 1024  # output below which a unit jams; units for its share


def compute(inputs: CheckInputs) -> Checked:
    """Compute the derived values of a study."""
    study = inputs.study
    begin(SOLVING)
    values, status = study.at_mid_points(study.further) if study.requirements else ({}, Status.CONVERGED)
    if status not in SUCCESS and study.further:  # perhaps of an output without a limit
        values, status = study.at_mid_points()
    facts, turning = list(facts_of(study.design)), _turning(study)
    missed = missed_at_mid_points(study, values) if status in SUCCESS else {}
    remedies = {name: text for name in missed if (text := _remedy(study, name, values))}
    if inputs.turn:
        begin(TURNING)
    larger = _over_a_turn(study) if inputs.turn else {}
    return Checked(facts, _magnitudes(study), choices(study), values, status, turning, remedies, larger)


def _over_a_turn(study: Study) -> dict[str, list[float]]:
    """Largest values over a whole turn, at finer angles, over those of the study: of random units, by response."""
    names = [name for name in study.spans if math.isinf(study.requirements[name].lower)]
    if not names or not study.fields:
        return {}
    found, every = [], Response.of(study.design, names, _finer(study))
    for response in (study.units.replace(outputs=tuple(names)), every):
        values, _ = respond_units(response, Population.of(study.tolerances), root_key(study.seed), 0, count=TURNED)
        found.append({name: np.asarray(values[name]) for name in names})
    own, whole = found
    positive = {name: (own[name] > 0) & np.isfinite(whole[name]) for name in names}
    return {name: (whole[name][good] / own[name][good]).tolist() for name, good in positive.items()}


def _finer(study: Study) -> DriveConditions:
    """Conditions of a whole turn at more angles."""
    return models.over_a_turn(study.design, study.conditions, next(iter(study.spans)), FINER)


def _larger_text(study: Study, larger: Mapping[str, list[float]]) -> str:
    """Text on the values over a whole turn; "" where none was measured."""
    if not larger:
        return ""
    ratios = ((name, np.asarray(row)) for name, row in larger.items() if row)
    said = [f"{name} {row.mean():.3g} times (largest {row.max():.3g})" for name, row in ratios]
    angles = _finer(study).samples
    return (
        f"Over a turn of the output, at {angles:,} angles, {TURNED} units have on average {', '.join(said)} the value."
    )


def _turning(study: Study) -> list[str]:
    """Lines on the share that jams, from the least clearances of random units: no equilibrium is solved."""
    turning = kind_of(study.design).turning
    if turning is None or not study.fields:
        return []
    response = Response.of(study.design, (FIT,), study.conditions)
    found, status = respond_units(response, Population.of(study.tolerances), root_key(study.seed), 0, count=TRIED)
    good = np.asarray(status) == Status.CONVERGED
    return turning(study.design, study.tolerances, np.asarray(found[FIT])[good]) if good.any() else []


def _magnitudes(study: Study) -> list[tuple[str, str, str | None]]:
    of_kind = kind_of(study.design)
    known = [dict(numbers(one)) for one in of_kind.bases.values()]
    rows: list[tuple[str, str, str | None]] = []
    for name, (value, unit) in numbers(study.design):
        seen = [one[name][0] for one in known if name in one]
        span = f"{shown(min(seen), unit)} to {shown(max(seen), unit)}" if seen else None
        rows.append((name, shown(value, unit), span))
    kind = models.kind(study.design)
    for f in dataclasses.fields(kind.conditions):
        value = getattr(study.conditions, f.name)
        if f.name in kind.conditions_of(tuple(study.requirements)) and value is not None:
            number = condition_text(value, f.metadata)
            rated = f.metadata["torque"] and of_kind.rated
            span = f"up to {shown(of_kind.largest_torque, 'N m')}" if rated else None
            rows.append((f"conditions.{f.name}", number, span))
    return rows


def report(inputs: CheckInputs, found: Checked) -> Report:
    """The report on a study.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    design = inputs.study.design
    drawing = kind_of(design).drawing if inputs.picture else None
    figure = drawing and Figure("design", "The reducer to scale", lambda: drawing.reducer(design))
    return Report(
        title=f"{inputs.study.name}: check",
        content=tuple(_content(inputs.study, found, inputs.source)),
        data=_data(inputs.study, found),
        exports={inputs.picture: figure.content()} if inputs.picture and figure else {},
    )


def _content(study: Study, found: Checked, source: str) -> list[Note | Table]:
    head = [f"Study {study.name}: {type(study.design).__name__}", *filter(None, [study.about.line()])]
    titles = [Text("number"), Text("this study", wraps=True), Text("known reducers", wraps=True)]
    magnitudes = Table("numbers", titles, found.magnitudes)
    rows = [(getattr(study.tolerances, field), field) for field in study.fields]
    tolerances = Table(
        "tolerances",
        [Text("error"), Limits("limits"), Text("distribution")],
        [[field, limits_of(study, field, tolerance), tolerance.distribution] for tolerance, field in rows],
    )
    requirements = Table(
        "requirements",
        [Text("requirement"), Text("limit"), Text("at mid-points"), Text("target"), Text("meaning", wraps=True)],
        [
            [name, limit_text(one, output), _value(output, value), one.text() if one else "", output.meaning]
            for name in dict.fromkeys((*study.requirements, *found.values))
            for value, one, output in ((found.values[name], study.requirements.get(name), study.output(name)),)
        ],
    )
    costs = Table(
        "costs",
        [Text("error"), Number("cost"), Text("finest"), Text("now"), Text("coarsest")],
        [_cost(study, field) for field in study.costs],
    )
    how = [f"  {line}" for line in [*level_lines(study), expected(study)]]
    left = ["Ignored by the required models:", *(f"  {line}" for line in study.left_out)]
    said: list[Note | Table] = [
        Note("\n".join(head)),
        Note("\n".join(f"{name:32} {value}" for name, value in found.facts)),
        magnitudes,
        tolerances,
        *([requirements] if study.requirements else []),
        Note("\n".join(filter(None, [*found.turning, _larger_text(study, found.larger)]))),
        *([costs] if study.costs else []),
        Note("\n".join(["How it will be computed:", *how])),
        *([Note(f"Assumed (not published): {assumed_text(study)}")] if study.assumed else []),
        Note("\n".join([*left, *([f"  {line}"] if (line := whole_line(study, source)) else [])])),
        Note("\n".join(f"warning: {line}" for line in _warnings(study, found)) or "No warnings."),
    ]
    return [part for part in said if not isinstance(part, Note) or part.text]


def _value(output: Output, value: float) -> str:
    return "none" if math.isnan(value) else "endless" if math.isinf(value) else output.text(value)


def _cost(study: Study, field: str) -> list[object]:
    """Cost of the initial half-width, next to the range of its process."""
    cost, unit = study.costs[field], study.unit(field)
    half = getattr(study.tolerances, field).half_width
    widths = (shown(width, unit) for width in (cost.finest, half, cost.coarsest))
    return [field, float(cost(half)), *widths]


def whole_line(study: Study, source: str) -> str:
    """Line on the loaded reducer for a study whose outputs it has too; "" for another one.

    Args:
        study: as read.
        source: file of the study, or name of an embedded one.
    """
    if study.costly or not any(study.output(name).exact for name in study.requirements):
        return ""
    base = source if source.endswith(".toml") else study.base or source
    return (
        "the loaded reducer: every pin, both stages, bearing life, pin pressure and bearing forces, lost motion as on "
        f"a test bench; rvjax init NEW.toml --base {base} writes its study"
    )


def _warnings(study: Study, found: Checked) -> list[str]:
    lines = study.doubts + study.inaccurate(angles=False) + doubts_of_unit(study, found.values, found.status)
    return lines + [f"{name}: {text}" for name, text in found.remedies.items()]


FARTHEST = 3.0  # ratio of an assumed number to its value beyond which it is no remedy
FURTHER, TRIES = 1.05, 3  # exponent of the ratio, and steps: the value is a power of a number to first order only


def _remedy(study: Study, name: str, found: Mapping[str, float]) -> str:
    """Text on an assumed number whose change meets a limit at the mid-points and keeps all that are met; "" for none.

    Args:
        study: with the limits.
        name: of the missed limit.
        found: required outputs of the unit at the mid-points, SI.
    """
    value, limits = found[name], study.requirements[name]
    ends = [limit for limit in (limits.lower, limits.upper) if math.isfinite(limit)]
    due = min(ends, key=lambda limit: abs(limit - value)) / value if math.isfinite(value) and value and ends else 0.0
    allowed = kind_of(study.design).remedies
    numbers = [one for one in study.numbers if one.assumed and one.path in allowed and not np.ndim(one.value)]
    if due > 0 and numbers:
        errors = mid_points(study.tolerances, study.design.error_record)
        own, every = study.response_of(name), study.response(solve=False)
        slopes = jax.grad(lambda design: outcome_of(own.replace(design=design), errors).value[name])(study.design)
        held = [key for key, limits in study.requirements.items() if limits.margin(found[key]) <= 0]
        for one in numbers:
            exponent = float(number_at(slopes, one.path)) * float(one.value) / value
            for _ in range(TRIES):
                if abs(exponent) * math.log(FARTHEST) < abs(math.log(due)):
                    break
                ratio = due ** (FURTHER / exponent)
                new = ratio * float(one.value)
                other = outcome_of(every.replace(design=study.design_with({one.path: new})), errors)
                if int(worst(other.status)) not in SUCCESS:
                    break
                if all(study.requirements[key].margin(float(other.value[key])) <= 0 for key in (name, *held)):
                    return f"{one.path} = {shown(new, one.unit)} would meet it; {shown(one.value, one.unit)} is assumed"
                change = float(other.value[name]) / value
                exponent = math.log(change) / math.log(ratio) if change > 0 else 0.0
    return "the limit is assumed" if name in study.assumed_limits else ""


def _data(study: Study, found: Checked) -> dict[str, object]:
    return {
        "study": study.name,
        "about": study.about,
        "design": type(study.design).__name__,
        "facts": dict(found.facts),
        "numbers": {name: {"value": value, "unit": unit} for name, (value, unit) in numbers(study.design)},
        "conditions": dataclasses.asdict(study.conditions),
        "tolerances": {
            field: {"unit": study.unit(field)} | limits_data(study, field, getattr(study.tolerances, field))
            for field in study.fields
        },
        "requirements": {
            name: {
                "lower": one.lower,
                "upper": one.upper,
                "requires": one.text(),
                "unit": study.output(name).unit,
                "at_mid_points": found.values[name],
            }
            for name, one in study.requirements.items()
        },
        "costs": {
            field: {"cost": float(cost(getattr(study.tolerances, field).half_width)), "unit": study.unit(field)}
            | {name: float(getattr(cost, name)) for name in ("finest", "coarsest")}
            for field, cost in study.costs.items()
        },
        "without_limit": {name: value for name, value in found.values.items() if name not in study.requirements},
        "turning": found.turning,
        "over_a_turn": found.larger,
        "levels": {
            name: {"level": choice.level, "error": choice.bound, "unit": study.output(name).unit, "why": choice.why}
            for name, choice in found.levels.items()
        },
        "time": expected(study),
        "left_out": study.left_out,
        "doubts": _warnings(study, found),
    }
