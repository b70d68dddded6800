"""Allocations compared with optima that are known without sampling: a table of docs/optimum.md.

python -m benchmarks.known_optima [--only NAME] [--certificate 16e6]
"""

import argparse
import time

import rvjax
from rvjax.tolerances import allocate
from tests.oracles.known_optima import CASES

ROW = "| {} | {:.4f} | {} | {:.4f} | {:.4f} | {} | {:.3f} |"


def main():
    """Print the rows of the table, one a case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=CASES)
    parser.add_argument("--certificate", type=float, default=16e6)
    options = parser.parse_args()
    rvjax.enable_x64()
    for name, make in CASES.items():
        if options.only not in (None, name):
            continue
        case, started = make(), time.perf_counter()
        found = allocate(
            case.response,
            case.tolerances,
            case.requirements,
            costs=case.costs,
            samples=65536 if len(case.costs) < 100 else 16384,
            certificate_samples=int(options.certificate if len(case.costs) < 100 else options.certificate / 4),
        )
        printed = "-" if case.published is None else f"{case.published:.2f}"
        ratio = found.cost / case.optimum
        print(ROW.format(name, case.optimum, printed, found.cost, ratio, found.status, found.residual), flush=True)
        print(f"    {case.source}; {time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()
