"""All benchmarks with one command: each script in a process of its own, one JSON file and one table.

    python -m benchmarks.run                       everything but `gpu`, about half an hour
    python -m benchmarks.run --budget 300          what fits into five minutes, the quick ones first
    python -m benchmarks.run --only four_bar lost_motion --repeat 3
    python -m benchmarks.run --compare             the last two entries of the history: what got slower or faster
    python -m benchmarks.run --compare A B         two entries by name

The figures go into `benchmarks/history`, one file a day and computer; `--label` keeps two states of one day apart. The
newest figures of every script are those of the README. A script that ran several times has a measured scatter.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rvjax
from benchmarks import history

HERE = Path(__file__).parent
# Arguments of scripts whose usual size takes minutes, used within a budget.
SMALL = {
    "dynamic_error": ["--units", "1e5"],
    "monte_carlo": ["--units", "1e6"],
    "rare_failures": ["--units", "1000000"],
    "choices": ["--scenes", "200"],
    "whole": ["--only", "study.load", "first"],
}
ON_REQUEST = ("gpu",)  # needs one
LAST = ("allocation", "choices", "dynamics", "monte_carlo", "rare_failures", "whole")  # the slow ones


def scripts() -> list[str]:
    """Names of the scripts that publish figures, quick ones first."""
    others = ("run", "timing")
    names = [p.stem for p in HERE.glob("*.py") if p.stem not in others and "publish(" in p.read_text("utf-8")]
    return sorted(names, key=lambda name: (name in LAST, name))


def run(name: str, limit: float | None, small: bool) -> dict:
    """Figures of one script, or why there are none."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        command = [
            sys.executable,
            "-m",
            f"benchmarks.{name}",
            "--json",
            str(path),
            *(SMALL[name] if small else []),
        ]
        started = time.perf_counter()
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=limit, cwd=HERE.parent)
        except subprocess.TimeoutExpired:
            return {"missing": f"not done within {limit:.0f} s"}
        if done.returncode or not path.exists():
            return {"missing": f"exit code {done.returncode}: {done.stderr.strip().splitlines()[-1:]}"}
        entry = json.loads(path.read_text("utf-8"))
    machine = entry["machine"]
    versions = {"rvjax": rvjax.__version__, "jax": machine.pop("jax"), "python": machine.pop("python")}
    seconds = round(time.perf_counter() - started, 1)
    return {"seconds": seconds, "small": small, "machine": machine, "versions": versions, "figures": entry["figures"]}


def table(results: dict) -> str:
    """Every figure of every script."""
    lines = []
    for name, entry in results.items():
        lines.append(f"{name}: {entry['seconds']} s")
        for key, value in entry.get("figures", {}).items():
            lines.append(f"    {key:52s} {value:.4g}" if isinstance(value, float) else f"    {key:52s} {value}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=scripts(), metavar="NAME", help="these scripts")
    parser.add_argument("--budget", type=float, metavar="SECONDS", help="start nothing after it; smaller sizes")
    parser.add_argument("--repeat", type=int, default=1, metavar="N", help="runs of every script (default 1)")
    parser.add_argument("--label", default="", help="ends the name of the entry")
    parser.add_argument("--history", type=Path, default=history.HISTORY, metavar="FOLDER", help="where the entries are")
    parser.add_argument(
        "--compare", nargs="*", metavar="ENTRY", help="compare two entries instead; exit code 1: slower"
    )
    options = parser.parse_args()
    if options.compare is not None:
        sys.exit(compare(options.compare, options.history))
    end = time.monotonic() + options.budget if options.budget else None
    for name in options.only or [name for name in scripts() if name not in ON_REQUEST]:
        runs: list[dict] = []
        for number in range(options.repeat):
            left = None if end is None else end - time.monotonic()
            print(f"{name}, run {number + 1} of {options.repeat} ...", file=sys.stderr, flush=True)
            entry = (
                {"missing": "no time left"}
                if left is not None and left <= 0
                else run(name, left, end is not None and name in SMALL)
            )
            if "missing" in entry:
                print(f"{name}: {entry['missing']}", file=sys.stderr)
                break
            runs.append(entry)
        if runs:
            history.keep(name, history.together(runs), options.label, options.history)
    print(table(history.newest(options.history)))


def compare(names: list[str], folder: Path) -> int:
    """Print what changed between two entries; 1 if something got slower beyond noise, 2 if there are no two."""
    there = history.entries(folder)
    asked = names or list(there)[-2:]
    if len(asked) != 2 or not all(name in there for name in asked):
        print(f"two of these entries are needed: {', '.join(there) or 'there is none'}", file=sys.stderr)
        return 2
    before, after = (there[name] for name in asked)
    print(history.report(before, after))
    return int(any(change.beyond and change.slower > 1 for change in history.changes(before, after)))


if __name__ == "__main__":
    main()
