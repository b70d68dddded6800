"""Report of `rvjax assemble`: the plan compared with random assembly, the list for the bench, a plot of the units."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import rvjax
from rvjax.assembly import Plan
from rvjax.base.files import versions
from rvjax.commands.assemble.compute import Assembled, Price
from rvjax.commands.assemble.inputs import Inputs
from rvjax.commands.assemble.parts import REST, unit_values
from rvjax.mounting import disc_mountings, drawing
from rvjax.records import PyTree
from rvjax.render import CSV, TEXT, Cell, Figure, Interval, Note, Number, Quantity, Report, Share, Table, Text
from rvjax.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def report(inputs: Inputs, found: Assembled) -> Report:
    """The report on a plan.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    study, plan, parts = inputs.study, found.plan, found.parts
    output = study.output(parts.name)
    unit: Mapping[str, PyTree] = {"unit": output.unit, "read_in": output.read_in}
    gain = Quantity.of(plan.gain, **unit)
    prices = [price_table(found.prices)] if found.prices else []
    figures = [Figure("units", f"Units of the plan and random units: {parts.name}", lambda: _units(study, found))]
    if prices:
        figures.append(Figure("prices", "Cost against yield, random and matched", lambda: _price_plot(found.prices)))
    about = {"study": study.name, "response": parts.name, "seed": study.seed, "versions": versions()}
    return Report(
        title=f"{study.name}: assembly",
        content=(
            Note(
                "\n".join(
                    [*parts.notes, *parts.unusual[:MOST], *_others(parts.unusual), *_verdict(study, plan, parts.name)]
                )
            ),
            _compared(plan, parts.sense, *output.shown),
            Note("\n".join([f"gain of the mean: {gain.text()}", *_left(plan)])),
            *prices,
            _build(study, found, unit),
            *figures,
        ),
        status=plan.status,
        ok=plan.status != "INFEASIBLE" and not plan.unsearched,
        data=about
        | {"requirement": parts.requirement, "prices": found.prices, "unusual": parts.unusual}
        | {f.name: getattr(plan, f.name) for f in dataclasses.fields(plan)},
        files={"study.toml": study.text.encode(), "parts.csv": Path(inputs.source).read_bytes()},
    )


MOST = 5
"""Unusual parts that are named."""


def _others(unusual: Sequence[str]) -> list[str]:
    """Line on the parts that are not named."""
    more = len(unusual) - MOST
    return [f"{more} more parts lie as far; a whole column may have the wrong unit"] if more > 0 else []


def _verdict(study: Study, plan: Plan, name: str) -> list[str]:
    lines = [f"Assembly {study.name}: {plan.status}, {len(plan.build)} units for {name}"]
    if plan.status == "INFEASIBLE":
        units = (plan.build[k].items() for k in plan.failing)
        failing = "; ".join(", ".join(f"{slot} {part}" for slot, part in unit if slot != REST) for unit in units)
        lines.append(f"Every complete plan has at least {len(plan.failing)} units that fail: {failing}")
    if plan.unsearched:
        lines.append(
            f"Interrupted: this is the best plan so far. {plan.unsearched} starts of the search were not used."
        )
    if plan.valued < plan.combinations:
        left = plan.combinations - plan.valued
        lines.append(f"{plan.valued:,} combinations of parts are evaluated; {left:,} others are estimated.")
    if plan.status == "SEARCHED":
        lines.append("No bound exists: how much better other plans can be is unknown.")
    elif plan.status == "BOUNDED":
        checked = f", if all estimates are as good as in {plan.checks:,} comparisons" if plan.checks else ""
        lines.append(f"No plan can be better by more than {100 * plan.gap:.3g} % of its objective{checked}.")
    return lines


def _compared(plan: Plan, sense: int, unit: str, size: float) -> Table:
    """Statistics of random units and of the units of the plan."""
    assert plan.random_yield is not None and plan.yield_ is not None  # a list of parts has a requirement
    rows = [
        [f"mean ({unit})", plan.random.value / size, np.mean(plan.values) / size],
        [f"worst unit, expected ({unit})", None, sense * np.max(sense * plan.values) / size],
        ["good units", *(Quantity.of(found, read_in="%", form=".2f") for found in (plan.random_yield, plan.yield_))],
    ]
    return Table("compared", [Text(""), Interval("random"), Interval("matched")], rows, on=frozenset({TEXT}))


def _left(plan: Plan) -> list[str]:
    """Parts that no unit has."""
    lines = []
    for slot, ids in plan.left_over.items():
        counts = {label: ids.count(label) for label in ids}
        if ids and slot != REST:
            said = ", ".join(f"{label} x {n}" if n > 1 else str(label) for label, n in counts.items())
            lines.append(f"left over, {slot}: {said}")
    return lines


def _build(study: Study, found: Assembled, unit: Mapping[str, PyTree]) -> Table:
    """The list for the bench: unit, part and position of each slot, expected response."""
    plan, kinds = found.plan, found.parts.kinds
    columns: list[Text | Number] = [Text("unit")]
    slots = [slot for slot in plan.build[0] if slot != REST]
    for slot in slots:
        columns += [Text(slot), Text(f"{slot} position")] if kinds[slot].indices > 1 else [Text(slot)]
    name = f"expected {found.parts.name} [{study.output(found.parts.name).shown[0]}]"
    columns.append(Number(name, **unit))
    rows = []
    for number, (parts, index, value) in enumerate(zip(plan.build, plan.index, plan.values), 1):
        row: list[Cell] = [number]
        for slot in slots:
            row.append(str(parts[slot]))
            row += [position(study.design, slot, index[slot])] if kinds[slot].indices > 1 else []
        rows.append([*row, value])
    return Table("build", columns, rows, on=frozenset({CSV}))


def position(design: PyTree, slot: str, index: int) -> str:
    """A position in words.

    Args:
        design: of the reducer.
        slot: of the part.
        index: of the position.
    """
    over, turn = False, index
    kind, _, number = slot.rpartition("_")
    if kind == "disc":
        turn, over = disc_mountings(design, int(number), made_for=drawing(design, int(number)))[index]
    words = ["turned over"] if over else []
    words += [f"{360 * turn / design.counts[design.places]:g} deg"] if turn else []
    return ", ".join(words) or "as on the drawing"


def price_table(prices: Sequence[Price]) -> Table:
    """Tighter tolerances or matching."""
    columns = [
        Share("yield", form="g"),
        Number("cost, random", form=".3f"),
        Number("opened by", form=".2f"),
        Number("cost, matched", form=".3f"),
        Text("allocation"),
    ]
    rows = [[price.share, price.alone, price.factor, price.matched, price.status] for price in prices]
    return Table("prices", columns, rows, on=frozenset({TEXT}))


def _units(study: Study, found: Assembled) -> "Axes":
    parts = found.parts
    return rvjax.plotting.assembly.units(
        unit_values(parts, study.seed, found.plan),
        unit_values(parts, study.seed),
        unit=study.output(parts.name).unit,
        name=parts.name,
        upper=parts.requirement.upper,
        lower=parts.requirement.lower,
    )


def _price_plot(prices: Sequence[Price]) -> "Axes":
    yields = zip(*((price.share, price.alone, price.matched) for price in prices))
    return rvjax.plotting.assembly.price_of_accuracy(*yields)
