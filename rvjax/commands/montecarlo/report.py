"""Report of `rvjax montecarlo`: statistics, yields and rejects of each response."""

import dataclasses
import time
from typing import Any

from rvjax.commands.cells import evaluated, failures_text, met_text, searched_texts, share
from rvjax.commands.montecarlo.compute import Sampled
from rvjax.commands.montecarlo.inputs import Inputs
from rvjax.render import Column, Note, Number, Quantity, Report, Table, Text
from rvjax.study import Study
from rvjax.tolerances import Statistics


def report(inputs: Inputs, found: Sampled | None) -> Report:
    """The report on a sample; empty in one of several processes.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    if found is None:
        return Report("", ())
    made = report_on(found.statistics, found.study)
    seconds = time.perf_counter() - inputs.started
    last = f"{seconds:.1f} s, start and compilation included; units on {found.device}"
    return dataclasses.replace(made, content=(*made.content, Note(last)))


def report_on(found: Statistics, study: Study) -> Report:
    """The report on a sample.

    Args:
        found: its statistics.
        study: that it belongs to.
    """
    judging = [name for name, each in (found.yield_ or {}).items() if each is not None]
    head = [
        f"Study {study.name}: {found.samples:,} units, method {found.method}, seed {found.seed}",
        f"{failures_text(found)}; standard errors from {found.standard_errors}",
        *(f"Inaccurate: {line}" for line in study.inaccurate()),
    ]
    rest = "\n".join(_verdicts(found, study))
    statistics = _statistics(found, study, judging)
    tables = [statistics, _yields(found, judging)] if judging else [statistics]
    tables[-1] = dataclasses.replace(tables[-1], note=rest)
    units = {name: study.output(name).unit for name in found.mean}
    return Report(
        title=f"{study.name}: Monte Carlo",
        content=(Note("\n".join(head)), *tables),
        data={"name": study.name, "units": units} | vars(dataclasses.replace(found, values=None)),
    )


def _statistics(found: Statistics, study: Study, judging: list[str]) -> Table:
    percentiles = list(found.quantiles)
    titles = ["mean", "+-", "sd", "least", "most", *(f"{100 * p:g} %" for p in percentiles)]
    numbers = [Number(title, form=".5g", named=False) for title in titles]
    columns = [Text("response"), Text("unit"), *numbers, Number("cpk", form=".3f")]
    rows: list[list[Any]] = []
    for name in found.mean:
        output = study.output(name)
        values = [found.mean[name].value, found.mean[name].error, found.sd[name].value]
        values += [found.minimum[name], found.maximum[name], *(found.quantiles[p][name].value for p in percentiles)]
        cells = [Quantity(float(value), output.unit, read_in=output.read_in) for value in values]
        rows.append([name, output.shown[0], *cells, found.cpk[name] if name in judging else None])
    return Table("statistics", columns, rows)


def _yields(found: Statistics, judging: list[str]) -> Table:
    rows = [[name, share(found.yield_[name]), Quantity.of(found.ppm[name])] for name in judging]
    columns = [Text("requirement"), Column("yield [interval]"), Column("rejects in a million [interval]")]
    return Table("yields", columns, rows)


def _verdicts(found: Statistics, study: Study) -> list[str]:
    """Requirements of a mean or a spread, and all requirements at once."""
    lines = []
    for name, verdict in (found.verdicts or {}).items():
        if verdict.kind != "share":
            value = evaluated(verdict, study.output(name)).text()
            met = met_text(study.requirements[name], verdict, found.samples)
            lines.append(f"{name}: {verdict.wanted}: {value}, {met}")
    lines += searched_texts(study, study.tolerances)
    if found.joint_yield is not None:
        lines.append(f"all requirements at once {share(found.joint_yield).text()}")
    return lines
