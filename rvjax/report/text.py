"""What a person reads of an allocation: tables with units; and what a program reads, as JSON values."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rvjax.published import Comparison, show
from rvjax.render import aligned as table
from rvjax.render import plain as plain
from rvjax.render import versions as versions
from rvjax.report import numbers
from rvjax.study.answer import Answer
from rvjax.study.question import Study
from rvjax.tolerances import Estimate, Statistics, Verdict
from rvjax.units import readable

UNMOVED = "not seen"
UNMOVED_MEANS = "the model asked does not read this error, or not to first order; it may matter all the same"


def comparison_table(rows: Sequence[Comparison], *, notes: bool = False) -> str:
    """Published figures beside computed ones, and how many there are of each verdict."""
    headers = ["figure", "published", "computed", "unit", "physically right", "verdict"]
    cells = [[row.id, show(row.published), show(row.computed), row.unit, show(row.right), row.status] for row in rows]
    text = table(headers, cells).split("\n")
    lines = text[:2]
    for line, row in zip(text[2:], rows):
        lines.append(line)
        if notes:
            lines.append(f"    {row.claim}" + (f" -- {row.note}" if row.note else ""))
    verdicts = sorted({row.status for row in rows})
    counts = ", ".join(f"{sum(row.status == verdict for row in rows)} {verdict}" for verdict in verdicts)
    return "\n".join([*lines, "", f"{len(rows)} figures: {counts}", *_whose_error(rows)])


def _whose_error(rows: Sequence[Comparison]) -> list[str]:
    """Of contradicted figures, for a reader who takes them for errors of this package."""
    wrong = [row.id.split(".")[0] for row in rows if row.status == "contradicted"]
    if not wrong:
        return []
    sources = ", ".join(f"{wrong.count(source)} in {source}" for source in dict.fromkeys(wrong))
    return [
        f"contradicted: the error is the source's ({sources}), not that of rvjax: such a figure cannot stand beside "
        "the source's own numbers, geometry or equilibrium; --notes names what each of them contradicts"
    ]


def tolerance_text(tolerance: Any, unit: str) -> str:
    """Limits in the unit in which a person reads them, such as "+-6.50 um" or "8.00 +-4.00 um"."""
    name, size = readable(unit)
    middle, half = float(tolerance.middle) / size, float(tolerance.half_width) / size
    about = "" if abs(middle) < 1e-9 * abs(half) else f"{middle:.2f} "
    return f"{about}+-{half:.2f} {name}"


def yield_text(estimate: Estimate) -> str:
    """A yield with its confidence interval, in percent."""
    return f"{100 * estimate.value:.3f} % [{100 * estimate.lower:.3f}, {100 * estimate.upper:.3f}]"


def failures_text(found: Statistics) -> str:
    """How many units failed, why, how they count, and one of each kind to replay."""
    if not found.failed:
        return "0 failed"
    kinds = (f"{count:,} {name} (unit {found.examples[name]})" for name, count in found.failures.items())
    return f"{found.failed:,} failed, each a reject in every yield: {', '.join(kinds)}"


def limits_text(requirement: Any, unit: str, size: float) -> str:
    """Limits as "<= 1 arcmin"; `unit` of `size` is the one the response is read in."""
    bounds = ((">=", requirement.lower), ("<=", requirement.upper))
    return " and ".join(f"{sign} {limit / size:.4g} {unit}" for sign, limit in bounds if math.isfinite(limit))


def tolerance_rows(answer: Answer) -> tuple[list[str], list[list[str]]]:
    """Headers and rows of the table of tolerances: before, after, snapped to grades, and their cost."""
    study, allocation = answer.study, answer.allocation
    graded = allocation.graded
    headers = ["error", "before", "after", "cost before", "cost after"]
    if graded:
        headers += ["graded", "grade", "cost graded"]
    rows = []
    for field in study.fields:
        unit = study.unit(field)
        row = [field, *(tolerance_text(getattr(t, field), unit) for t in (study.tolerances, allocation.tolerances))]
        row += [_cost_text(side.cost, field) for side in (answer.before, answer.after)]
        if graded:
            row.append(tolerance_text(getattr(graded.tolerances, field), unit))
            row += [(graded.grades or {}).get(field, "-"), _cost_text(graded.costs, field)]
        rows.append(row)
    if moved := numbers.moved(allocation):
        rows.append([numbers.MOVED, "", "", "", f"{moved:.3f}"] + (["", "", f"{moved:.3f}"] if graded else []))
    total = ["sum", "", "", f"{allocation.start_cost:.3f}", f"{allocation.cost:.3f}"]
    rows.append(total + (["", "", f"{graded.cost:.3f}"] if graded else []))
    return headers, rows


def _cost_text(costs: dict[str, float], field: str) -> str:
    return f"{costs[field]:.3f}" if field in costs else "-"


def influence_rows(answer: Answer) -> tuple[list[str], list[list[str]]]:
    """Headers and rows of the table of influence: sensitivity and share of variance for each response, after.

    A sensitivity is the derivative to one element of the error, root mean square over its elements.
    """
    study, side = answer.study, answer.after
    headers = ["error"]
    for name in study.requirements:
        headers += [f"d {name} / d error", "share"]
    rows = []
    for field in study.fields:
        error_unit, error_size = readable(study.unit(field))
        row = [field]
        for name in study.requirements:
            unit, size = study.output(name).shown
            slope, share = side.sensitivities[name][field], side.shares[name][field]
            if slope == 0 and share == 0:
                row += [UNMOVED, "-"]
            else:
                number = f"{slope * error_size / size:.{_decimals(study, name)}f}"
                row += [f"{number} {unit}/{error_unit}", f"{100 * share:.1f} %"]
        rows.append(row)
    return headers, rows


def _decimals(study: Study, name: str) -> int:
    """Four in the usual unit of a response; in another unit that was asked for, as many as tell the same."""
    output = study.output(name)
    return max(2, 4 + round(math.log10(output.shown[1] / readable(output.unit)[1])))


def figure_text(verdict: Verdict, unit: str, size: float) -> str:
    """The figure that a requirement judges, with its interval; `unit` of `size` is the one a response is read in."""
    found = verdict.estimate
    if verdict.kind == "share":
        return yield_text(found)
    return estimate_text(found, unit, size) if verdict.kind == "response" else estimate_text(found)


def estimate_text(found: Estimate, unit: str = "", size: float = 1.0) -> str:
    """A figure with its interval, "-" where there is none."""
    if math.isnan(found.value):
        return "-"
    name = f" {unit}" if unit else ""
    return f"{found.value / size:.4g}{name} [{found.lower / size:.4g}, {found.upper / size:.4g}]"


def requirement_rows(answer: Answer) -> tuple[list[str], list[list[str]]]:
    """Headers and rows of the table of requirements: limit, yields, shadow price."""
    allocation = answer.allocation
    headers = ["requirement", "limit", "target", "yield before [interval]", "yield after [interval]", "shadow price"]
    rows = []
    for name, requirement in answer.study.requirements.items():
        unit, size = answer.study.output(name).shown
        price = allocation.multipliers[name] * size
        rows.append(
            [
                name,
                limits_text(requirement, unit, size),
                requirement.text(),
                figure_text(answer.certificate_before.verdicts[name], unit, size),
                figure_text(allocation.certificate.verdicts[name], unit, size),
                f"{price:.4g} /{unit}" if price else "not binding",
            ]
        )
    return headers, rows


def headline(answer: Answer) -> str:
    """Verdict with the yield of all requirements at once, and cost, or why there is no answer."""
    study, allocation = answer.study, answer.allocation
    lines = [f"Study {study.name}: {allocation.status}", *filter(None, [study.about.line()])]
    if (joint := allocation.certificate.joint_yield) is not None:
        asked = "no joint_target asks for it" if study.joint_target is None else f"asked {100 * study.joint_target:g} %"
        lines.append(f"all requirements at once: {yield_text(joint)}, {asked}")
    lines.append("")
    if allocation.feasible:
        change = 100 * (allocation.cost / allocation.start_cost - 1)
        lines.append(f"cost {allocation.start_cost:.3f} -> {allocation.cost:.3f} ({change:+.1f} %)")
        if allocation.graded:
            graded = allocation.graded
            lines.append(f"with ISO 286 grades: cost {graded.cost:.3f} ({graded.status})")
    else:
        lines.append("No tolerances within the process ranges were found to meet the requirements; at the finest ones")
        for name, shortfall in allocation.shortfall.items():
            if shortfall > 0:
                lines.append(f"  the limit of {name} {shortfall_text(shortfall, *study.output(name).shown)}")
    return "\n".join(lines)


def shortfall_text(shortfall: float, unit: str, size: float) -> str:
    """What a limit that cannot be met would have to do; `unit` of `size` is the one a response is read in."""
    if math.isinf(shortfall):
        return "would do at no value: too many units fail"
    return f"would have to move by {shortfall / size:.4g} {unit}"


def summary(answer: Answer) -> str:
    """The whole answer as text."""
    certificate = answer.allocation.certificate
    lines = [headline(answer)]
    for rows in (tolerance_rows, influence_rows, requirement_rows):
        lines += ["", table(*rows(answer))]
        if rows is influence_rows:
            lines.append(f"{UNMOVED}: {UNMOVED_MEANS}")
    lines.append("")
    lines.append(f"Certificate: {certificate.samples:,} fresh units, {failures_text(certificate)}")
    return "\n".join(lines + limits_of_the_answer(answer))


def assumed_text(study: Study) -> str:
    """The numbers that nobody printed; a part of which that holds for all stands for them."""
    stated = [number for number in study.numbers if number.origin != "default"]
    known = {number.path.rpartition(".")[0] for number in stated if not number.assumed} | {""}
    paths = (number.path for number in stated if number.assumed)
    parts = (path if path.rpartition(".")[0] in known else path.rpartition(".")[0] for path in paths)
    return ", ".join(dict.fromkeys(parts))


def limits_of_the_answer(answer: Answer) -> list[str]:
    """What a reader must know beside the figures, a line each: doubtful numbers, negative values, what is left out."""
    study = answer.study
    lines = [f"Doubtful: {line}" for line in study.doubts]
    lines += [f"Assumed, for nobody printed them: {assumed_text(study)}"] if study.assumed else []
    for name, values in answer.after.values.items():
        below = float(np.mean(np.asarray(values) < 0))
        if (meaning := study.output(name).below_zero) and below > 0:
            lines.append(f"Below zero: {name} of {100 * below:.3g} % of the units, {meaning}")
    return lines + [f"Left out: {line}" for line in study.left_out]


def as_json(answer: Answer) -> dict[str, Any]:
    """Everything about an answer except single units, with seed and versions, as JSON values; SI."""
    study, allocation = answer.study, answer.allocation
    graded = allocation.graded
    found = {
        "study": study.name,
        "about": study.about,
        "status": allocation.status,
        "feasible": allocation.feasible,
        "seed": study.seed,
        "samples": study.samples,
        "versions": versions(),
        "conditions": dataclasses.asdict(study.conditions),
        "cost": {"before": allocation.start_cost, "after": allocation.cost, "middles": numbers.moved(allocation)},
        "tolerances": {
            field: {
                "unit": study.unit(field),
                "before": limits(getattr(study.tolerances, field)),
                "after": limits(getattr(allocation.tolerances, field)),
                "graded": limits(getattr(graded.tolerances, field)) if graded else None,
            }
            for field in study.fields
        },
        "shares": {"before": answer.before.shares, "after": answer.after.shares},
        "sensitivities": answer.after.sensitivities,
        "limits": {row[0]: row[1] for row in requirement_rows(answer)[1]},
        "multipliers": allocation.multipliers,
        "shortfall": allocation.shortfall,
        "certificate": allocation.certificate,
        "certificate_before": answer.certificate_before,
        "graded": {"status": graded.status, "cost": graded.cost} if graded else None,
        "cost_curve": answer.cost_curve,
    }
    return plain(found)


def limits(tolerance: Any) -> dict[str, Any]:
    """Limits and law of a tolerance as JSON values, in the unit of the error."""
    lower, upper, cp, shift = (float(getattr(tolerance, name)) for name in ("lower", "upper", "cp", "shift"))
    return {"lower": lower, "upper": upper, "distribution": tolerance.distribution, "cp": cp, "shift": shift}
