"""A batch of RV-40E units that is killed (SIGKILL) at ten random moments and goes on each time, with its log.

`rvjax montecarlo rv-40e --checkpoint FILE` is started again after every kill; in the end its figures are compared, as
text with all digits, with those of an uninterrupted run.

    python -m benchmarks.kill_and_resume [--units 1.5e7] [--processes 2]
"""

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

KILLS = 10


def command(units, folder, name, *, processes, checkpoint=True):
    """The command line."""
    line = [sys.executable, "-m", "rvjax", "montecarlo", "rv-40e", "--quiet", "--samples", str(units)]
    line += ["--processes", str(processes), "--json", str(folder / f"{name}.json")]
    return line + (["--checkpoint", str(folder / "checkpoint")] if checkpoint else [])


def reached(folder):
    """Units in the checkpoints of all processes, and when they were last written."""
    units, written = 0, 0.0
    files = [path for path in folder.glob("checkpoint*") if path.suffix != ".partial"]
    for path in files:
        with np.load(path) as file:
            units += int(file["seen"].sum()) if "seen" in file.files else 0
        written = max(written, path.stat().st_mtime)
    return units, written


def main():
    """Kill, resume, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--units", type=float, default=1.5e7)
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    units, chance = int(options.units), random.Random(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | {
            "JAX_COMPILATION_CACHE_DIR": str(folder / "programs"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        quiet = dict(env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for kill in range(1, KILLS + 1):
            before, last = reached(folder)
            process = subprocess.Popen(command(units, folder, "resumed", processes=options.processes), **quiet)
            while process.poll() is None and reached(folder)[1] <= last:
                time.sleep(0.01)
            time.sleep(chance.uniform(0.0, 3.0))
            if process.poll() is not None:
                sys.exit(f"it ended after {kill - 1} kills: give more units")
            process.kill()
            process.wait()
            time.sleep(0.5)  # the processes of a killed command see that it is gone
            after, _ = reached(folder)
            print(f"kill {kill:2d}: {before:12,d} -> {after:12,d} of {units:,d} units", flush=True)
        for name, checkpoint in (("resumed", True), ("whole", False)):
            line = command(units, folder, name, processes=options.processes, checkpoint=checkpoint)
            subprocess.run(line, check=True, **quiet)
        results = [
            json.loads((folder / f"{name}.json").read_text())["result"]["fields"] for name in ("resumed", "whole")
        ]
        for result in results:
            result.pop("study")  # says which program ran only where there was a checkpoint
        texts = [json.dumps(result, sort_keys=True) for result in results]
        print(f"resumed to {results[0]['samples']:,d} units; failed {results[0]['failed']}")
        print("all digits of all figures equal those of the uninterrupted run:", texts[0] == texts[1])
        sys.exit(texts[0] != texts[1])


if __name__ == "__main__":
    main()
