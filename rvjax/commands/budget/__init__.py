"""`rvjax budget`: the contribution of every error to the variance of a curve, by error, part, stage and order.

Tables and plot of a curve, table of a response without one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import rvjax
from rvjax import study
from rvjax.base import progress as phase
from rvjax.base.files import versions
from rvjax.commands import READING, WRITING, Inputs, option, quiet_option, results_option, study_argument, whole_number
from rvjax.commands.budget.budgets import (
    Budget as Budget,
    ScalarBudget,
    budget_if_any as budget_if_any,
    curve_of,
    error_budget as error_budget,
    scalar_budget,
)
from rvjax.commands.budget.effects import LEVELS, SHARE_MEANS, UNMOVED_MEANS, influence_share, slope_text, together_text
from rvjax.commands.forecast import forewarn
from rvjax.render import (
    CSV,
    EVERYWHERE,
    Cell,
    Column,
    Figure,
    Interval,
    Note,
    Number,
    Quantity,
    Report,
    Section,
    Table,
    Text,
    results_folder,
)
from rvjax.study import Study, quantity
from rvjax.units import arcsec, readable, with_unit

__all__ = ["Budget", "budget_if_any", "error_budget", "report_on", "section_on"]


@dataclass(kw_only=True)
class BudgetInputs(Inputs):
    """Compute the share of every error, part and stage in the variance of the transmission error along the output, by
    order of the output revolution and for two torques. Tables and a plot go to a results folder. A response without
    a curve, such as a bearing life, has shares of its variance over the units, and slopes.

    examples:
      rvjax budget rv-40e-whole
      rvjax budget rv-40e-whole --output life
      rvjax budget my-study.toml --torque "412 N m" --torque "12.4 N m" --samples 1000

    The tolerances are those of the study. A share is the mean change of a harmonic, or of the response, when one
    error is sampled again, not a derivative. The report also bounds what errors cause together. The folder contains
    summary.txt, shares.csv, budget.csv (every order), result.json (SI units), budget.png and study.toml.
    """

    source: str = study_argument(": rv-40e-whole (default), rv-40e", default="rv-40e-whole")
    output: str | None = option(
        "response of the study: its curve if it is a value of one, else the response itself (default: the first curve)",
        "RESPONSE",
    )
    torque: list[str] | None = option(
        "output torque such as '412 N m', may be repeated (default: the torque of the study, and a thousandth of it)",
        "TORQUE",
        action="append",
    )
    samples: int = option(
        "units, each solved twice and once for every error (default: 256)", "N", default=256, type=whole_number
    )
    seed: int | None = option("seed of the random numbers (default: the study's)", type=int)
    results: str | None = results_option("STUDY-budget")
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the study; each torque is given once."""
        self.study = study.load(self.source, solve=False)
        self.loads = {torque: quantity(torque, "N m", "--torque") for torque in self.torque or ()}
        if len(set(self.loads.values())) < len(self.torque or ()):
            raise ValueError(f"--torque {', '.join(self.torque or ())}: each torque once")
        self.folder = results_folder(self.results, f"{self.study.name}-budget")
        self.phases = (READING, COUNTED, WRITING)
        forewarn(self.study)


COUNTED = "error budget"
"""Phase whose part done is known."""


def compute(inputs: BudgetInputs) -> Budget | ScalarBudget:
    """The budget of the tolerances of the study."""
    inputs.study.check_nominal()
    phase.begin(COUNTED)
    named = tuple(inputs.study.requirements) if inputs.output is None else (inputs.output,)
    if set(named) <= set(inputs.study.requirements) and curve_of(inputs.study, inputs.output) is None:
        if inputs.loads:
            raise ValueError(f"--torque: {named[0]} has no curve along the output; its torque is that of the study")
        return scalar_budget(inputs.study, named[0], samples=inputs.samples, seed=inputs.seed)
    return error_budget(
        inputs.study, output=inputs.output, loads=inputs.loads or None, samples=inputs.samples, seed=inputs.seed
    )


def report(inputs: BudgetInputs, found: Budget | ScalarBudget) -> Report:
    """The report on a budget.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    return report_on_scalar(found, inputs.study) if isinstance(found, ScalarBudget) else report_on(found, inputs.study)


ORDERS_SHOWN = 8  # of the output turn, the largest
NOTHING = 1e-20  # of the mean square: rounding


def report_on(budget: Budget, study: Study) -> Report:
    """The report on a budget.

    Args:
        budget: the error budget.
        study: that it belongs to.
    """
    head = [f"Study {study.name}", f"Error budget: {budget.title}", f"{budget.samples} units", *_load_lines(budget)]
    head += [f"Inaccurate: {line}" for line in study.inaccurate()]
    shares = {level: {load: budget.shares(level, load) for load in budget.torque} for level in LEVELS}
    about = {"study": study.name, "seed": study.seed, "versions": versions(), "shares": shares}
    return Report(
        title=f"{study.name}: error budget",
        content=(
            Note("\n".join(head)),
            _shares(budget),
            _orders(budget),
            Table("budget", *_everything(budget), on=frozenset({CSV})),
            _figure(budget),
        ),
        data=about | vars(budget),
        files={"study.toml": study.text.encode()},
    )


def section_on(budget: Budget) -> Section:
    """The budget on the page of other results: a plot, and the shares of the parts."""
    how = "change of the harmonics of {:,} units when one error is resampled."
    if budget.linear:
        how = "regression of the harmonics of {:,} units on their errors. Not included: no load, see rvjax budget."
    about = f"{budget.title}, with the tolerances after: {how.format(budget.samples)}"
    lines = Note("\n".join(f"{line}." for line in _load_lines(budget)))
    return Section("Error budget", (Note(about), _figure(budget), lines, _shares(budget, ("part",), errors=False)))


def _read_in(budget: Budget) -> tuple[str, float]:
    """Unit in which a budget is read and its SI size: arcseconds for angles."""
    return ("arcsec", arcsec) if budget.unit == "rad" else readable(budget.unit, budget.unit)


def _shares(budget: Budget, levels: tuple[str, ...] = LEVELS, *, errors: bool = True) -> Table:
    """Root mean square and share of every error, part and stage, under each load.

    Args:
        budget: the error budget.
        levels: of the rows: "field", "part", "stage".
        errors: with the standard error of each share, and with the part of each error.
    """
    unit, _ = _read_in(budget)
    columns: list[Column] = [Text("owner" if errors else "part"), *([Text("of")] if errors else [])]
    for load in budget.torque:
        columns.append(Number(f"{load} rms {unit}", form=".3g", unit=budget.unit, read_in=unit))
        columns.append(Number(f"{load} share %", form=".1f"))
        columns += [Number(f"{load} +-", missing="", form=".1f")] if errors else []
    return Table("shares", columns, list(_share_rows(budget, levels, errors)))


def _share_rows(budget: Budget, levels: tuple[str, ...], errors: bool) -> Iterator[list[object]]:
    for level in levels:
        sums = {load: budget.by(level, load) for load in budget.torque}
        shares = {load: budget.shares(level, load) for load in budget.torque}
        for name in next(iter(sums.values())):
            row: list[Any] = [name, *([budget.part[name] if level == "field" else level] if errors else [])]
            for load, owned in sums.items():
                whole = sum(float(values[1:].sum()) for values in owned.values())
                square = float(owned[name][1:].sum())
                row += [np.sqrt(square) if square > NOTHING * whole else 0.0, 100 * shares[load][name]]
                known = level == "field" and whole > 0
                row += [100 * budget.error[load][name] / whole if known else None] if errors else []
            yield row


def _orders(budget: Budget) -> Table:
    """Root mean square of the largest orders over the units, and the main contributor to each, under each load."""
    unit, _ = _read_in(budget)
    size: dict[str, Any] = {"form": ".3g", "unit": budget.unit, "read_in": unit}
    columns: list[Column] = [Number("order")]
    for load in budget.torque:
        columns += [Number(f"{load} {name} {unit}", **size) for name in ("rms", "in every unit")]
        columns.append(Text(" ".join((load, "owner"))))
    rows = []
    for k in _largest_orders(budget, ORDERS_SHOWN):
        row: list[Any] = [budget.orders[k]]
        for load in budget.torque:
            owned = {name: values[k] for name, values in budget.variance[load].items()}
            owner = max(owned, key=owned.__getitem__) if owned else ""
            row += [np.sqrt(budget.total[load][k]), np.sqrt(budget.alike[load][k])]
            row.append(owner if owned and owned[owner] > 0 else None)
        rows.append(row)
    note = "rms: over the units, without what is in every unit: that of the design and its load"
    return Table("orders", columns, rows, note=note, on=EVERYWHERE - {CSV})


def _largest_orders(budget: Budget, shown: int) -> list[int]:
    """Places of the orders with the largest variance under any load, ascending, without the mean and rounding.

    Args:
        budget: the error budget.
        shown: how many at most.
    """
    size = np.max([total for total in budget.total.values()], axis=0)[1:]
    order = 1 + np.argsort(-size, kind="stable")
    return sorted(int(k) for k in order[:shown] if size[k - 1] > NOTHING * size.sum())


def _everything(budget: Budget) -> tuple[list[Column], list[list[object]]]:
    """All values, one in a row: errors, `total` and `alike`."""
    titles = ("load", "torque N m", "order", "error", "part", f"mean square ({budget.unit})^2")
    rows: list[list[Any]] = []
    for load, torque in budget.torque.items():
        own = {name: (budget.part[name], values) for name, values in budget.variance[load].items()}
        for name, (part, values) in (own | {n: ("", getattr(budget, n)[load]) for n in ("total", "alike")}).items():
            rows += [[load, torque, f"{o:.10g}", name, part, float(v)] for o, v in zip(budget.orders, values)]
    return [Column(title) for title in titles], rows


def _load_lines(budget: Budget) -> list[str]:
    """Variation under each load, bound of the interactions and failed units, a line each."""
    unit, size = _read_in(budget)
    lines = []
    for load, torque in budget.torque.items():
        named = f"{torque:.4g} N m"
        share, error = (100 * part for part in budget.together[load])
        spread = np.sqrt(budget.total[load][1:].sum()) / size
        together = "comes from errors that act together; it counts in the share of each of them"
        if budget.linear:
            together = "is not linear in the errors; these shares do not contain it"
        failed = budget.failed[load]
        lines.append(
            f"{load if load == named else f'{load}, {named}'}: {with_unit(spread, unit, '.3g')} rms over units and "
            "angles; "
            f"at most {share:.2g} +- {error:.1g} % of its variance {together}"
            + (f"; {failed} of {budget.samples} units failed and are excluded" if failed else "")
        )
    return lines


def _figure(budget: Budget) -> Figure:
    """Shares of the parts and the largest orders."""
    largest = []
    for load in budget.torque:
        part, share = next(iter(budget.shares("part", load).items()), ("nothing", 0.0))
        largest.append(f"{load} {part} with {100 * share:.0f} %")
    caption = f"Error budget by part and by order; largest: {', '.join(largest)}"
    return Figure("budget", caption, lambda: rvjax.plotting.error_budget(budget).axes[0])


def report_on_scalar(budget: ScalarBudget, study: Study) -> Report:
    """The report on the budget of a response.

    Args:
        budget: the error budget.
        study: that it belongs to.
    """
    output, found = study.output(budget.output), budget.influence
    unit, size = output.shown
    whole = sum(found.variance.values())
    rows: list[list[Cell]] = []
    for level in LEVELS:
        for name, square in budget.by(level).items():
            row: list[Cell] = [name, budget.part[name] if level == "field" else level, np.sqrt(square) / size]
            if level == "field":
                row += [influence_share(found, name), slope_text(found, name, study, output)]
            else:
                row += [Quantity(square / whole if whole > 0 else 0.0, read_in="%", form=".1f"), ""]
            rows.append(row)
    excluded = f"; {found.failed} failed and are excluded" if found.failed else ""
    head = [
        f"Study {study.name}",
        *(f"Inaccurate: {line}" for line in study.inaccurate()),
        f"Error budget: {budget.output}, {output.meaning}",
        f"{found.units} units{excluded}: mean {with_unit(found.mean / size, unit)}, "
        f"standard deviation {with_unit(found.sd / size, unit)}",
        "slope: derivative to one element of the error, mean over the units, root mean square over its elements",
        *filter(None, [UNMOVED_MEANS, SHARE_MEANS, together_text({budget.output: found})]),
    ]
    columns = [Text("owner"), Text("of"), Number(f"sd {unit}", form=".3g"), Interval("share [interval]"), Text("slope")]
    data = {"study": study.name, "seed": study.seed, "versions": versions(), "unit": output.unit}
    return Report(
        title=f"{study.name}: error budget of {budget.output}",
        content=(Note("\n".join(head)), Table("shares", columns, rows)),
        data=data | {"output": budget.output, "part": budget.part} | vars(found),
        files={"study.toml": study.text.encode()},
    )
