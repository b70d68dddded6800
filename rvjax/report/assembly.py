"""A plan as text and files: what a person takes to the bench."""

import dataclasses
import io
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rvjax import plotting
from rvjax.assembly import Plan
from rvjax.mounting import disc_mountings, drawing
from rvjax.report.folders import as_csv, filled
from rvjax.report.text import plain, table, versions
from rvjax.study import Study
from rvjax.study.assembly import REST, Bench, unit_values
from rvjax.study.prices import Price
from rvjax.tolerances import Estimate


def summary(plan: Plan, bench: Bench, study: Study) -> str:
    """The plan in a few lines, in the units in which a person reads them."""
    unit, size = study.output(bench.name).shown

    def figure(found: Estimate) -> str:
        return f"{found.value / size:.4g} {unit} [{found.lower / size:.4g}, {found.upper / size:.4g}]"

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
    mean = Estimate(float(np.mean(plan.values)), 0.0, math.nan, math.nan)
    rows = [
        [f"mean ({unit})", f"{plan.random.value / size:.4g}", f"{mean.value / size:.4g}"],
        [f"worst unit, expected ({unit})", "-", f"{np.max(plan.values) / size:.4g}"],
        ["good units", share(plan.random_yield), share(plan.yield_)],
    ]
    lines += ["", table(headers, rows), "", f"gain of the mean: {figure(plan.gain)}"]
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

    def fill(scratch: Path) -> None:
        (scratch / "study.toml").write_text(study.text, "utf-8")
        shutil.copyfile(source, scratch / "parts.csv")
        (scratch / "summary.txt").write_text(summary(plan, bench, study) + "\n" + price_text(prices), "utf-8")
        (scratch / "build.csv").write_bytes(as_csv(*build_rows(plan, bench, study)))
        text = json.dumps(as_json(plan, bench, study, prices), indent=1, allow_nan=False)
        (scratch / "result.json").write_text(text, "utf-8")
        (scratch / "units.png").write_bytes(_picture(plan, bench, study))
        if prices:
            with plotting.style():
                axes = plotting.assembly.price_of_accuracy(
                    [p.share for p in prices], [p.alone for p in prices], [p.matched for p in prices]
                )
                (scratch / "prices.png").write_bytes(png(axes))

    return filled(folder, fill)


def _picture(plan: Plan, bench: Bench, study: Study) -> bytes:
    with plotting.style():
        return png(
            plotting.assembly.units(
                unit_values(bench, study.seed, plan),
                unit_values(bench, study.seed),
                unit=study.output(bench.name).unit,
                name=bench.name,
                upper=bench.requirement.upper,
                lower=bench.requirement.lower,
            )
        )


def png(axes: Any) -> bytes:
    """A picture as a file, closed."""
    import matplotlib.pyplot as plt

    file = io.BytesIO()
    axes.figure.savefig(file, format="png", dpi=150)
    plt.close(axes.figure)
    return file.getvalue()
