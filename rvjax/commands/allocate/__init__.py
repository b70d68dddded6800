"""`rvjax allocate`: the cheapest tolerances that meet the requirements of a study.

The verdict on a result in words: status, cost and losses, how far limits would have to move, notes on the values.
"""

import dataclasses
import json
import math
from dataclasses import dataclass

import numpy as np

from rvjax import commands
from rvjax.commands.allocate import answer
from rvjax.commands.allocate.answer import (
    FILE as FILE,
    Answer as Answer,
    restored_from as restored_from,
    stored,
)
from rvjax.commands.allocate.full_model_check import (
    unlimited_tables as unlimited_tables,
    unlimited_texts as unlimited_texts,
    whole_text,
)
from rvjax.commands.allocate.tables import (
    data_of,
    drawing_table as drawing_table,
    figures as figures,
    requirement_table as requirement_table,
    tolerance_tables as tolerance_tables,
)
from rvjax.commands.budget.effects import influence_tables
from rvjax.commands.cells import assumed_text, failures_text, limit_text, rejects_texts, searched_texts, share
from rvjax.commands.forecast import ALLOCATING, expected, forewarn, read_study, seconds_of_units, warned
from rvjax.life import dynamic_rating
from rvjax.outputs import Output
from rvjax.population import Estimate, deviate_of
from rvjax.render import Note, Report, results_folder
from rvjax.study import Study
from rvjax.tolerances import Allocation, Requirement, Statistics, expected_losses

LIVES = ("life", "arm_bearing_life")
CONFIDENCE = 0.95  # of certificates


def shortfall_text(shortfall: float, output: Output) -> str:
    """Text on a limit that cannot be met, with the distance to the limit that could be met.

    Args:
        shortfall: by how much it is missed, SI.
        output: what is limited.
    """
    if math.isinf(shortfall):
        return "cannot be met: too many units fail"
    return f"would have to move by {output.text(shortfall)}"


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
        arm = study.design.bearings.arm
        times = (limits.lower / (limits.lower - missing)) ** (1 / arm.life_exponent)
        rating = float(dynamic_rating(arm)) / 1e3
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
        sums[0] += before.value
        at, target = (study.output(name).text(float(value), "g") for value in (loss.at, loss.target))
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
    rejects = rejects_texts(study, answer.allocation.certificate)
    lines += rejects.values()
    for name, values in answer.after.values.items():
        below = float(np.mean(np.asarray(values) < 0))
        if (meaning := study.output(name).below_zero) and below > 0 and name not in rejects:
            lines.append(f"Negative {name} in {100 * below:.3g} % of the units: {meaning}")
    lines += [f"Not modelled: {line}" for line in study.left_out]
    return lines + ([whole_text(answer.whole, study)] if answer.whole is not None else [])


@dataclass(kw_only=True)
class AllocateInputs(commands.Inputs):
    """Find the cheapest tolerances for which the required share of units meets every requirement. Independent units
    certify them. Tables and plots go to a results folder.

    examples:
      rvjax allocate
      rvjax allocate my-study.toml --results results/first-try

    The folder contains summary.txt, CSV tables, result.json (SI units, seed, versions), study.toml and plots.
    Existing results are never overwritten. For an unchanged study the stored result is shown at once, unless the
    study reads other files or another version computed the result. exit code 1: no tolerances within the process
    ranges meet the requirements (the summary prints how far the limits would have to move), or the result is not
    certified.
    """

    source: str = commands.study_argument(
        ": rv-40e-whole (default: loaded reducer, a minute or two), rv-40e (four-bar model, seconds), corr",
        default="rv-40e-whole",
    )
    results: str | None = commands.results_option("STUDY")
    fresh: bool = commands.switch("recompute; the new result replaces the stored one of this study")
    no_whole: bool = commands.switch(
        "do not measure the result of a four-bar or lost-motion study on the whole reducer, nor that of a loaded "
        "study over a whole turn of the output and what it does not limit"
    )
    quiet: bool = commands.quiet_option()

    def __post_init__(self) -> None:
        """Read the study, and find the folder that holds its result."""
        self.study = read_study(self.source)
        stored = answer.folder(self.study, self.results)
        self.stored = None if self.fresh else stored
        if self.stored is not None:
            self.quiet = True
            return
        self.phases = (commands.READING, *ALLOCATING, commands.WRITING)
        self.folder, self.over = results_folder(self.results, self.study.name, stored), stored is not None
        forewarn(self.study, expected(self.study))
        self.memo = answer.memo(self.study, self.folder)


def compute(inputs: AllocateInputs) -> Answer | None:
    """Compute the result and solve the unit without errors; None if the result is stored."""
    if inputs.stored is not None:
        return None
    with commands.units_placed(lambda: seconds_of_units(inputs.study)) as device:
        commands.tell(device)
        measure, shown = not inputs.no_whole, not inputs.quiet
        return answer.answer(inputs.study, progress=shown, memo=inputs.memo, measure=measure, tell=warned)


def report(inputs: AllocateInputs, found: Answer | None) -> Report:
    """Report on a result, computed or read from a results folder.

    Args:
        inputs: inputs of the command.
        found: its result, None where a folder keeps it.
    """
    if found is not None:
        return report_on(found)
    place = inputs.stored
    assert place is not None
    said = f"Unchanged since {place} was written: this is its stored result. --fresh replaces it."
    stored = answer.restored(inputs.study, place)  # fits the terminal; the summary has the lines of a file
    shown = report_on(stored).content if stored else (Note((place / "summary.txt").read_text("utf-8").strip()),)
    data = json.loads((place / "result.json").read_text("utf-8")) | {"results": str(place)}
    return Report(title=inputs.study.name, content=(*shown, Note(said)), ok=data["status"] == "OPTIMAL", data=data)


def report_on(answer: Answer) -> Report:
    """Report on a result.

    Args:
        answer: the result.
    """
    certificate = answer.allocation.certificate
    fresh = f"Certificate: {certificate.samples:,} independent units, {failures_text(certificate)}"
    return Report(
        title=answer.study.name,
        content=(
            Note(headline(answer)),
            *tolerance_tables(answer),
            drawing_table(answer),
            *influence_tables(answer.study, answer.after.influence),
            requirement_table(answer),
            *unlimited_tables(answer.unlimited, answer.study),
            Note("\n".join([fresh, *limits_of_the_answer(answer)])),
            *figures(answer),
        ),
        status=answer.allocation.status,
        ok=answer.allocation.status == "OPTIMAL",
        data=data_of(answer),
        files={"study.toml": answer.study.text.encode(), FILE: stored(answer)},
    )
