"""Report of `rvjax check`: facts, magnitudes, limits, levels, time, warnings."""

import dataclasses

from rvjax.commands.allocate import expected
from rvjax.commands.cells import assumed_text, limit_text, limits_data, limits_of
from rvjax.commands.check.compute import Checked
from rvjax.commands.check.inputs import Inputs
from rvjax.commands.forecast import level_lines
from rvjax.render import Cell, Figure, Limits, Note, Number, Report, Table, Text
from rvjax.study import Study, kind_of, numbers, shown


def report(inputs: Inputs, found: Checked) -> Report:
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
        [Text("requirement"), Text("limit"), Text("target"), Text("meaning", wraps=True)],
        [
            [name, limit_text(one, study.output(name)), one.text(), study.output(name).meaning]
            for name, one in study.requirements.items()
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
        *([costs] if study.costs else []),
        Note("\n".join(["How it will be computed:", *how])),
        *([Note(f"Assumed (not published): {assumed_text(study)}")] if study.assumed else []),
        Note("\n".join([*left, *([f"  {line}"] if (line := whole_line(study, source)) else [])])),
        Note("\n".join(f"warning: {line}" for line in study.doubts + study.inaccurate()) or "No warnings."),
    ]
    return [part for part in said if not isinstance(part, Note) or part.text]


def _cost(study: Study, field: str) -> list[Cell]:
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
            name: {"lower": one.lower, "upper": one.upper, "requires": one.text(), "unit": study.output(name).unit}
            for name, one in study.requirements.items()
        },
        "costs": {
            field: {"cost": float(cost(getattr(study.tolerances, field).half_width)), "unit": study.unit(field)}
            | {name: float(getattr(cost, name)) for name in ("finest", "coarsest")}
            for field, cost in study.costs.items()
        },
        "levels": {
            name: {"level": choice.level, "error": choice.bound, "unit": study.output(name).unit, "why": choice.why}
            for name, choice in found.levels.items()
        },
        "time": expected(study),
        "left_out": study.left_out,
        "doubts": study.doubts + study.inaccurate(),
    }
