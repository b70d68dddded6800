"""Result of a study as one HTML page for screen, phone and paper; scripts only add a section with sliders."""

import dataclasses
import shlex
from dataclasses import dataclass

import numpy as np

from rvjax import catalogue, models
from rvjax._jax.sizes import PULLED, padded
from rvjax.base.words import words
from rvjax.commands.allocate import (
    Answer,
    drawing_table,
    figures,
    limits_of_the_answer,
    requirement_table,
    shortfalls,
    tolerance_tables,
    unlimited_tables,
    unlimited_texts,
)
from rvjax.commands.budget.effects import influence_tables
from rvjax.commands.cells import against_limit, condition_text, share
from rvjax.commands.forecast import choices, effort_of, shown_values
from rvjax.commands.report import response_surface, sliders
from rvjax.population import Population, root_key
from rvjax.records import PyTree
from rvjax.render import (
    Block,
    Cell,
    Column,
    Content,
    Figure,
    Note,
    Quantity,
    Report,
    Section,
    Table,
    Text,
    Titled,
    leading_comment,
)
from rvjax.response import elements, numbers_of
from rvjax.status import MEANING, Status
from rvjax.study import Study, facts_of, kind_of, shown
from rvjax.tolerances import Estimate
from rvjax.units import readable, with_unit

EACH = 2  # worst units of a requirement
SHARE_SHOWN = 0.01  # of the variance: errors below it are not listed for a worst unit


@dataclass(frozen=True)
class Shown:
    """Result with the surrogate and further sections of its page.

    Attributes:
        answer: result of the study.
        surrogate: behind the sliders, None where nothing can move, or without sliders.
        sections: on error budget, bearing lives and friction with the allocated tolerances, if the study has them.
    """

    answer: Answer
    surrogate: response_surface.Surrogate | None = None
    sections: tuple[Section, ...] = ()


def page_of(found: Shown, source: str, *, date: str = "") -> str:
    """The whole page; it lacks the sections of what was not found, and a date if none is given.

    Args:
        found: result, surrogate and further sections.
        source: of the study, as named.
        date: of the result.
    """
    answer, study = found.answer, found.answer.study
    drawn = {figure.name: figure for figure in figures(answer)}
    unlimited = unlimited_tables(answer.unlimited, answer.study)
    tables = requirement_table(answer), *unlimited, *tolerance_tables(answer), drawing_table(answer)
    sections: list[Content] = [Section("Result", tables), _requirements(answer, drawn), _tolerances(drawn)]
    sections += [sliders.block(found.surrogate, answer)] if found.surrogate else []
    sections += [] if found.surrogate or effort_of(study).sliders else [sliders.without(source)]
    sections += [design_section(study), _influence(answer, drawn)]
    sections += [*found.sections, _worst(answer, drawn), _levels(answer)]
    about = dict(study=study.name, author=study.about.author, revision=study.about.revision, computed=date)
    certificate = answer.allocation.certificate
    seeds = f"{study.seed} (certificate {certificate.seed}, sample units {answer.after.seed})"
    units = f"{study.samples:,} for the optimiser, {study.certificate_samples:,} for each certificate"
    return Report(
        title=study.about.title or f"{study.name}: tolerances",
        content=tuple(sections),
        status=_verdict(answer),
        ok=answer.allocation.status == "OPTIMAL",
        facts={
            "heading": study.about.title or study.name,
            "about": {name: text for name, text in about.items() if text},
            "intro": leading_comment(study.text),
            "code": answer.allocation.status,
            "said": " ".join([*_shortfalls(answer), *unlimited_texts(answer.unlimited, study)]),
            "boxes": _boxes(answer),
            "caveats": limits_of_the_answer(answer),
            "origin": {"command": f"rvjax report {shlex.quote(source)}", "seed": seeds, "units": units},
            "study": study.text,
            "script": sliders.script(found.surrogate, answer) if found.surrogate else None,
        },
    ).html()


def _verdict(answer: Answer) -> str:
    allocation = answer.allocation
    if allocation.status == "OPTIMAL":
        return "✔ The requirements can be met, and these are the cheapest tolerances."
    if allocation.feasible:
        return f"✘ Tolerances found, but not certified: {allocation.status}."
    return "✘ No tolerances within the process ranges were found to meet the requirements."


def _shortfalls(answer: Answer) -> list[str]:
    lines = [
        f"The limit of {words(name)} {text}." for name, text in shortfalls(answer.study, answer.allocation).items()
    ]
    infeasible = "All columns “after” show the finest tolerances of the processes."
    return lines + ([] if answer.allocation.feasible else [infeasible])


def _boxes(answer: Answer) -> list[tuple[str, str, str]]:
    allocation = answer.allocation
    certificate = allocation.certificate
    change = 100 * (allocation.cost / allocation.start_cost - 1)
    boxes = [
        ("cost before", f"{allocation.start_cost:.3f}", "tolerances of the study"),
        ("cost after", f"{allocation.cost:.3f}", f"{change:+.1f} %"),
    ]
    if graded := allocation.graded:
        status = "certified" if graded.status == "OPTIMAL" else graded.status
        boxes.append(("cost with ISO 286 grades", f"{graded.cost:.3f}", status))
    if (joint := certificate.joint_yield) is not None:
        value, _, interval = share(joint).text().partition(" [")
        boxes.append(("all requirements at once", value, f"[{interval}"))
    return [*boxes, ("units certified", f"{certificate.samples:,}", f"{certificate.failed:,} failed")]


def _requirements(answer: Answer, drawn: dict[str, Figure]) -> Section:
    certificate = answer.allocation.certificate
    failures = [
        f"{count:,} {status} ({MEANING[Status[status]]}; the first is unit {certificate.examples[status]:,})"
        for status, count in certificate.failures.items()
    ]
    certified = (
        f"Certificate: {certificate.samples:,} independent units, seed {certificate.seed}, "
        f"{certificate.failed:,} failed"
        + (f", each a reject in every yield: {', '.join(failures)}" if failures else "")
        + f". Intervals hold with {100 * certificate.confidence:g} % confidence; a requirement is met when the lower "
        "end of its yield reaches the target. A shadow price is the change of the cost when the limit moves outwards."
    )
    capability = (
        "Of the certified units. Cp = (upper - lower)/(6 sd) needs two limits; Cpk = distance of the mean from the "
        "nearer limit/(3 sd). They give the share of rejects for a normal distribution only; the yield holds for any."
    )
    histograms = tuple(drawn[f"histogram_{name}"] for name in answer.study.requirements)
    parts = (Note(certified), _capability(answer), Note(capability))
    return Section("Requirements in detail", (*parts, Section("", histograms, style="pair")))


def _capability(answer: Answer) -> Table:
    """Mean, spread and capability of each response that has limits for single units."""
    study, certificate = answer.study, answer.allocation.certificate
    rows = []
    for name in study.requirements:
        output = study.output(name)
        sides = [Quantity.of(x[name], output.unit, output.read_in) for x in (certificate.mean, certificate.sd)]
        capable: list[dict[str, Estimate] | None] = [certificate.cp_estimate, certificate.cpk_estimate]
        rows.append([name, *sides, *(Quantity.of(found[name]) if found else None for found in capable)])
    columns = [Text("response"), *(Column(title) for title in ("mean", "sd", "Cp", "Cpk"))]
    return Table("capability", columns, rows)


def _tolerances(drawn: dict[str, Figure]) -> Section:
    text = Note(
        "An error without a cost keeps the tolerance of the study. The cost of an error includes all its elements."
    )
    curve = [drawn["cost_against_yield"]] if "cost_against_yield" in drawn else []
    return Section("Cost", (text, *curve))


def _influence(answer: Answer, drawn: dict[str, Figure]) -> Section:
    units = " or ".join(dict.fromkeys(f"{found.units:,}" for found in answer.after.influence.values()))
    text = Note(
        f"With the tolerances after, of {units} units: the derivative of each response to one element of an error "
        "(mean over the units, root mean square over its elements), and the share of the error in the variance: the "
        "units are compared with units in which this error is sampled again."
    )
    return Section(
        "Which error matters", (text, *influence_tables(answer.study, answer.after.influence), drawn["variance_shares"])
    )


def _worst(answer: Answer, drawn: dict[str, Figure]) -> Section:
    text = (
        f"Of {shown_values(answer.study):,} sample units with the tolerances after (seed {answer.after.seed}). The bar "
        "is the tolerance, the tick its mid-point, each dot one element of the error or the length of a vector. Errors "
        f"that explain less than {100 * SHARE_SHOWN:g} % of the variance are not shown."
    )
    units = Block(
        "rvjax.commands.report:worst_units.html.j2", {"units": [rows_of(answer, u) for u in worst_units(answer)]}
    )
    return Section("Worst units", (Note(text), units, *([drawn["curves"]] if "curves" in drawn else [])))


def _levels(answer: Answer) -> Section:
    study = answer.study
    rows = []
    for name, choice in choices(study).items():
        output = study.output(name)
        unit, size = output.shown
        wanted = output.text(study.accuracy[name], ".3g") if name in study.accuracy else None
        bound = None if choice.bound is None else f"< {with_unit(float(f'{choice.bound / size:.2g}'), unit, 'g')}"
        spent = None if choice.ns is None else f"{choice.ns / 1e3:.3g} us"
        rows.append([Titled(name, output.meaning), choice.level, wanted, bound, spent, choice.why])
    short = [Text(title) for title in ("required accuracy", "its error", "time of a unit")]
    columns = [Text("response"), Text("level", wraps=True), *short, Text("why", wraps=True)]
    about = {f.name: f.metadata for f in dataclasses.fields(study.conditions)}
    conditions = ", ".join(
        f"{words(key)} = {condition_text(value, about[key])}"
        for key in models.kind(study.design).conditions_of(tuple(study.requirements))
        if (value := getattr(study.conditions, key)) is not None
    )
    text = (
        "A level is one way to compute a response. Errors and times are measured; the table comes with "
        f"rvjax. Times were measured on the computer of the table.\nConditions: {conditions}."
    )
    fold = "Level of each response, measured errors and times, conditions"
    return Section("Accuracy of the computation", (Table("levels", columns, rows), Note(text)), fold=fold)


def design_section(study: Study) -> Section:
    """Every number of the design and where it comes from, and a drawing to scale."""
    rows: list[list[Cell]] = []
    for one in study.numbers:
        name = Titled(one.path.replace(".", " "), one.meaning)
        rows.append([name, _value(one.value, one.unit), one.origin, "assumed" if one.assumed else ""])
    rows += [[name, value, "follows from the numbers above", ""] for name, value in facts_of(study.design)]
    parts: list[Note | Table | Figure] = []
    if drawing := kind_of(study.design).drawing:
        parts.append(Figure("design", drawing.caption(study.design), lambda: drawing.reducer(study.design)))
    if study.assumed:
        parts.append(Note("Values marked assumed are not published: the result depends on them."))
    if study.base:
        parts.append(Note(f"Base {study.base}. {catalogue.citation(study.base)}"))
    columns = [Text("number"), Text("value", wraps=True), Text("from", wraps=True), Text("note")]
    listed = Table("design", columns, rows)
    numbers = Section("", (listed,), fold=f"All {len(rows)} numbers of the design and their sources")
    return Section("The reducer", (Section("", tuple(parts), style="reducer"), numbers))


def _value(value: PyTree, unit: str) -> str:
    """A number of a design with its unit, or a word; of an array the elements."""
    if isinstance(value, str):
        return value
    if getattr(value, "shape", ()) or isinstance(value, list | tuple):
        return ", ".join(_value(item, unit) for item in value)
    return shown(value, unit) if unit != "-" else f"{float(value):.6g}"


@dataclass(frozen=True)
class WorstUnit:
    """One unit with the allocated tolerances.

    Attributes:
        index: number of the unit; `tolerances.sample` with the seed of the sample replays it.
        requirement: that it is worst in, or "" for a unit that failed.
        status: name of its status.
        values: {response: value}, SI; nan where it failed.
        errors: {field: value of every element}, SI.
    """

    index: int
    requirement: str
    status: str
    values: dict[str, float]
    errors: dict[str, np.ndarray]


def worst_units(answer: Answer) -> list[WorstUnit]:
    """First failed unit of each status, then the worst units of each requirement, in the sample of the histograms."""
    study, side = answer.study, answer.after
    found = [(index, "", status) for status, index in side.failed.items()]
    for name, requirement in study.requirements.items():
        if not requirement.of_units:
            continue
        margin = np.asarray(requirement.margin(side.values[name]))
        order = np.argsort(np.where(np.isfinite(margin), margin, -np.inf))[::-1]
        found += [(int(index), name, "CONVERGED") for index in order[:EACH] if np.isfinite(margin[index])]
    if not found:
        return []
    population = Population.of(side.tolerances)
    indices = np.array([index for index, _, _ in found])
    z = numbers_of(population, root_key(side.seed), padded(indices, PULLED))
    drawn = [population.constants | population.by_field(unit) for unit in np.asarray(elements(population, z)).T]
    return [
        WorstUnit(
            index=index,
            requirement=name,
            status=status,
            values={other: float(side.values[other][index]) for other in study.requirements},
            errors={f: np.ravel(drawn[k].get(f, 0.0)) for f in study.fields},
        )
        for k, (index, name, status) in enumerate(found)
    ]


def rows_of(answer: Answer, unit: WorstUnit) -> dict[str, object]:
    """Title, responses, and the place of every error in its tolerance; of a vector, that of its length.

    Args:
        answer: of a study.
        unit: one of its worst.
    """
    study, side = answer.study, answer.after
    if unit.requirement:
        shares = side.shares[unit.requirement]
        fields = sorted((f for f in study.fields if shares[f] >= SHARE_SHOWN), key=lambda f: -shares[f])
        requirement, output = study.requirements[unit.requirement], study.output(unit.requirement)
        place = against_limit(unit.values[unit.requirement], requirement, output)
        title, reason = f"Unit {unit.index:,}: {unit.requirement.replace('_', ' ')} {place}", f"status {unit.status}"
    else:
        fields, title = study.fields, f"Unit {unit.index:,} failed"
        reason = f"status {unit.status}: {MEANING[Status[unit.status]]}"
    responses = "; ".join(
        f"{name.replace('_', ' ')} {study.output(name).text(value) if np.isfinite(value) else '-'}"
        for name, value in unit.values.items()
    )
    rows = []
    for field in fields:
        tolerance, values = getattr(side.tolerances, field), unit.errors[field]
        if tolerance.is_vector:  # its tolerance limits the length
            values = np.hypot(*values.reshape(-1, 2).T)
        middle, half = float(tolerance.middle), float(tolerance.half_width)
        shown, size = readable(study.unit(field))
        places = (values - middle) / half if half > 0 else np.zeros_like(values)
        largest = with_unit(values[int(np.argmax(np.abs(places)))] / size, shown, "+.2f")
        rows.append({"name": field, "places": [float(x) for x in places], "value": largest})
    return {"title": title, "said": f"{responses}; {reason}", "rows": rows}
