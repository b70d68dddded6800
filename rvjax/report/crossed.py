"""Answers of `rvjax allocate` judged by the question of another study, side by side."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rvjax.report import compare, text
from rvjax.study.crossed import Crossed
from rvjax.study.plausible import numbers, shown
from rvjax.study.question import Study
from rvjax.study.read import parse_study

NEAR = 1e-9  # relative: numbers of two designs that are the same


def answered(path: str) -> tuple[Study, Any]:
    """The study of a results folder, and the tolerances that it found, with their laws.

    Args:
        path: of the folder, or of the result.json in it.

    Raises:
        ValueError: no results folder of `rvjax allocate`, or its study and its result do not fit each other.
    """
    found = compare.result(path)
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    try:
        written = (folder / "study.toml").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        raise ValueError(f"{folder}: there is no study.toml beside the result, which says the laws") from None
    study = parse_study(written, name=str(found["study"]), folder=folder, solve=False)
    try:
        limits = {name: (one["after"]["lower"], one["after"]["upper"]) for name, one in found["tolerances"].items()}
        tolerances = {
            name: getattr(study.tolerances, name).replace(lower=lower, upper=upper)
            for name, (lower, upper) in limits.items()
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: no result of the study beside it ({error!r})") from None
    return study, study.tolerances.replace(**tolerances)


def differences(answer: Study, study: Study) -> list[str]:
    """Numbers of the designs that both have and that differ, a line each."""
    ours, theirs = dict(numbers(study.design)), dict(numbers(answer.design))
    return [
        f"{name} is {shown(theirs[name][0], unit)} in {answer.name} and {shown(value, unit)} in {study.name}"
        for name, (value, unit) in ours.items()
        if name in theirs and abs(theirs[name][0] - value) > NEAR * max(abs(theirs[name][0]), abs(value))
    ]


def summary(found: Mapping[str, Crossed], answers: Mapping[str, Study]) -> str:
    """Yields, tolerances and costs of the answers under one study, as text."""
    study = next(iter(found.values())).study
    lines = [f"On {study.name}:", ""]
    rows = []
    for name, requirement in study.requirements.items():
        unit, size = study.output(name).shown
        row = [name, text.limits_text(requirement, unit, size), requirement.text()]
        for one in found.values():
            verdict = one.statistics.verdicts[name]
            row += [text.figure_text(verdict, unit, size), "met" if verdict.met else "not met"]
        rows.append(row)
    joint = [one.statistics.joint_yield for one in found.values()]  # None where no requirement judges single units
    cells = [cell for share in joint if share is not None for cell in (text.yield_text(share), "")]
    if cells:
        rows.append(["all at once", "", "", *cells])
    lines.append(
        text.table(["requirement", "limit", "asked", *(c for k in found for c in (f"{k} [interval]", ""))], rows)
    )
    rows = []
    for name in study.fields:
        used = [getattr(one.tolerances, name) for one in found.values()]
        cost = study.costs.get(name)
        row = [name, *(text.tolerance_text(tolerance, study.unit(name)) for tolerance in used)]
        rows.append([*row, *(f"{float(cost(tolerance.half_width)):.3f}" if cost else "-" for tolerance in used)])
    rows.append(["sum", *("" for _ in found), *(f"{one.cost:.3f}" for one in found.values())])
    lines += ["", text.table(["error", *found, *(f"cost {letter}" for letter in found)], rows), ""]
    for letter, one in found.items():
        lines.append(f"{letter}: {one.statistics.samples:,} fresh units, {text.failures_text(one.statistics)}")
        lines += [f"{letter}: {line}" for line in explained(one, answers[letter])]
    return "\n".join(lines)


def explained(one: Crossed, answer: Study) -> list[str]:
    """What the answer and the study do not share, a line each."""
    lines = []
    if one.own:
        lines.append(f"{answer.name} has no tolerance for {', '.join(one.own)}: those of {one.study.name} are kept")
    if one.left:
        lines.append(f"{one.study.name} has no tolerance for {', '.join(one.left)}: left out")
    if apart := differences(answer, one.study):
        lines.append(f"the design is that of {one.study.name}, and tolerances deviate from it: {'; '.join(apart)}")
    return lines


def as_json(found: Mapping[str, Crossed], answers: Mapping[str, Study]) -> dict[str, Any]:
    """The same as JSON values, SI."""
    study = next(iter(found.values())).study
    sides = {}
    for letter, one in found.items():
        sides[letter.lower()] = {
            "study": answers[letter].name,
            "taken": one.taken,
            "own": one.own,
            "left_out": one.left,
            "design": differences(answers[letter], study),
            "cost": one.cost,
            "tolerances": {
                name: {"unit": study.unit(name)} | text.limits(getattr(one.tolerances, name)) for name in study.fields
            },
            "certificate": dataclasses.replace(one.statistics, values=None),
        }
    return text.plain({"study": study.name, "answers": sides})
