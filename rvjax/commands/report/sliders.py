"""Section of the page with sliders: surrogate of a result, values and texts."""

import base64
import json
import math
import shlex
from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup

from rvjax.base.words import words
from rvjax.commands.allocate import Answer
from rvjax.commands.report.response_surface import COMPARED, Surrogate, placed
from rvjax.population import grows_from_lower
from rvjax.render import Block, Note, Section, micro
from rvjax.study import stated_by, study_template
from rvjax.tolerances import Cost, CpkAtLeast, Exponential, Limits, MeanWithin, ReciprocalPower, Requirement, SdAtMost
from rvjax.units import readable

POOR = 0.5  # of the units, or of a standard deviation: a larger error is no estimate
KINDS: dict[type[Limits], str] = {Requirement: "share", CpkAtLeast: "cpk", MeanWithin: "mean", SdAtMost: "sd"}


def block(found: Surrogate, answer: Answer) -> Block:
    """The section of the page, hidden until its script runs.

    Args:
        found: from `surrogate`.
        answer: result that it belongs to.
    """
    facts = {
        "units": len(found.weights),
        "graded": answer.allocation.graded is not None,
        "checks": _checks(found, answer),
        "own": found.compared == "own",
    }
    return Block("rvjax.commands.report:live.html.j2", facts)


def without(source: str) -> Section:
    """The section of a page that has no sliders without an option.

    Args:
        source: of the study, as named.
    """
    command = f"rvjax report {shlex.quote(source)} --sliders"
    return Section("What if", (Note(f"{command} adds sliders for tolerances and limits, which takes minutes."),))


def script(found: Surrogate, answer: Answer) -> Markup:
    """Numbers and script of the section, for the end of the page.

    Args:
        found: from `surrogate`.
        answer: result that it belongs to.
    """
    return script_of(data(found, answer), "report/live_page.js")


def script_of(numbers: dict[str, object], page: str) -> Markup:
    """Numbers as JSON, and the script of all sliders with that of a page.

    Args:
        numbers: data of the script.
        page: file in `rvjax.commands`.
    """
    # The text of the user is inside: it must not end the element.
    text = json.dumps(numbers, allow_nan=False).replace("<", "\\u003c").replace("&", "\\u0026")
    code = "".join((resources.files("rvjax.commands") / name).read_text("utf-8") for name in ("report/live.js", page))
    return Markup(f'<script type="application/json" id="live-data">{text}</script>\n<script>\n{code}</script>')


def data(found: Surrogate, answer: Answer) -> dict[str, Any]:
    """Data of the script, in the measurement units of the page."""
    study, allocation = answer.study, answer.allocation
    graded = found.place(allocation.graded.tolerances) if allocation.graded else None
    own = found.place(study.tolerances)
    parameters: list[dict[str, Any]] = []
    for k, p in enumerate(found.parameters):
        (unit, size), (what, half_widths) = readable(study.unit(p.field)), stated_by(study.forms, p.field)
        size /= 1.0 if p.place else half_widths  # a slider has the number of the drawing
        low, high = _range(found, k, answer)
        at = {"own": own[k], **({} if graded is None else {"graded": graded[k]})}
        parameters.append(
            {"label": f"{words(p.field)} {'middle' if p.place else what}", "place": p.place, "unit": unit}
            | {"centre": p.centre / size, "reach": p.reach / size, "low": low / size, "high": high / size}
            | {key: (p.centre + x * p.reach) / size for key, x in at.items()}
        )
    unwritten = any(not form.stated and name in study.middles for name, form in study.forms.items())  # of pin_ring
    fields = [_field(name, found, answer) for name in dict.fromkeys(p.field for p in found.parameters)]
    places = [field["name"] for field in fields]
    return {
        "name": study.name,
        "failed": found.failed,
        "weights": _floats(found.weights),
        "parameters": parameters,
        "fields": fields,
        "responses": [_response(name, found, answer) for name in study.requirements],
        "priced": bool(study.costs),
        "other_cost": sum(cost for name, cost in answer.after.cost.items() if name not in places),
        "error": error_text(found),
        "template": None if unwritten else study_template(study.text, study.requirements, places),
    }


def error_text(found: Surrogate) -> str:
    """Text on the measured error of the surrogate."""
    share, mean, sd = (found.error(figure) for figure in ("yield", "mean", "sd"))
    where = f"{len(found.checks)} points"
    where += f" with {COMPARED} of the same units" if found.compared == "own" else ""
    poor = "; the estimate is poor: compute the tolerances with rvjax" if max(share, mean, sd) > POOR else ""
    return (
        f"largest errors at {where}: yield {_percent(share)} of the units, mean {_percent(mean)} of a standard "
        f"deviation, standard deviation {_percent(sd)}{poor}"
    )


def _percent(part: float) -> str:
    """Percents to two digits, without an exponent."""
    if not math.isfinite(part):
        return "an unknown part"
    if 0 < part < 1e-4:
        return "below 0.01 %"
    return f"{np.format_float_positional(100 * part, precision=2, fractional=False, trim='-')} %"


def _range(found: Surrogate, k: int, answer: Answer) -> tuple[float, float]:
    """Ends of a slider: the process range, the range of the mid-point, or a range around the allocated value."""
    p, study = found.parameters[k], answer.study
    tolerance = getattr(study.tolerances, p.field)
    own = placed(tolerance) if p.place else float(tolerance.half_width)
    ends = [p.centre, own]
    if not p.place:
        cost = study.costs.get(p.field)
        ends += [float(cost.finest), float(cost.coarsest)] if cost else [0.25 * p.centre, 2 * p.centre]
    elif p.field in study.middles and not grows_from_lower(tolerance):
        ends += [study.middles[p.field].lower, study.middles[p.field].upper]
    else:
        ends += [p.centre - 2 * p.reach, p.centre + 2 * p.reach]
    return float(min(ends)), float(max(ends))


def _field(name: str, found: Surrogate, answer: Answer) -> dict[str, Any]:
    study, tolerance = answer.study, getattr(answer.after.tolerances, name)
    (unit, size), (what, half_widths) = readable(study.unit(name)), stated_by(study.forms, name)
    form = study.forms.get(name)
    places = {p.place: k for k, p in enumerate(found.parameters) if p.field == name}
    given, cost = getattr(study.tolerances, name), study.costs.get(name)
    priced = None if cost is None else cost_data(cost, size)
    moving = None
    if name in study.middles:
        moving = {"given": float(given.middle) / size, "scale": study.middles[name].scale * size}
    about = type(study.tolerances).__dataclass_fields__[name].metadata
    return {
        "name": name,
        "label": words(name),
        "unit": unit,
        "sign": "±" if what == "half-width" else what,
        "half_widths": half_widths,
        "drawing": None if form is None else f"{form.word} {form.before}".strip(),
        "half": places[False],
        "place": places.get(True),
        "stands": placed(tolerance) / size,
        "grows": grows_from_lower(tolerance),
        "nonnegative": about.get("sign") == "nonnegative",
        "own": [float(given.lower) / size, float(given.upper) / size],
        "cost": priced,
        "moving": moving,
    }


def cost_data(cost: Cost, size: float) -> dict[str, Any]:
    """A cost as data of the script.

    Args:
        cost: function of the half-width.
        size: SI size of the unit of the half-width.
    """
    if isinstance(cost, Exponential):
        return {"fixed": float(cost.fixed), "scale": float(cost.scale), "decay": float(cost.decay) / size}
    if isinstance(cost, ReciprocalPower):
        return {"fixed": float(cost.fixed), "scale": float(cost.scale)} | {
            "reference": float(cost.reference) / size,
            "power": float(cost.power),
        }
    # any other distribution: points, between which the page interpolates as `tolerances.Table` does
    points = np.union1d(np.geomspace(cost.finest, cost.coarsest, 129), getattr(cost, "half_widths", ()))
    return {"points": [[float(t) / size, float(cost(t))] for t in points]}


def _response(name: str, found: Surrogate, answer: Answer) -> dict[str, object]:
    study, requirement = answer.study, answer.study.requirements[name]
    unit, size = study.output(name).shown
    ends = {"lower": requirement.lower, "upper": requirement.upper}
    own = {end: value / size if math.isfinite(value) else None for end, value in ends.items()}
    spread = 2 * float(found.base[name].std()) / size
    ranges = {}
    for end, limit in own.items():
        if limit is not None:
            room = max(0.5 * abs(limit), spread) if requirement.limits_values else 0.5 * limit
            ranges[end] = [limit - room, limit + room]
    possible = bool(np.min(found.base[name]) >= 0) and all(limit is None or limit >= 0 for limit in own.values())
    shares = {field: share for field, share in answer.after.shares[name].items() if math.isfinite(share)}
    return {
        "name": name,
        "label": words(name),
        "unit": unit,
        "kind": KINDS.get(type(requirement), "worst"),
        "prefix": requirement.prefix,
        "of_units": requirement.of_units,
        "limits_values": requirement.limits_values,
        "own": own,
        "range": ranges,
        "floor": 0.0 if possible else None,  # of values: no unit is below, so none of a parabola is plotted there
        "wanted": getattr(requirement, requirement.goal) if requirement.goal else None,
        "required": requirement.text(),
        "shares": shares,
        "base": _floats(found.base[name] / size),
        "columns": [{"terms": list(key)} | _integers(c / size) for key, c in found.columns[name].items()],
    }


def _floats(values: np.ndarray) -> dict[str, object]:
    return {"data": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def _integers(values: np.ndarray) -> dict[str, object]:
    """16 bits for each value: within 1/65534 of the largest."""
    scale = float(np.abs(values).max()) / 32767 or 1.0
    numbers = np.round(values / scale).astype("<i2")
    return {"scale": scale, "data": base64.b64encode(numbers.tobytes()).decode()}


def _checks(found: Surrogate, answer: Answer) -> list[tuple[str, list[str]]]:
    """Surrogate / independent units at each point: name of the row, and a text for yield, mean and sd."""
    rows = []
    for check in found.checks:
        for name, figures in check.figures.items():
            unit, size = answer.study.output(name).shown
            unit = micro(unit)
            shown = {"yield": (0.01, "%"), "mean": (size, unit), "sd": (size, unit)}
            cells = [
                f"{figures[key][0] / scale:.4g} / {figures[key][1] / scale:.4g} {word}"
                for key, (scale, word) in shown.items()
            ]
            rows.append((f"{check.where}: {words(name)}", cells))
    return rows
