"""A batch of units as text and files."""

import dataclasses
from typing import Any

from rvjax import tolerances
from rvjax.report import text
from rvjax.study import Study
from rvjax.tolerances import Statistics


def write(found: Statistics, question: Study, source: str, *, figures: str | None, samples: str | None) -> None:
    """Write the figures (.json), and those with the responses of every unit (.npz), each with the text of the study."""
    about = found.study | {"name": source, "toml": question.text}
    if figures is not None:
        tolerances.save(dataclasses.replace(found, values=None), figures, study=about)
    if samples is not None:
        tolerances.save(found, samples, study=about)


def as_json(found: Statistics, question: Study) -> dict[str, Any]:
    """The figures as JSON values, SI, with the unit of each response."""
    units = {name: question.output(name).unit for name in found.mean}
    return {"name": question.name, "units": units} | text.plain(dataclasses.replace(found, values=None))


def summary(found: Statistics, question: Study) -> str:
    """The figures as text, in the units in which a person reads them."""
    units = {name for name, share in (found.yield_ or {}).items() if share is not None}
    percentiles = list(found.quantiles)
    headers = ["response", "unit", "mean", "+-", "sd", "least", "most", *(f"{100 * p:g} %" for p in percentiles), "cpk"]
    rows, yields = [], []
    for name in found.mean:
        unit, size = question.output(name).shown
        numbers = [found.mean[name].value, found.mean[name].error, found.sd[name].value]
        numbers += [found.minimum[name], found.maximum[name], *(found.quantiles[p][name].value for p in percentiles)]
        rows.append(
            [
                name,
                unit,
                *(f"{number / size:.5g}" for number in numbers),
                f"{found.cpk[name]:.3f}" if name in units else "-",
            ]
        )
        if name in units:
            ppm = found.ppm[name]
            rejects = f"{ppm.value:.4g} [{ppm.lower:.4g}, {ppm.upper:.4g}]"
            yields.append([name, text.yield_text(found.yield_[name]), rejects])
    lines = [
        f"Study {question.name}: {found.samples:,} units, method {found.method}, seed {found.seed}",
        f"{text.failures_text(found)}; standard errors from {found.standard_errors}",
        "",
        text.table(headers, rows),
    ]
    if yields:
        lines += ["", text.table(["requirement", "yield [interval]", "rejects in a million [interval]"], yields)]
    for name, verdict in (found.verdicts or {}).items():
        if verdict.kind != "share":
            figure = text.figure_text(verdict, *question.output(name).shown)
            lines.append(f"{name}: {verdict.wanted}: {figure}, {'met' if verdict.met else 'not met'}")
    if found.joint_yield is not None:
        lines.append(f"all requirements at once {text.yield_text(found.joint_yield)}")
    return "\n".join(lines)
