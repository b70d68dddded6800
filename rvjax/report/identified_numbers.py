"""The tables of an identification as numbers, for spreadsheets and programs; empty where there is none."""

import numpy as np

from rvjax.report.identified import elements, field_of, shown_unit
from rvjax.report.numbers import Cell, Rows, number
from rvjax.study.identified import Identified


def element_numbers(answer: Identified) -> Rows:
    """Every element, those that the data move most first: verdict, value and 95 % interval in the unit of its row."""
    check, found = answer.check, answer.posterior
    headers = ["element", "unit", "verdict", "known better by", "value", "lower", "upper", "chance beyond limit"]
    names = sorted(check.names, key=lambda name: -check.resolution[name])
    fields = None if found is None else [elements(x) for x in (found.value, found.lower, found.upper)]
    rows: list[list[Cell]] = []
    for name in names:
        unit, size = shown_unit(answer, field_of(name))
        numbers: list[Cell] = [None] * 4
        if found is not None and fields is not None:
            numbers = [*(number(values[name], size) for values in fields), number(found.broken.get(name, 0.0))]
        rows.append([name, unit, str(check.verdict[name]), number(max(check.resolution[name], 0.0)), *numbers])
    return headers, rows


def unit_numbers(answer: Identified) -> Rows:
    """Every unit of a batch: status, fit, and value and 95 % interval of each element that is identified."""
    batch = answer.batch
    assert batch is not None
    own = [n for n in answer.check.names if answer.check.verdict[n] == "identified"]
    own = [n for n in own if field_of(n) not in answer.problem.nuisance]
    headers, columns = ["unit", "status", "p model", "p prior"], []
    for name in own:
        field = field_of(name)
        unit, size = shown_unit(answer, field)
        at = tuple(int(i) for i in name[len(field) :].strip("[]").split(",") if i)
        for words, values in (("", batch.value), (" lower", batch.lower), (" upper", batch.upper)):
            headers.append(f"{name}{words} [{unit}]")
            columns.append(np.asarray([values[field][(k, *at)] for k in range(len(batch.status))]) / size)
    chances = [np.asarray(p) for p in (batch.fit.p_model, batch.fit.p_prior)]
    rows: list[list[Cell]] = [
        [unit or "-", str(batch.status[k]), *(number(column[k]) for column in (*chances, *columns))]
        for k, unit in enumerate(answer.problem.units)
    ]
    return headers, rows
