"""An error budget as text, CSV and one picture."""

import csv
import io
from pathlib import Path

import numpy as np

from rvjax.report import text
from rvjax.study.budget import LEVELS, Budget
from rvjax.tolerances.atomic import write_atomically
from rvjax.units import KNOWN, arcsec

ORDERS_SHOWN = 8  # of the output turn, the largest


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
                row += [f"{rms / size:.3g}", f"{100 * shares[load][name]:.1f}", off]
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
        shown: how many; None for all.
    """
    size = np.max([total for total in budget.total.values()], axis=0)[1:]
    return sorted(1 + np.argsort(-size, kind="stable")[: len(size) if shown is None else shown])


def summary(budget: Budget) -> str:
    """The budget as text."""
    unit, size = read_in(budget)
    lines = [f"Error budget: {budget.title}", f"{budget.samples} units"]
    for load, torque in budget.torque.items():
        spread = np.sqrt(budget.total[load][1:].sum()) / size
        parts = sum(values[1:].sum() for values in budget.variance[load].values())
        together = parts / budget.total[load][1:].sum() if spread > 0 else 1.0
        lines.append(
            f"{load}, {torque:.4g} N m: {spread:.3g} {unit} rms over units and angles; the shares of single errors sum "
            f"to {100 * together:.0f} % of its square, more than 100 % where errors act together"
            + (f"; {budget.failed[load]} of {budget.samples} units failed" if budget.failed[load] else "")
        )
    return "\n".join([*lines, "", text.table(*share_rows(budget)), "", text.table(*order_rows(budget))])


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


def write(budget: Budget, folder: str | Path) -> Path:
    """Write budget.txt, budget.csv and budget.png.

    Args:
        budget: the error budget.
        folder: that exists.
    """
    import matplotlib.pyplot as plt

    from rvjax import plotting

    folder = Path(folder)
    write_atomically(folder / "budget.txt", (summary(budget) + "\n").encode("utf-8"))
    write_atomically(folder / "budget.csv", as_csv(budget).encode("utf-8"))
    with plotting.style():
        figure = plotting.error_budget(budget)
        image = io.BytesIO()
        figure.savefig(image, format="png")
        plt.close(figure)
    write_atomically(folder / "budget.png", image.getvalue())
    return folder
