"""The answer to a study as one HTML page: pictures inside, nothing fetched; for screen, phone and paper.

Scripts only add a section with sliders; without them the page says everything else.
"""

import shlex
from html import escape

import numpy as np

from rvjax import levels, models
from rvjax.plotting.style import words
from rvjax.render import Figure, Note, Section, Table
from rvjax.report import live
from rvjax.report import text as tables
from rvjax.report.design import design_section
from rvjax.report.html import boxes, document, figure, micro, note, origin, section, table, typeset
from rvjax.report.pictures import Picture, pictures
from rvjax.report.surrogate import Surrogate
from rvjax.report.worst_units import WorstUnit, worst_units
from rvjax.status import MEANING, Status
from rvjax.study.answer import Answer, shown_values
from rvjax.study.question import Study
from rvjax.units import readable

SHARE_SHOWN = 0.01  # of the variance: errors below it are not listed for a worst unit


def page(
    answer: Answer,
    source: str,
    surrogate: Surrogate | None = None,
    extra: Section | None = None,
    *,
    date: str = "",
) -> str:
    """The whole page; without a surrogate or an error budget it lacks their sections, without a date it says none."""
    drawn = {picture.name: picture for picture in pictures(answer, "svg")}
    title = answer.study.about.title or f"{answer.study.name}: tolerances"
    answered = [_requirements(answer, drawn), _tolerances(answer, drawn), live.section(surrogate, answer)]
    owners = [_extra(extra)] if extra is not None else []
    explained = [
        design_section(answer.study),
        _influence(answer, drawn),
        *owners,
        _worst(answer, drawn),
        _levels(answer),
        _origin(answer, source),
    ]
    parts = [_head(answer, date), *answered, *explained, live.script(surrogate, answer)]
    return document(title, "\n".join(filter(None, parts)))


def _head(answer: Answer, date: str) -> str:
    study, allocation = answer.study, answer.allocation
    certificate = allocation.certificate
    certified = allocation.status == "OPTIMAL"
    if certified:
        verdict = "✔ The requirements can be met, and these are the cheapest tolerances."
    elif allocation.feasible:
        verdict = f"✘ Tolerances were found, but not with certainty: {escape(allocation.status)}."
    else:
        verdict = "✘ No tolerances within the process ranges were found to meet the requirements."
    more = []
    for response, shortfall in allocation.shortfall.items():
        if shortfall > 0:
            wanted = tables.shortfall_text(shortfall, *study.output(response).shown)
            more.append(f"The limit of {words(response)} {wanted}.")
    if not allocation.feasible:
        more.append("All columns “after” show the finest tolerances of the processes.")
    change = 100 * (allocation.cost / allocation.start_cost - 1)
    figures = [
        ("cost before", f"{allocation.start_cost:.3f}", "tolerances of the study"),
        ("cost after", f"{allocation.cost:.3f}", f"{change:+.1f} %"),
    ]
    if graded := allocation.graded:
        sure = "certified" if graded.status == "OPTIMAL" else graded.status
        figures.append(("cost with ISO 286 grades", f"{graded.cost:.3f}", sure))
    if (joint := certificate.joint_yield) is not None:
        interval = f"[{100 * joint.lower:.3f}, {100 * joint.upper:.3f}]"
        figures.append(("all requirements at once", f"{100 * joint.value:.3f} %", interval))
    figures.append(("units certified", f"{certificate.samples:,}", f"{certificate.failed:,} failed"))
    caveats = "".join(f"<li>{escape(line)}</li>" for line in tables.limits_of_the_answer(answer))
    return (
        f"<header>\n<h1>{escape(study.about.title or study.name)}</h1>\n{_origins(study, date)}"
        f'<p class="note">{escape(note(study.text))}</p>\n'
        f'<div class="verdict{"" if certified else " missed"}"><strong>{verdict}</strong> '
        f"<code>{escape(allocation.status)}</code> {' '.join(map(escape, more))}</div>\n"
        f'{boxes(figures)}\n<ul class="caveats">{caveats}</ul>\n</header>'
    )


def _origins(study: Study, date: str) -> str:
    """Study, author, revision and date, as far as they are known."""
    stated = dict(study=study.name, author=study.about.author, revision=study.about.revision, computed=date)
    facts = "".join(f"<div><dt>{name}</dt><dd>{escape(text)}</dd></div>" for name, text in stated.items() if text)
    return f'<dl class="about">{facts}</dl>\n'


def _capability(answer: Answer) -> str:
    """Mean, spread and capability of each response that has limits for single units."""
    study, certificate = answer.study, answer.allocation.certificate
    cells = []
    for name in study.requirements:
        unit, size = study.output(name).shown
        figures = [certificate.mean[name], certificate.sd[name]]
        row = [tables.estimate_text(figure, unit, size) for figure in figures]
        for found in (certificate.cp_estimate, certificate.cpk_estimate):
            row.append(tables.estimate_text(found[name]) if found else "-")
        cells.append([escape(words(name)), *map(typeset, row)])
    text = (
        "<p>Of the certified units. Cp = (upper - lower)/(6 sd) needs two limits; Cpk = distance of the mean from the "
        "nearer limit/(3 sd). Both speak of rejects only where the distribution is normal; the yield does for any.</p>"
    )
    return table(["response", "mean", "sd", "Cp", "Cpk"], cells) + text


def _requirements(answer: Answer, drawn: dict[str, Picture]) -> str:
    study, allocation = answer.study, answer.allocation
    headers, rows = tables.requirement_rows(answer)
    headers = [*headers, *(["yield graded [interval]"] if allocation.graded else []), "verdict"]
    cells = []
    for row, name in zip(rows, study.requirements):
        unit, size = study.output(name).shown
        graded = []
        if allocation.graded:
            graded = [tables.figure_text(allocation.graded.certificate.verdicts[name], unit, size)]
        met = allocation.certificate.verdicts[name].met
        mark = '<span class="met">✔ met</span>' if met else '<span class="missed-mark">✘ not met</span>'
        title = f"{escape(words(name))}<small>{escape(study.output(name).meaning)}</small>"
        cells.append([title, *map(typeset, [*row[1:], *graded]), mark])
    certificate = allocation.certificate
    failures = [
        f"{count:,} {status} ({escape(MEANING[Status[status]])}; the first is unit {certificate.examples[status]:,})"
        for status, count in certificate.failures.items()
    ]
    certified = (
        f"Certificate: {certificate.samples:,} fresh units with seed {certificate.seed}, {certificate.failed:,} failed"
        + (f", each a reject in every yield: {', '.join(failures)}" if failures else "")
        + f". Intervals hold with {100 * certificate.confidence:g} % confidence; a requirement is met when the lower "
        "end of its yield reaches the target. A shadow price is the change of the cost when the limit moves outwards."
    )
    histograms = "".join(figure(drawn[f"histogram_{name}"]) for name in study.requirements)
    return section(
        "Requirements",
        f"{table(headers, cells)}<p>{certified}</p>{_capability(answer)}<div class='pair'>{histograms}</div>",
    )


def _tolerances(answer: Answer, drawn: dict[str, Picture]) -> str:
    study = answer.study
    headers, rows = tables.tolerance_rows(answer)
    shapes = {field: getattr(study.tolerances, field).shape for field in study.fields}
    cells = []
    for row in rows:
        elements = int(np.prod(shapes.get(row[0], ())))
        note = f"<small>{elements} elements, each its own</small>" if elements > 1 else ""
        cells.append([escape(words(row[0])) + note, *map(typeset, row[1:])])
    text = (
        "<p>An error without a cost keeps the tolerance of the study. The cost of an error is that of all its elements "
        "together.</p>"
    )
    curve = figure(drawn["cost_against_yield"]) if "cost_against_yield" in drawn else ""
    return section("Tolerances and cost", table(headers, cells, total=True) + text + curve)


def _influence(answer: Answer, drawn: dict[str, Picture]) -> str:
    headers, rows = tables.influence_rows(answer)
    headers = [words(header) for header in headers]
    cells = [[escape(words(row[0])), *map(typeset, row[1:])] for row in rows]
    text = (
        "<p>With the tolerances after: the derivative of each response to one element of an error (root mean square "
        "over its elements), and the share of the error in the variance of the response.</p>"
        f"<p>{escape(tables.UNMOVED)}: {escape(tables.UNMOVED_MEANS)}.</p>"
    )
    return section("Which error matters", text + table(headers, cells) + figure(drawn["variance_shares"]))


def _extra(part: Section) -> str:
    """A section that another command describes."""
    said = []
    for item in part.content:
        if isinstance(item, Table):
            headers, rows = item.texts("page")
            said.append(table(headers, [[escape(row[0]), *map(typeset, row[1:])] for row in rows]))
        elif isinstance(item, Note):
            said += [f"<p>{escape(line)}</p>" for line in item.text.splitlines()]
        elif isinstance(item, Figure):
            said.append(figure(Picture(item.name, item.caption, item.content("svg"))))
    return section(part.title, "".join(said))


def _worst(answer: Answer, drawn: dict[str, Picture]) -> str:
    side = answer.after
    shown = shown_values(answer.study)
    text = (
        f"<p>Of {shown:,} sample units with the tolerances after (seed {side.seed}). The bar is the tolerance, "
        "the tick its middle, every dot one element of the error. Errors that explain less than "
        f"{100 * SHARE_SHOWN:g} % of the variance are left out.</p>"
    )
    curves = figure(drawn["curves"]) if "curves" in drawn else ""
    units = "".join(_unit(answer, unit) for unit in worst_units(answer))
    return section("Worst units", f"{text}<div class='units'>{units}</div>{curves}")


def _unit(answer: Answer, unit: WorstUnit) -> str:
    study, side = answer.study, answer.after
    if unit.requirement:
        shares = side.shares[unit.requirement]
        fields = sorted((f for f in study.fields if shares[f] >= SHARE_SHOWN), key=lambda f: -shares[f])
        name, size = study.output(unit.requirement).shown
        margin = study.requirements[unit.requirement].margin(unit.values[unit.requirement]) / size
        place = f"{abs(margin):.3g} {name} {'beyond' if margin > 0 else 'within'} the limit"
        title = f"Unit {unit.index:,}: {words(unit.requirement)}, {place}"
        reason = f"status {unit.status}"
    else:
        fields, title = study.fields, f"Unit {unit.index:,} failed"
        reason = f"status {unit.status}: {MEANING[Status[unit.status]]}"
    responses = "; ".join(
        f"{words(name)} {value / size:.4g} {shown}" if np.isfinite(value) else f"{words(name)} -"
        for name, value in unit.values.items()
        for shown, size in [study.output(name).shown]
    )
    rows = []
    for field in fields:
        tolerance, values = getattr(side.tolerances, field), unit.errors[field]
        middle, half = float(tolerance.middle), float(tolerance.half_width)
        shown, size = readable(study.unit(field))
        places = (values - middle) / half if half > 0 else np.zeros_like(values)
        largest = int(np.argmax(np.abs(places)))
        count = f"<small>largest of {len(values)}</small>" if len(values) > 1 else ""
        rows.append([escape(words(field)), _strip(places), typeset(f"{values[largest] / size:+.2f} {shown}") + count])
    return (
        f'<section class="unit"><h3>{micro(escape(title))}</h3>'
        f'<p class="small">{micro(escape(responses))}; {escape(reason)}</p>'
        f"{table(['error', 'in its tolerance', 'value'], rows, cards=False)}</section>"
    )


def _strip(places: np.ndarray) -> str:
    """A tolerance as a bar from -1 to 1 with a dot at each place; places beyond 1.5 stand at the edge."""
    dots = "".join(
        f'<circle cx="{100 * float(np.clip(x, -1.48, 1.48)):.1f}" cy="0" r="6" '
        f'fill="{"#0072b2" if abs(x) <= 1 else "#d55e00"}" fill-opacity=".75"/>'
        for x in places
    )
    return (
        '<svg viewBox="-156 -10 312 20" preserveAspectRatio="xMidYMid meet" role="img" '
        f'aria-label="{", ".join(f"{100 * float(x):.0f} %" for x in places)} of the half-width">'
        '<rect x="-100" y="-4" width="200" height="8" fill="#d0d7de"/>'
        f'<path d="M0 -8V8" stroke="#57606a" stroke-width="1.5"/>{dots}</svg>'
    )


def _levels(answer: Answer) -> str:
    study = answer.study
    outputs = tuple(study.requirements)
    given = levels.as_given(study.design, outputs, study.conditions, tolerances=study.tolerances)
    rows = []
    for name, choice in (given | study.choices()).items():
        unit, size = study.output(name).shown
        wanted = f"{study.accuracy[name] / size:.3g} {unit}" if name in study.accuracy else "-"
        bound = "-" if choice.bound is None else f"< {float(f'{choice.bound / size:.2g}'):g} {unit}"
        time = "-" if choice.ns is None else f"{choice.ns / 1e3:.3g} us"
        title = f"{escape(words(name))}<small>{escape(study.output(name).meaning)}</small>"
        rows.append([title, escape(choice.level), *map(typeset, [wanted, bound, time]), escape(choice.why)])
    headers = ["response", "level", "accuracy asked", "its error", "time of a unit", "why"]
    kind = models.kind(study.design)
    conditions = ", ".join(
        f"{words(key)} = {value}"
        for key in kind.conditions_of(outputs)
        if (value := getattr(study.conditions, key)) is not None
    )
    text = (
        "<p>A level is one way to compute a response. Errors and times are measured ones, from the table that comes "
        f"with rvjax; times belong to its machine and serve for comparison.</p>"
        f"<p>Conditions, SI: {escape(conditions)}.</p>"
    )
    return section("How exactly it was computed", table(headers, rows) + text)


def _origin(answer: Answer, source: str) -> str:
    study = answer.study
    seeds = f"{study.seed} (certificate {answer.allocation.certificate.seed}, sample units {answer.after.seed})"
    units = f"{study.samples:,} for the optimiser, {study.certificate_samples:,} for each certificate"
    return origin({"command": f"rvjax report {shlex.quote(source)}", "seed": seeds, "units": units}, study.text)
