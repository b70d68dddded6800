"""All benchmarks with one command: each script in a process of its own, one JSON file and one table.

    python -m benchmarks.run                       everything, about half an hour
    python -m benchmarks.run --budget 300          what fits into five minutes, the quick ones first
    python -m benchmarks.run --only four_bar lost_motion

What is not run keeps its figures of last time in the file; every entry carries the machine and the day it belongs to.
"""

import argparse
import datetime
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
RESULTS = HERE / "results.json"
# Arguments of scripts whose usual size takes minutes, used within a budget.
SMALL = {"monte_carlo": ["--units", "1e6"], "rare_failures": ["--units", "1000000"], "choices": ["--scenes", "200"]}
LAST = ("allocation", "choices", "dynamics", "monte_carlo", "rare_failures")  # the slow ones


def scripts() -> list[str]:
    """Names of the scripts that publish figures, quick ones first."""
    names = [
        p.stem for p in HERE.glob("*.py") if p.stem not in ("run", "timing") and "publish(" in p.read_text("utf-8")
    ]
    return sorted(names, key=lambda name: (name in LAST, name))


def run(name: str, limit: float | None, small: bool) -> dict:
    """Figures of one script, or why there are none."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        command = [
            sys.executable,
            str(HERE / f"{name}.py"),
            "--json",
            str(path),
            *(SMALL.get(name, []) if small else []),
        ]
        started = time.perf_counter()
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=limit, cwd=HERE.parent)
        except subprocess.TimeoutExpired:
            return {"missing": f"not done within {limit:.0f} s"}
        if done.returncode or not path.exists():
            return {"missing": f"exit code {done.returncode}: {done.stderr.strip().splitlines()[-1:]}"}
        entry = json.loads(path.read_text("utf-8"))
    day = datetime.date.today().isoformat()
    return {"seconds": round(time.perf_counter() - started, 1), "day": day, "small": small, **entry}


def table(results: dict) -> str:
    """Every figure of every script."""
    lines = []
    for name, entry in results.items():
        lines.append(f"{name}: {entry.get('missing') or str(entry['seconds']) + ' s, ' + entry['day']}")
        for key, value in entry.get("figures", {}).items():
            lines.append(f"    {key:52s} {value:.4g}" if isinstance(value, float) else f"    {key:52s} {value}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=scripts(), metavar="NAME", help="these scripts")
    parser.add_argument("--budget", type=float, metavar="SECONDS", help="start nothing after it; smaller sizes")
    parser.add_argument("--json", type=Path, default=RESULTS, help=f"file to update (default {RESULTS.name})")
    options = parser.parse_args()
    results = json.loads(options.json.read_text("utf-8")) if options.json.exists() else {}
    end = time.monotonic() + options.budget if options.budget else None
    for name in options.only or scripts():
        left = None if end is None else end - time.monotonic()
        if left is not None and left <= 0:
            print(f"{name}: no time left", file=sys.stderr)
            continue
        print(f"{name} ...", file=sys.stderr, flush=True)
        entry = run(name, left, small=end is not None)
        if "missing" not in entry or name not in results:
            results[name] = entry
        else:
            print(f"{name}: {entry['missing']}; its old figures stay", file=sys.stderr)
        options.json.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
    print(table(results))


if __name__ == "__main__":
    main()
