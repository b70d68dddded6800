"""Verdict on a result in words: status, cost and losses, how far limits would have to move, notes on the values."""

import dataclasses
import math

import numpy as np

from rvjax.commands.allocate.answer import Answer
from rvjax.commands.allocate.full_model_check import unlimited_texts, whole_text
from rvjax.commands.cells import assumed_text, limit_text, searched_texts, share
from rvjax.life import dynamic_rating
from rvjax.outputs import Output
from rvjax.population import Estimate, deviate_of
from rvjax.study import Study
from rvjax.tolerances import Allocation, Requirement, Statistics, expected_losses
from rvjax.units import with_unit

LIVES = ("life", "arm_bearing_life")
CONFIDENCE = 0.95  # of certificates
EXPONENT = 10 / 3  # of a bearing life in the rating C, ISO 281


def shortfall_text(shortfall: float, output: Output) -> str:
    """Text on a limit that cannot be met, with the distance to the limit that could be met.

    Args:
        shortfall: by how much it is missed, SI.
        output: what is limited.
    """
    if math.isinf(shortfall):
        return "cannot be met: too many units fail"
    unit, size = output.shown
    return f"would have to move by {with_unit(shortfall / size, unit)}"


def shortfalls(study: Study, allocation: Allocation) -> dict[str, str]:
    """Text on each limit that cannot be met at the finest tolerances, or is not certified, by response.

    Args:
        study: solved study.
        allocation: its result.
    """
    missing = {name: found for name, found in allocation.shortfall.items() if found > 0}
    if allocation.feasible and allocation.status == "NOT_CERTIFIED":
        missing = _uncertified(study, allocation.certificate)
    return {name: _text(study, name, found) for name, found in missing.items()}


def _uncertified(study: Study, certificate: Statistics) -> dict[str, float]:
    """Distance by which each limit of a share must move so that the units of a certificate prove its target."""
    found = dict[str, float]()
    for name, verdict in (certificate.verdicts or {}).items():
        limits = study.requirements[name]
        if not verdict.met and isinstance(limits, Requirement) and certificate.values is not None:
            margin = limits.certified_margin(certificate.values[name], deviate_of(CONFIDENCE))
            if 0 < margin < math.inf:
                found[name] = margin
    return found


def _text(study: Study, name: str, missing: float) -> str:
    output, limits = study.output(name), study.requirements[name]
    text = shortfall_text(missing, output)
    if math.isinf(missing) or (math.isfinite(limits.lower) and math.isfinite(limits.upper)):
        return text  # of two limits either may be missed
    moved = limit_text(dataclasses.replace(limits, lower=limits.lower - missing, upper=limits.upper + missing), output)
    text += f": {moved} can be met"
    if name in LIVES and 0 < missing < limits.lower and any(path.startswith("bearings.") for path in study.assumed):
        times = (limits.lower / (limits.lower - missing)) ** (1 / EXPONENT)
        rating = float(dynamic_rating(study.design.bearings.arm)) / 1e3
        return (
            f"{text}; the assumed crank bearings prevent it: {times:.3g} times their rating C would do (bearings.arm: "
            f"{times * rating:.3g} kN instead of {rating:.3g} kN)"
        )
    if name in study.assumed_limits:
        return f"{text}; the assumed limit prevents it: {moved} would do"
    return text


def headline(answer: Answer) -> str:
    """Status with joint yield and cost, or the reason why there is no result."""
    study, allocation = answer.study, answer.allocation
    lines = [f"Study {study.name}: {allocation.status}", *filter(None, [study.about.line()])]
    if (joint := allocation.certificate.joint_yield) is not None:
        target = "no joint_target set" if study.joint_target is None else f"joint_target {100 * study.joint_target:g} %"
        lines.append(f"joint yield: {share(joint).text()} ({target})")
    lines.append("")
    if allocation.feasible:
        change = 100 * (allocation.cost / allocation.start_cost - 1)
        lines.append(f"cost {allocation.start_cost:.3f} -> {allocation.cost:.3f} ({change:+.1f} %)")
        if graded := allocation.graded:
            lines.append(f"with ISO 286 grades: cost {graded.cost:.3f} ({graded.status})")
        lines += losses_of(answer)
        lines += unlimited_texts(answer.unlimited, study)
    else:
        lines.append("No tolerances within the process ranges were found to meet the requirements; at the finest ones")
    lines += [f"  the limit of {name} {text}" for name, text in shortfalls(study, allocation).items()]
    return "\n".join(lines)


def losses_of(answer: Answer) -> list[str]:
    """Mean losses of the units that do not fail, before and after, and the cost with these."""
    study, allocation, sums = answer.study, answer.allocation, [answer.allocation.start_cost]
    if not study.losses:
        return []
    lines, given = [], expected_losses(study.losses, answer.certificate_before)
    for name, loss in study.losses.items():
        before, after = given[name], allocation.losses[name]
        unit, size = study.output(name).shown
        sums[0] += before.value
        at, target = (with_unit(float(value) / size, unit, "g") for value in (loss.at, loss.target))
        priced = f"{float(loss.price):g} for {at} off {target}"
        lines.append(f"mean loss of {name} ({priced}): {before.value:.3f} -> {after.value:.3f}, {_ends(after)}")
    whole = allocation.objective
    assert whole is not None
    return [*lines, f"cost with losses {sums[0]:.3f} -> {whole.value:.3f}, {_ends(whole)}"]


def _ends(estimate: Estimate) -> str:
    return f"{estimate.lower:.3f} to {estimate.upper:.3f}"


def limits_of_the_answer(answer: Answer) -> list[str]:
    """Notes on the values, a line each: warnings, negative values, what is not modelled."""
    study = answer.study
    lines = [f"Doubtful: {line}" for line in study.doubts]
    lines += [f"Inaccurate: {line}" for line in study.inaccurate(answer.allocation.tolerances)]
    lines += [f"Assumed (not published): {assumed_text(study)}"] if study.assumed else []
    lines += searched_texts(study, answer.allocation.tolerances)
    for name, values in answer.after.values.items():
        below = float(np.mean(np.asarray(values) < 0))
        if (meaning := study.output(name).below_zero) and below > 0:
            lines.append(f"Negative {name} in {100 * below:.3g} % of the units: {meaning}")
    lines += [f"Not modelled: {line}" for line in study.left_out]
    return lines + ([whole_text(answer.whole, study)] if answer.whole is not None else [])
