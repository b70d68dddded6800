"""A plan as text and files: what a person takes to the bench."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rvjax import plotting
from rvjax.assembly import Plan
from rvjax.mounting import disc_mountings, drawing
from rvjax.report.folders import as_csv, write_files
from rvjax.report.folders import as_json as json_file
from rvjax.report.pictures import saved
from rvjax.report.text import estimate_text, plain, table, versions
from rvjax.study import Study
from rvjax.study.assembly import REST, Bench, unit_values
from rvjax.study.prices import Price
from rvjax.tolerances import Estimate


def summary(plan: Plan, bench: Bench, study: Study) -> str:
    """The plan in a few lines, in the units in which a person reads them."""
    unit, size = study.output(bench.name).shown

    def share(found: Estimate | None) -> str:
        assert found is not None  # a bench has a requirement
        return f"{100 * found.value:.2f} % [{100 * found.lower:.2f}, {100 * found.upper:.2f}]"

    lines = [f"Assembly {study.name}: {plan.status}, {len(plan.build)} units for {bench.name}"]
    if plan.status == "INFEASIBLE":
        failing = "; ".join(", ".join(f"{s} {i}" for s, i in _named(plan.build[k])) for k in plan.failing)
        lines.append(f"Every complete plan has at least {len(plan.failing)} units that fail: {failing}")
    if plan.status == "BOUNDED":
        lines.append(f"No plan can be better by more than {100 * plan.gap:.3g} % of its objective.")
    headers = ["", "random", "matched"]
    rows = [
        [f"mean ({unit})", f"{plan.random.value / size:.4g}", f"{np.mean(plan.values) / size:.4g}"],
        [f"worst unit, expected ({unit})", "-", f"{np.max(plan.values) / size:.4g}"],
        ["good units", share(plan.random_yield), share(plan.yield_)],
    ]
    lines += ["", table(headers, rows), "", f"gain of the mean: {estimate_text(plan.gain, unit, size)}"]
    left = {slot: ids for slot, ids in plan.left_over.items() if ids and slot != REST}
    for slot, ids in left.items():
        counts = {label: ids.count(label) for label in ids}
        lines.append(f"left over, {slot}: {', '.join(f'{k} x {n}' if n > 1 else str(k) for k, n in counts.items())}")
    return "\n".join(lines)


def _named(unit: dict[str, Any]) -> list[tuple[str, Any]]:
    return [(slot, label) for slot, label in unit.items() if slot != REST]


def build_rows(plan: Plan, bench: Bench, study: Study) -> tuple[list[str], list[list[str]]]:
    """Headers and rows of the list for the bench: unit, part and position of each slot, expected response."""
    unit, size = study.output(bench.name).shown
    slots = [slot for slot in plan.build[0] if slot != REST]
    headers = ["unit"]
    for slot in slots:
        headers += [slot, f"{slot} position"] if bench.kinds[slot].indices > 1 else [slot]
    rows = []
    for number, (parts, index, value) in enumerate(zip(plan.build, plan.index, plan.values), 1):
        row = [str(number)]
        for slot in slots:
            row.append(str(parts[slot]))
            if bench.kinds[slot].indices > 1:
                row.append(position(study.design, slot, index[slot]))
        rows.append([*row, f"{value / size:.10g}"])
    return [*headers, f"expected {bench.name} [{unit}]"], rows


def position(design: Any, slot: str, index: int) -> str:
    """A position in words."""
    over, turn = False, index
    kind, _, number = slot.rpartition("_")
    if kind == "disc":
        turn, over = disc_mountings(design, int(number), made_for=drawing(design, int(number)))[index]
    words = ["turned over"] if over else []
    words += [f"{360 * turn / design.cranks.count:g} deg"] if turn else []
    return ", ".join(words) or "as drawn"


def price_text(prices: Sequence[Price]) -> str:
    """Tighter tolerances or matching, as text; empty without prices."""
    if not prices:
        return ""
    headers = ["yield", "cost, random", "opened by", "cost, matched", "allocation"]
    rows = [[f"{100 * p.share:g} %", f"{p.alone:.3f}", f"{p.factor:.2f}", f"{p.matched:.3f}", p.status] for p in prices]
    return "\n" + table(headers, rows)


def as_json(plan: Plan, bench: Bench, study: Study, prices: Sequence[Price] = ()) -> dict[str, Any]:
    """Everything about a plan as JSON values, SI, with seed and versions."""
    about: dict[str, Any] = {"study": study.name, "response": bench.name, "seed": study.seed, "versions": versions()}
    found = {f.name: getattr(plan, f.name) for f in dataclasses.fields(plan)}
    return plain(about | {"requirement": bench.requirement, "prices": prices} | found)


def write(plan: Plan, bench: Bench, study: Study, source: str, folder: Path, prices: Sequence[Price] = ()) -> Path:
    """Write list, summary, JSON, study, parts and pictures into a new folder."""
    return write_files(_files(plan, bench, study, source, prices), folder)


def _files(plan: Plan, bench: Bench, study: Study, source: str, prices: Sequence[Price]) -> Iterator[tuple[str, bytes]]:
    yield "study.toml", study.text.encode()
    yield "parts.csv", Path(source).read_bytes()
    yield "summary.txt", (summary(plan, bench, study) + "\n" + price_text(prices)).encode()
    yield "build.csv", as_csv(*build_rows(plan, bench, study))
    yield "result.json", json_file(as_json(plan, bench, study, prices))
    yield "units.png", _picture(plan, bench, study)
    if prices:
        shares, alone, matched = zip(*((p.share, p.alone, p.matched) for p in prices))
        with plotting.style():
            yield "prices.png", saved(plotting.assembly.price_of_accuracy(shares, alone, matched).figure)


def _picture(plan: Plan, bench: Bench, study: Study) -> bytes:
    with plotting.style():
        axes = plotting.assembly.units(
            unit_values(bench, study.seed, plan),
            unit_values(bench, study.seed),
            unit=study.output(bench.name).unit,
            name=bench.name,
            upper=bench.requirement.upper,
            lower=bench.requirement.lower,
        )
        return saved(axes.figure)
