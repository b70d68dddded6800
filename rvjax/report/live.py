"""The live section of the page: sliders over the surrogate of an answer, its numbers and its words."""

import base64
import json
import math
import re
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from rvjax.plotting.style import words
from rvjax.report.surrogate import Surrogate, grows_from_lower, placed
from rvjax.study.answer import Answer
from rvjax.study.rewrite import template
from rvjax.tolerances import CpkAtLeast, Exponential, Limits, MeanWithin, ReciprocalPower, Requirement, SdAtMost
from rvjax.units import readable

KINDS: dict[type[Limits], str] = {Requirement: "share", CpkAtLeast: "cpk", MeanWithin: "mean", SdAtMost: "sd"}


def section(found: Surrogate | None, answer: Answer) -> str:
    """The section as HTML: hidden until its script runs.

    Args:
        found: from `surrogate`; None gives a page without it.
        answer: that it belongs to.
    """
    if found is None:
        return ""
    heads = "".join(f'<th scope="col">{name}</th>' for name in _COLUMNS)
    graded = _GRADED if answer.allocation.graded else ""
    return _SECTION.format(heads=heads, units=len(found.weights), graded=graded, checks=_checks(found, answer))


def script(found: Surrogate | None, answer: Answer) -> str:
    """Numbers and script of the section, for the end of the page."""
    if found is None:
        return ""
    # Text of the user stands inside: nothing in it may end the element.
    numbers = json.dumps(data(found, answer), allow_nan=False).replace("<", "\\u003c").replace("&", "\\u0026")
    files = resources.files("rvjax.report")
    code = "".join((files / name).read_text("utf-8") for name in ("live.js", "live_page.js"))
    return f'<script type="application/json" id="live-data">{numbers}</script>\n<script>\n{code}</script>'


def data(found: Surrogate, answer: Answer) -> dict[str, Any]:
    """What the script reads; in the units in which a person does."""
    study, allocation = answer.study, answer.allocation
    graded = found.place(allocation.graded.tolerances) if allocation.graded else None
    own = found.place(study.tolerances)
    parameters: list[dict[str, Any]] = []
    for k, p in enumerate(found.parameters):
        unit, size = readable(study.unit(p.field))
        low, high = _range(found, k, answer)
        at = {"own": own[k], **({} if graded is None else {"graded": graded[k]})}
        parameters.append(
            {"label": f"{words(p.field)} {'middle' if p.place else 'half-width'}", "place": p.place, "unit": unit}
            | {"centre": p.centre / size, "reach": p.reach / size, "low": low / size, "high": high / size}
            | {key: (p.centre + x * p.reach) / size for key, x in at.items()}
        )
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
        "template": template(study.text, study.requirements, places),
    }


def error_text(found: Surrogate) -> str:
    """How far the surrogate was off, in words."""
    share, mean, sd = (100 * found.error(figure) for figure in ("yield", "mean", "sd"))
    return (
        f"yields were within {share:.2g} % of the units of computed ones at {len(found.checks)} points of it, means "
        f"within {mean:.2g} % of a standard deviation, standard deviations within {sd:.2g} %"
    )


def _range(found: Surrogate, k: int, answer: Answer) -> tuple[float, float]:
    """Ends of a slider: the process range, the range of the middle, or what makes sense around the allocated value."""
    p, study = found.parameters[k], answer.study
    tolerance = getattr(study.tolerances, p.field)
    own = placed(tolerance) if p.place else float(tolerance.half_width)
    ends = [p.centre, own]
    if not p.place:
        cost = study.costs.get(p.field)
        ends += [cost.finest, cost.coarsest] if cost else [0.25 * p.centre, 2 * p.centre]
    elif p.field in study.middles and not grows_from_lower(tolerance):
        ends += [study.middles[p.field].lower, study.middles[p.field].upper]
    else:
        ends += [p.centre - 2 * p.reach, p.centre + 2 * p.reach]
    return float(min(ends)), float(max(ends))


def _field(name: str, found: Surrogate, answer: Answer) -> dict[str, Any]:
    study, tolerance = answer.study, getattr(answer.after.tolerances, name)
    unit, size = readable(study.unit(name))
    places = {p.place: k for k, p in enumerate(found.parameters) if p.field == name}
    given, cost = getattr(study.tolerances, name), study.costs.get(name)
    priced: dict[str, Any] | None = None
    if cost is not None:
        if isinstance(cost, Exponential):
            priced = {"fixed": float(cost.fixed), "scale": float(cost.scale), "decay": float(cost.decay) / size}
        elif isinstance(cost, ReciprocalPower):
            priced = {"fixed": float(cost.fixed), "scale": float(cost.scale)} | {
                "reference": float(cost.reference) / size,
                "power": float(cost.power),
            }
        else:  # any other law: points, between which the page interpolates as `tolerances.Table` does
            points = np.union1d(np.geomspace(cost.finest, cost.coarsest, 129), getattr(cost, "half_widths", ()))
            priced = {"points": [[float(t) / size, float(cost(t))] for t in points]}
    moving = None
    if name in study.middles:
        moving = {"given": float(given.middle) / size, "scale": study.middles[name].scale * size}
    about = type(study.tolerances).__dataclass_fields__[name].metadata
    return {
        "name": name,
        "label": words(name),
        "unit": unit,
        "half": places[False],
        "place": places.get(True),
        "stands": placed(tolerance) / size,
        "grows": grows_from_lower(tolerance),
        "nonnegative": about.get("sign") == "nonnegative",
        "own": [float(given.lower) / size, float(given.upper) / size],
        "cost": priced,
        "moving": moving,
    }


def _response(name: str, found: Surrogate, answer: Answer) -> dict[str, Any]:
    study, requirement = answer.study, answer.study.requirements[name]
    unit, size = study.output(name).shown
    own = {end: value / size if math.isfinite(value) else None for end, value in _ends(requirement).items()}
    spread = 2 * float(found.base[name].std()) / size
    ranges = {}
    for end, limit in own.items():
        if limit is not None:
            room = max(0.5 * abs(limit), spread) if requirement.limits_values else 0.5 * limit
            ranges[end] = [limit - room, limit + room]
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
        "wanted": getattr(requirement, requirement.goal) if requirement.goal else None,
        "asked": requirement.text(),
        "shares": shares,
        "base": _floats(found.base[name] / size),
        "columns": [{"terms": list(key)} | _integers(c / size) for key, c in found.columns[name].items()],
    }


def _ends(requirement: Limits) -> dict[str, float]:
    return {"lower": requirement.lower, "upper": requirement.upper}


def _floats(values: np.ndarray) -> dict[str, Any]:
    return {"data": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def _integers(values: np.ndarray) -> dict[str, Any]:
    """16 bits for each value: within 1/65534 of the largest."""
    scale = float(np.abs(values).max()) / 32767 or 1.0
    numbers = np.round(values / scale).astype("<i2")
    return {"scale": scale, "data": base64.b64encode(numbers.tobytes()).decode()}


def _checks(found: Surrogate, answer: Answer) -> str:
    rows = []
    for check in found.checks:
        for name, figures in check.figures.items():
            unit, size = answer.study.output(name).shown
            unit = re.sub("^u(?=m)", "µ", unit)
            cells = []
            for key, scale, shown in (("yield", 0.01, "%"), ("mean", size, unit), ("sd", size, unit)):
                ours, true = figures[key]
                cells.append(f"<td>{ours / scale:.4g} / {true / scale:.4g} {escape(shown)}</td>")
            rows.append(f'<tr><th scope="row">{escape(check.where)}: {escape(words(name))}</th>{"".join(cells)}</tr>')
    heads = "".join(f'<th scope="col">{name}</th>' for name in ("point", "yield", "mean", "sd"))
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


_COLUMNS = ("requirement", "figure", "asked", "mean", "sd", "Cpk", "verdict")
_GRADED = '\n<button type="button" data-begin="graded">with ISO 286 grades</button>'
_SECTION = """<section id="live" class="live as-allocated" hidden>
<h2>What if</h2>
<p class="live-intro">Move half-widths, middles and limits; the figures follow at once, from {units:,} weighted units.
As allocated, they are those of the certificate; elsewhere they come near to it, as said here, and certify nothing.</p>
<p class="live-region" data-live="region"></p>
<p class="unseen" role="status" data-live="spoken"></p>
<p class="live-bar" aria-hidden="true" data-live="bar"></p>
<dl class="key"><div><dt>cost now</dt><dd><span data-live="cost"></span><small data-live="change"></small></dd></div>
<div><dt>all requirements at once</dt><dd data-live="joint"></dd></div></dl>
<div class="wide"><table class="cards"><thead><tr>{heads}</tr></thead><tbody data-live="figures"></tbody></table></div>
<div class="live-buttons"><button type="button" data-begin="centre">as allocated</button>
<button type="button" data-begin="own">as in the study</button>{graded}</div>
<div class="live-sliders">
<fieldset data-live="half-widths"><legend>Half-widths</legend></fieldset>
<fieldset data-live="limits"><legend>Limits of the requirements</legend></fieldset>
<details><summary>Nominal values: where the limits of an error stand</summary><fieldset data-live="middles">
<legend>Middles</legend></fieldset></details>
</div>
<div class="pair" data-live="pictures"></div>
<details class="live-study"><summary>This as a study file, for rvjax to compute</summary>
<textarea data-live="study" readonly rows="16" aria-label="study file with these tolerances and limits"></textarea>
<p><button type="button" data-live="download">save the study file</button></p></details>
<details class="live-checks"><summary>How far off it was: surrogate / computed with units of their own</summary>
<div class="wide">{checks}</div></details>
</section>"""
