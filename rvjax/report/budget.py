"""An error budget as text, JSON, CSV and one picture."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rvjax.report import folders, text
from rvjax.report.pictures import Picture, saved
from rvjax.study.budget import LEVELS, Budget
from rvjax.study.question import Study
from rvjax.units import KNOWN, arcsec

ORDERS_SHOWN = 8  # of the output turn, the largest
NOTHING = 1e-20  # of the mean square: rounding


def read_in(budget: Budget) -> tuple[str, float]:
    """Unit of an error budget and its SI size: arcseconds for angles."""
    return (
        ("arcsec", arcsec) if budget.unit == "rad" else (budget.unit, KNOWN.get(budget.unit, {}).get(budget.unit, 1.0))
    )


def share_rows(budget: Budget) -> tuple[list[str], list[list[str]]]:
    """Headers and rows: root mean square and share of every error, part and stage, under each load."""
    unit, size = read_in(budget)
    loads = list(budget.torque)
    headers = ["owner", "of", *(f"{load} {what}" for load in loads for what in (f"rms {unit}", "share %", "+-"))]
    rows = []
    for level in LEVELS:
        sums = {load: budget.by(level, load) for load in loads}
        shares = {load: budget.shares(level, load) for load in loads}
        for name in sums[loads[0]]:
            row = [name, budget.part[name] if level == "field" else level]
            for load in loads:
                whole = sum(float(values[1:].sum()) for values in sums[load].values())
                rms = np.sqrt(sums[load][name][1:].sum())
                off = f"{100 * budget.error[load][name] / whole:.1f}" if level == "field" and whole > 0 else ""
                row += [
                    f"{rms / size:.3g}" if rms**2 > NOTHING * whole else "0",
                    f"{100 * shares[load][name]:.1f}",
                    off,
                ]
            rows.append(row)
    return headers, rows


def order_rows(budget: Budget, shown: int | None = ORDERS_SHOWN) -> tuple[list[str], list[list[str]]]:
    """Headers and rows: root mean square of each order over the units, and who owns it, under each load.

    Args:
        budget: the error budget.
        shown: orders, the largest ones under any load; None for all.
    """
    unit, size = read_in(budget)
    loads = list(budget.torque)
    headers = ["order", *(f"{load} {what}" for load in loads for what in (f"rms {unit}", f"alike {unit}", "owner"))]
    rows = []
    for k in largest_orders(budget, shown):
        row = [f"{budget.orders[k]:.4g}"]
        for load in loads:
            owned = {name: values[k] for name, values in budget.variance[load].items()}
            owner = max(owned, key=owned.__getitem__) if owned else ""
            spread, alike = (np.sqrt(x[load][k]) / size for x in (budget.total, budget.alike))
            row += [f"{spread:.3g}", f"{alike:.3g}", owner if owned and owned[owner] > 0 else "-"]
        rows.append(row)
    return headers, rows


def largest_orders(budget: Budget, shown: int | None) -> list[int]:
    """Places of the orders with the largest variance under any load, ascending, without the mean.

    Args:
        budget: the error budget.
        shown: how many, without those of rounding alone; None for all.
    """
    size = np.max([total for total in budget.total.values()], axis=0)[1:]
    order = 1 + np.argsort(-size, kind="stable")
    return sorted(order if shown is None else [k for k in order[:shown] if size[k - 1] > NOTHING * size.sum()])


def load_names(budget: Budget) -> dict[str, str]:
    """The loads for a person, with their torque, which may be the name already."""
    shown = {load: f"{torque:.4g} N m" for load, torque in budget.torque.items()}
    return {load: name if load == name else f"{load}, {name}" for load, name in shown.items()}


def load_lines(budget: Budget) -> list[str]:
    """Under each load: how much varies, what errors do together, which no share knows, and units that failed."""
    unit, size = read_in(budget)
    lines = []
    for load, name in load_names(budget).items():
        share, error = (100 * figure for figure in budget.together[load])
        spread = np.sqrt(budget.total[load][1:].sum()) / size
        parts = sum(values[1:].sum() for values in budget.variance[load].values())
        sums = 100 * parts / budget.total[load][1:].sum() if spread > 0 else 100.0
        lines.append(
            f"{name}: {spread:.3g} {unit} rms over units and angles; at most {share:.2g} +- {error:.1g} % of its "
            f"square are errors together, which no linear share knows; single errors, each with its part in that, sum "
            f"to {sums:.0f} %"
            + (
                f"; {budget.failed[load]} of {budget.samples} units failed and are left out"
                if budget.failed[load]
                else ""
            )
        )
    return lines


def summary(budget: Budget) -> str:
    """The budget as text."""
    lines = [f"Error budget: {budget.title}", f"{budget.samples} units", *load_lines(budget)]
    return "\n".join([*lines, "", text.table(*share_rows(budget)), "", text.table(*order_rows(budget))])


def as_json(budget: Budget, study: Study) -> dict[str, Any]:
    """Everything about a budget with its shares, seed and versions, as JSON values; SI.

    Args:
        budget: the error budget.
        study: whose it is.
    """
    shares = {level: {load: budget.shares(level, load) for load in budget.torque} for level in LEVELS}
    about = {"study": study.name, "seed": study.seed, "versions": text.versions(), "shares": shares}
    return about | text.plain(budget)


def as_csv(budget: Budget) -> str:
    """Every number, one a line: load, order, error, part, mean square in SI; `total` and `alike` beside the errors."""
    file = io.StringIO()
    write = csv.writer(file, lineterminator="\n")
    write.writerow(["load", "torque N m", "order", "error", "part", f"mean square ({budget.unit})^2"])
    for load, torque in budget.torque.items():
        own = {name: (budget.part[name], values) for name, values in budget.variance[load].items()}
        for name, (part, values) in (own | {n: ("", getattr(budget, n)[load]) for n in ("total", "alike")}).items():
            write.writerows(
                [load, torque, f"{o:.10g}", name, part, repr(float(v))] for o, v in zip(budget.orders, values)
            )
    return file.getvalue()


def picture(budget: Budget, form: str = "png") -> Picture:
    """Shares of the parts and the largest orders.

    Args:
        budget: the error budget.
        form: "png" or "svg".
    """

    from rvjax import plotting

    with plotting.style():
        content = saved(plotting.error_budget(budget), form)
    largest = []
    for load in budget.torque:
        part, share = next(iter(budget.shares("part", load).items()), ("nothing", 0.0))
        largest.append(f"{load} {part} with {100 * share:.0f} %")
    return Picture("budget", f"Who owns the error, by part and by order: first of all {', '.join(largest)}", content)


def files(budget: Budget, study: Study) -> Iterator[tuple[str, bytes]]:
    """What a results folder holds: the study, the budget as text, JSON and CSV, and its picture.

    Args:
        budget: the error budget.
        study: whose it is.
    """
    yield "study.toml", study.text.encode()
    yield "summary.txt", (summary(budget) + "\n").encode()
    yield "result.json", folders.as_json(as_json(budget, study))
    yield "shares.csv", folders.as_csv(*share_rows(budget))
    yield "budget.csv", as_csv(budget).encode()
    yield "budget.png", picture(budget).content


def write(budget: Budget, study: Study, folder: str | Path) -> Path:
    """Write `files` into a new folder: all of them, or nothing; returns the folder.

    Args:
        budget: the error budget.
        study: whose it is.
        folder: that is wanted; where it is taken, the next free number.
    """
    return folders.write_files(files(budget, study), Path(folder))
