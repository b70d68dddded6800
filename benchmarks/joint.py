"""Tolerances of the embedded joint against standstill, against the worst speed, and against both at once.

    python -m benchmarks.joint           print the table of docs/models/dynamic_error.md and put it there
    python -m benchmarks.joint --print   only print it

No speeds are measured. The shares are quantiles of units that the allocation has not seen.
"""

import argparse
from pathlib import Path

import numpy as np

import rvjax
from rvjax import study, tolerances
from rvjax.study.response import Response
from rvjax.units import readable, um

PAGE = Path(__file__).parents[1] / "docs" / "models" / "dynamic_error.md"
BEGIN, END = "<!-- joint begins -->\n", "<!-- joint ends -->\n"
UNITS, FRESH = 20_000, 9  # behind the quantiles, and their seed


def rows() -> list[list[str]]:
    """One row for each set of requirements: which, cost, half-widths in um, what 99.73 % of the units keep."""
    question = study.load("rv-40e-joint")
    both = tuple(question.requirements)
    judge = Response.of(question.design, both, question.conditions)
    found = []
    for label, asked in (("standstill", both[:1]), ("worst speed", both[1:]), ("both", both)):
        best = tolerances.allocate(
            Response.of(question.design, asked, question.conditions),
            question.tolerances,
            {name: question.requirements[name] for name in asked},
            costs=question.costs,
            samples=question.samples,
            seed=question.seed,
            certificate_samples=UNITS,
        )
        units = tolerances.monte_carlo(judge, best.tolerances, samples=UNITS, seed=FRESH, keep=True)
        widths = [f"{float(getattr(best.tolerances, name).half_width) / um:.2f}" for name in question.fields]
        reached = []
        for name in both:
            shown, size = readable(question.output(name).unit)
            reached.append(f"{np.quantile(units.values[name], 0.9973) / size:.2f} {shown}")
        found.append([label, f"{float(best.cost):.2f}", *widths, *reached])
    heads = ["required", "cost", *(f"`{name}`" for name in question.fields), "99.73 % at standstill", "at worst speed"]
    return [heads, ["---"] + ["---:"] * (len(heads) - 1), *found]


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--print", action="store_true", help="leave the page as it is")
    options = parser.parse_args()
    rvjax.enable_x64()
    table = "\n".join("| " + " | ".join(row) + " |" for row in rows()) + "\n"
    print(table)
    if not options.print:
        before, rest = PAGE.read_text("utf-8").split(BEGIN)
        PAGE.write_text(before + BEGIN + "\n" + table + "\n" + END + rest.split(END)[1], "utf-8")


if __name__ == "__main__":
    main()
