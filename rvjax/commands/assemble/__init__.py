"""`rvjax assemble`: from a list of measured parts to the list of units for the bench."""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import rvjax
from rvjax import assembly, commands, study
from rvjax.assembly import Plan
from rvjax.base import progress
from rvjax.base.files import versions
from rvjax.commands.assemble.matching import (
    Bench as Bench,
    Price as Price,
    bench,
    price_table,
    prices as prices,
    unit_values,
)
from rvjax.commands.assemble.parts import REST, Assembly as Assembly, section as section, table_of
from rvjax.mounting import disc_mountings, drawing
from rvjax.records import PyTree
from rvjax.render import CSV, TEXT, Cell, Figure, Interval, Note, Number, Quantity, Report, Table, Text, results_folder
from rvjax.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(kw_only=True)
class AssembleInputs(commands.Inputs):
    """Match the measured parts of a list for the smallest response, or for the most good units. The plan is evaluated
    with independent samples of the measurement error. A build list goes to a results folder.

    examples:
      rvjax assemble my-study.toml parts.csv

    The list has the columns kind (disc, crank, carrier, or your own name such as pins), id, optionally stock, and
    measured errors with their unit, such as "bearing_clearance [um]" or "disc_bore[0,1] [um]". The table [assembly]
    of the study names the response that decides and the standard deviation of the measurement. Ctrl-C during the
    search writes the best plan so far. exit code 1: every complete plan has a unit that fails, or the search was
    interrupted.
    """

    source: str = commands.study_argument()
    parts: str = commands.argument("measured parts", "PARTS.csv")
    prices: bool = commands.switch(
        "cost of tolerances for random assembly and for matching (runs the allocation three times)"
    )
    encoding: str | None = commands.encoding_option()
    results: str | None = commands.results_option("STUDY-assembly")
    quiet: bool = commands.quiet_option()

    def __post_init__(self) -> None:
        """Read the study; the unit without errors is solved with the parts."""
        self.study = study.load(self.source, solve=False)
        self.folder = results_folder(self.results, f"{self.study.name}-assembly")
        self.phases = (commands.READING, MATCHING, *([PRICING] if self.prices else []), commands.WRITING)


MATCHING, PRICING = "which part goes with which", "prices of tolerances"


@dataclasses.dataclass(frozen=True, eq=False)
class Assembled:
    """A plan of assembly.

    Attributes:
        parts: measured ones.
        plan: which of them make which unit.
        prices: cost of tolerances; empty without the option.
    """

    parts: Bench
    plan: Plan
    prices: tuple[Price, ...] = ()


def _mirrored(plan: Plan, objective: str) -> Plan:
    """The plan of the opposite response in values of the response itself; its bound is an upper one."""
    own, sense = plan.random, 1 if objective == "yield" else -1
    random = dataclasses.replace(own, value=-own.value, lower=-own.upper, upper=-own.lower)
    bounds = dataclasses.replace(plan, objective=sense * plan.objective, lower_bound=sense * plan.lower_bound)
    return dataclasses.replace(bounds, values=-plan.values, random=random)


def compute(inputs: AssembleInputs) -> Assembled:
    """Compute the plan, and prices if required."""
    study, how = inputs.study, table_of(inputs.study)
    parts = bench(study, inputs.parts, encoding=inputs.encoding)
    progress.begin(MATCHING)
    response, requirement = parts.small
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", assembly.UnusualPart)  # the report names them with their rows
        plan = assembly.plan(
            response,
            parts.kinds,
            objective=how.objective,
            requirement=requirement,
            draws=how.draws,
            certificate_draws=how.certificate_draws,
            seed=study.seed,
            keep_best=True,
            **parts.most,
        )
    if plan.status == "INFEASIBLE":
        study.check_nominal()  # the message is clearer if this unit fails too
    found = Assembled(parts, plan if parts.sense > 0 else _mirrored(plan, how.objective))
    if not inputs.prices:
        return found
    progress.begin(PRICING)
    return dataclasses.replace(found, prices=tuple(prices(study, parts)))


def report(inputs: AssembleInputs, found: Assembled) -> Report:
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
        files={"study.toml": study.text.encode(), "parts.csv": Path(inputs.parts).read_bytes()},
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


def _units(study: Study, found: Assembled) -> "Axes":
    parts = found.parts
    return rvjax.plotting.matched_units(
        unit_values(parts, study.seed, found.plan),
        unit_values(parts, study.seed),
        unit=study.output(parts.name).unit,
        name=parts.name,
        limits=(parts.requirement.lower, parts.requirement.upper),
    )


def _price_plot(prices: Sequence[Price]) -> "Axes":
    alone, matched = "tighter tolerances, random assembly", "opened tolerances, matched parts"
    axes = rvjax.plotting.lines(
        [100 * price.share for price in prices],
        {alone: [price.alone for price in prices], matched: [price.matched for price in prices]},
        looks={alone: {"color": "C1", "ls": "--", "marker": "s"}, matched: {"color": "C0", "ls": "-", "marker": "o"}},
        xlabel="yield (%)",
        ylabel="cost of the tolerances",
        title="Tighter tolerances or matching",
    )
    axes.set_ylim(0, None)
    return axes
