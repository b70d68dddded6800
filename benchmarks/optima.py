"""Frozen table of 56 allocations: cost, status, prices, units and CPU seconds, to compare changes with.

    python -m benchmarks.optima                                   all rows; a cut run continues
    python -m benchmarks.optima --only study "long lists"         rows by name or kind
    python -m benchmarks.optima --keep                            also write benchmarks/optima.json
    python -m benchmarks.optima --against benchmarks/optima.json  also apply the gates; exit code 1 where one fails
    python -m benchmarks.optima --seeds 3                         spread of the ratio over seeds of the quick rows

Gates: no cost more than 0.3 % above the frozen one, no status worse, no result called optimal below a known optimum,
no target of a study above the interval of its share of 16,384 other units, CPU seconds of the studies at most 25 %
above the frozen ones. CPU seconds count only if nothing else ran on the computer during either run. Quick rows run
twice in this process and the second run is timed. Studies and `rv-0` run once in their own process with kept programs,
and again where they first had to compile these.
"""

import argparse
import contextlib
import hashlib
import json
import math
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import numpy as np

import rvjax
from benchmarks.optima_problems import PROBLEMS, Problem
from benchmarks.timing import machine, settings
from rvjax._jax import programs
from rvjax.population import Population
from rvjax.response import BLOCK, Response, response_names
from rvjax.response.response import Compiled
from rvjax.tolerances import Allocation, Run, allocate

ROOT = Path(__file__).parents[1]
FROZEN, FOLDER = Path(__file__).with_suffix(".json"), ROOT / "build" / "optima"
DEARER, SLOWER, BELOW, QUIET = 1.003, 1.25, 0.999, 0.1  # QUIET: cores that other work may use
ORDER = ("OPTIMAL", "SUBOPTIMAL", "MAX_STEPS", "NOT_CERTIFIED", "INFEASIBLE")
CERTIFIED = ORDER[:3]
FRESH, FRESH_SEED = 16_384, 20_000
VALUES = {"respond", "_solved"}  # programs that give values of units, and gradients
SLOPES = {"pulled", "_pulled", "slopes", "_values_and_gradients"}
HEAD = f"{'problem':36} {'status':14} {'cost':>9} {'ratio':>7} {'price':>7} {'units':>11} {'gradients':>9} {'CPU s':>6}"

Row = dict[str, Any]


@contextlib.contextmanager
def units() -> Iterator[Counter[str]]:
    """Units whose values and gradients compiled programs compute, with the padding of calls except NaN."""
    found, call = Counter[str](), Compiled.__call__

    def counted(self: Any, response: Any, *arguments: Any, **static: Any) -> Any:
        name = getattr(self, "__name__", "")
        what = "values" if name in VALUES else "gradients" if name in SLOPES else None
        if what and not programs.inside(response, arguments):
            given = arguments[1]
            solved = name.startswith("_solved")
            found[what] += int(np.isfinite(np.asarray(given)).all(axis=0).sum()) if solved else int(given.shape[-1])
        return call(self, response, *arguments, **static)

    with mock.patch.object(Compiled, "__call__", counted):
        yield found


def solved(problem: Problem, seed: int | None, runs: int) -> Row:
    """Row of a problem; the last of the runs is counted and timed."""
    known = problem.make()
    given = known.arguments | ({} if seed is None else {"seed": seed})
    first = [given.pop(name) for name in ("response", "tolerances", "requirements")]
    for _ in range(runs):
        with units() as evaluated:
            start = time.process_time()
            found = allocate(*first, **given)
            seconds = time.process_time() - start
    row = figures(problem, found, known.optimum, known.prices) | {
        "units": evaluated["values"], "gradients": evaluated["gradients"], "seconds": round(seconds, 2),
    }  # fmt: skip
    return row | ({"fresh": fresh(first[0], first[2], found)} if problem.kind == "study" else {})


def fresh(response: Response, requirements: Any, found: Allocation) -> dict[str, tuple[float, float, float]]:
    """Share of other units that keep each limit of a result, the upper end of its interval, and the target."""
    population = Population.of(found.tolerances).replace(values=found.values or None)
    limits = {name: item for name, item in requirements.items() if item.of_shares}
    run = Run(response, population, response_names(response, population), limits, FRESH, FRESH_SEED, BLOCK, keep=False)
    shares = run.statistics().yield_
    return {name: (shares[name].value, shares[name].upper, item.target) for name, item in limits.items()}


def figures(problem: Problem, found: Allocation, optimum: float, exact: dict[str, float]) -> Row:
    """Values to compare: cost, or shortfall of an infeasible problem, over the least one."""
    by_name = lambda figure: figure if isinstance(figure, dict) else {"": figure}  # noqa: E731
    graded = found.graded.cost if found.graded else None
    lack = sum(by_name(found.shortfall).values())
    value = lack if problem.right == "INFEASIBLE" else graded if problem.kind == "grades" else found.cost
    status = found.graded.status if found.graded and problem.kind == "grades" else found.status
    row = {
        "kind": problem.kind, "status": status, "right": problem.right, "cost": value, "graded": graded,
        "optimum": optimum, "ratio": value / optimum, "prices": by_name(found.multipliers), "exact": exact,
    }  # fmt: skip
    return jax.tree.map(lambda x: rounded(x) if isinstance(x, float) else x, row)


def rounded(value: float) -> float | None:
    """Seven digits; None for nan."""
    return float(f"{value:.7g}") if math.isfinite(value) else None


def separate(name: str) -> Row:
    """Row of a problem in its own process, run again if that had to keep programs."""
    kept = {"XDG_CACHE_HOME": str(FOLDER), "TF_CPP_MIN_LOG_LEVEL": "3"}  # silent about flags of kept programs
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")} | kept
    line = [sys.executable, "-m", "benchmarks.optima", "--alone", name]
    for _ in range(2):
        before = set(FOLDER.rglob("*"))
        done = subprocess.run(line, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True)
        if set(FOLDER.rglob("*")) == before:
            break
    return dict(json.loads(done.stdout.splitlines()[-1]))


def busy() -> float:
    """CPU seconds of other processes since the computer began; of Linux, else nan."""
    try:
        user, nice, system, _, _, *more = map(int, Path("/proc/stat").read_text().splitlines()[0].split()[1:8])
    except OSError:
        return math.nan
    return (user + nice + system + sum(more)) / os.sysconf("SC_CLK_TCK") - sum(os.times()[:4])


def measured(name: str, seed: int | None = None) -> Row:
    """Row of a problem, with the cores that other work used in the meantime."""
    problem, before, start = PROBLEMS[name], busy(), time.perf_counter()
    row = separate(name) if problem.alone and seed is None else solved(problem, seed, 2 if seed is None else 1)
    row["others"] = rounded(round(max(0.0, busy() - before) / (time.perf_counter() - start), 2))
    jax.clear_caches()  # of programs that no other row needs
    return row


def shown(name: str, row: Row) -> str:
    """Line of the table; `price`: the largest error of a price that is known, in percent."""
    errors = [
        abs(row["prices"][key] / exact - 1) for key, exact in row["exact"].items() if row["prices"][key] is not None
    ]
    price, ratio = (f"{x:.{d}f}" if x is not None else "" for x, d in
                    ((100 * max(errors) if errors else None, 1), (row["ratio"], 4)))  # fmt: skip
    line = f"{name:36} {row['status']:14} {row['cost']:9.5g} {ratio:>7} {price:>7} {row['units']:11,} "
    line += f"{row['gradients']:9,} {row['seconds']:6.2f}{'' if quiet(row) else ' *'}"
    return line + "".join(f" {name} {100 * share:.3f}" for name, (share, *_) in row.get("fresh", {}).items())


def quiet(row: Row) -> bool:
    """True if no other work disturbed the measurement."""
    return row["others"] is not None and row["others"] <= QUIET


def certified(row: Row) -> bool:
    """True if the cost, or of an infeasible problem the shortfall, is one that a certificate supports."""
    return row["status"] == "INFEASIBLE" if row["right"] == "INFEASIBLE" else row["status"] in CERTIFIED


def failures(new: Row, old: Row) -> list[str]:
    """Gates that a row does not pass."""
    order = ORDER if old["right"] == "OPTIMAL" else ORDER[::-1]
    found = []
    if order.index(new["status"]) > order.index(old["status"]):
        found.append(f"status {new['status']} after {old['status']}")
    if certified(new) and certified(old):
        costs = [("cost", new["cost"], old["cost"]), ("cost with grades", new["graded"], old["graded"])]
        found += [
            f"{what} {100 * (one / other - 1):.2f} % above" for what, one, other in costs
            if None not in (one, other) and one > DEARER * other
        ]  # fmt: skip
    if certified(new) and new["ratio"] is not None and new["ratio"] < BELOW:
        found.append(f"certified at {new['ratio']:.4f} of the optimum")
    if certified(new):
        shares = new.get("fresh", {}).items()
        found += [f"{n}: {share:.5f} of other units for {aim}" for n, (share, upper, aim) in shares if upper < aim]
    if old["kind"] == "study" and quiet(new) and quiet(old) and new["seconds"] > SLOWER * old["seconds"]:
        found.append(f"CPU seconds {100 * (new['seconds'] / old['seconds'] - 1):.0f} % above")
    return found


def compared(rows: dict[str, Row], frozen: dict[str, Row]) -> bool:
    """Print the ratios to the frozen rows and the gates that fail; true if none does."""
    passed = True
    print(f"{'problem':36} {'cost':>7} {'units':>7} {'CPU s':>7}   (new / frozen)")
    for name, row in rows.items():
        if name not in frozen:
            print(f"{name:36} is not among the frozen rows")
            continue
        old, found = frozen[name], failures(row, frozen[name])
        ratios = [row[key] / old[key] if old[key] else math.nan for key in ("cost", "units", "seconds")]
        words = "; ".join(found) and "FAILS: " + "; ".join(found)
        disturbed = (
            "" if old["kind"] != "study" or (quiet(row) and quiet(old)) else "CPU seconds not compared: other work"
        )
        print(f"{name:36} " + " ".join(f"{ratio:7.4f}" for ratio in ratios) + f"   {words or disturbed}".rstrip())
        passed &= not found
    return passed


def revision() -> str:
    """Commit, with a mark where it is not all."""
    git = lambda *words: subprocess.run(["git", *words], cwd=ROOT, capture_output=True, check=True, text=True).stdout  # noqa: E731
    changed = git("status", "--porcelain", "--", "rvjax", "tests", "benchmarks/optima_problems.py")
    return git("rev-parse", "--short", "HEAD").strip() + (" with changes" if changed else "")


def digest() -> str:
    """Of what decides the rows."""
    parts = [*ROOT.glob("rvjax/**/*.py"), *ROOT.glob("rvjax/**/*.toml"), *ROOT.glob("tests/oracles/*.py")]
    parts += [*ROOT.glob("tests/codesign_*.py"), *ROOT.glob("benchmarks/optima_problems.py")]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(parts))).hexdigest()[:16]


def run(names: list[str], journal: Path | None) -> dict[str, Row]:
    """Run and show the rows; those that the journal has are not run again."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    lines = journal.read_text("utf-8").splitlines() if journal and journal.exists() else []
    made = digest()
    known = {name: row for at, name, row in map(json.loads, lines) if at == made}
    print(HEAD, flush=True)
    rows = {}
    for name in names:
        rows[name] = known.get(name) or measured(name)
        print(shown(name, rows[name]), flush=True)
        if journal and name not in known:
            with journal.open("a", encoding="utf-8") as file:
                file.write(json.dumps([made, name, rows[name]]) + "\n")
    if not all(map(quiet, rows.values())):
        print(f"* other work used more than {QUIET} cores: CPU seconds are not reliable")
    return rows


def write(rows: dict[str, Row], path: Path) -> None:
    """Freeze the rows, one a line."""
    disturbed = sum(not quiet(row) for row in rows.values())
    seconds = f"measured next to other work in {disturbed} of {len(rows)} rows" if disturbed else "measured alone"
    head = {"benchmark": "optima", "machine": machine(), "commit": revision(), "seconds": seconds}
    lines = [f"  {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items()]
    path.write_text(json.dumps(head, indent=1)[:-2] + ',\n "rows": {\n' + ",\n".join(lines) + "\n }\n}\n", "utf-8")


def spread(names: list[str], count: int) -> None:
    """Print the ratios, or costs, over the first seeds, and statuses other than the right one."""
    print(f"{'problem':36} least - largest")
    for name in names:
        rows = [measured(name, seed) for seed in range(count)]
        found = [row["ratio"] or row["cost"] for row in rows]
        wrong = Counter(row["status"] for row in rows if row["status"] != row["right"])
        print(f"{name:36} {min(found):.4f} - {max(found):.4f}  {dict(wrong) or ''}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", help="names or kinds of problems")
    parser.add_argument("--keep", action="store_true", help=f"freeze the rows in {FROZEN.name}")
    parser.add_argument("--against", type=Path, help="frozen rows that must not get worse")
    parser.add_argument("--seeds", type=int, help="run the quick rows with so many seeds")
    parser.add_argument("--alone", choices=PROBLEMS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    settings()  # JAX has not been used yet
    if options.alone:
        programs.keep(rvjax.__version__)
        print(json.dumps(solved(PROBLEMS[options.alone], None, 1)))
        return
    names = [n for n, p in PROBLEMS.items() if not options.only or {n, p.kind} & set(options.only)]
    if options.seeds:
        spread([name for name in names if not PROBLEMS[name].alone], options.seeds)
        return
    journal = None if options.only else FOLDER / "journal.jsonl"
    rows = run(names, journal)
    if options.keep:
        write(rows, FROZEN)
    passed = options.against is None or compared(rows, json.loads(options.against.read_text("utf-8"))["rows"])
    if journal:
        journal.unlink()
    sys.exit(not passed)


if __name__ == "__main__":
    main()
