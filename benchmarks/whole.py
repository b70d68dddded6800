"""Commands as a user waits for them: whole processes, from the start of Python to the last file.

    python -m benchmarks.whole                               this checkout
    python -m benchmarks.whole --against /path/to/checkout   in turn with another commit, and their ratios
    python -m benchmarks.whole --only study                  some of them, by the beginning of their names

Every command runs first with an empty folder of kept programs and then, where its row says so, again with what that run
has kept. Run it on an idle computer: the times are wall times.
"""

import argparse
import compileall
import math
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.timing import publish

ROOT = Path(__file__).parents[1]
ACCURACY = ROOT / "benchmarks" / "accuracy.toml"  # rv-40e-whole as older commits read it: no limits on life and forces
RVJAX = [sys.executable, "-m", "rvjax"]
EQUILIBRIUM = """
import time, rvjax; rvjax.enable_x64()
from rvjax.loaded.cases import MACHINE
start = time.perf_counter()
float(rvjax.loaded.equilibrium(MACHINE, rvjax.RVErrors(), input_angle=0.1, output_torque=412.0).error)
print(time.perf_counter() - start)
"""
LOAD = """
import time, rvjax; rvjax.enable_x64()
from rvjax import study
start = time.perf_counter()
study.load("rv-40e-whole")
print(time.perf_counter() - start)
"""


class Command(NamedTuple):
    """One row.

    Attributes:
        name: of the figure.
        run: command line.
        again: command line of a second run that finds kept programs, or None.
        timed: whether the process prints the seconds that count, instead of being timed as a whole.
    """

    name: str
    run: list[str]
    again: list[str] | None = None
    timed: bool = False


def commands() -> list[Command]:
    """All rows."""
    identify = [*RVJAX, "identify", "--quiet"]
    return [
        _fresh("allocate accuracy", ACCURACY.name),
        _fresh("allocate rv-40e-whole", "rv-40e-whole"),
        _fresh("allocate three cranks", "three-cranks.toml"),
        _fresh("allocate rv-40e", "rv-40e"),
        _twice("montecarlo accuracy", [*RVJAX, "montecarlo", ACCURACY.name, "--samples", "4096", "--quiet"]),
        _twice("montecarlo rv-40e-whole", [*RVJAX, "montecarlo", "rv-40e-whole", "--samples", "4096", "--quiet"]),
        Command("result and page", [*RVJAX, "allocate", "rv-40e", "--quiet"], [*RVJAX, "report", "rv-40e", "--quiet"]),
        Command("identify a loaded unit", [*identify, "loaded.toml", "loaded-unit.csv"]),
        _twice("identify a four-bar unit", [*identify, "four-bar.toml", "unit.csv"]),
        Command("assemble 200 loaded sets", [*RVJAX, "assemble", "loaded-sets.toml", "sets.csv", "--quiet"]),
        Command("assemble three cranks", [*RVJAX, "assemble", "four-bar-sets.toml", "three.csv", "--quiet"]),
        Command("first equilibrium", [sys.executable, "-c", EQUILIBRIUM], timed=True),
        Command("study.load rv-40e-whole", [sys.executable, "-c", LOAD], timed=True),
    ]


def _fresh(name: str, study: str) -> Command:
    line = [*RVJAX, "allocate", study, "--quiet"]
    return Command(name, line, [*line, "--fresh"])


def _twice(name: str, line: list[str]) -> Command:
    return Command(name, line, line)


def seconds(command: Command, checkout: Path, repeat: int) -> list[float]:
    """Seconds of the run that keeps programs, and of the one that finds them; the least of several."""
    runs = [command.run, *([command.again] if command.again else [])]
    found = [math.inf] * len(runs)
    for _ in range(repeat):
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder))
            kept = {"XDG_CACHE_HOME": str(Path(folder) / "cache"), "PYTHONPATH": str(checkout)}
            own = "JAX_", "PYTHONDONTWRITEBYTECODE"  # an installed package is compiled to bytecode
            environment = {k: v for k, v in os.environ.items() if not k.startswith(own)} | kept
            for number, line in enumerate(runs):
                start = time.perf_counter()
                done = subprocess.run(line, cwd=folder, env=environment, check=False, capture_output=True, text=True)
                taken = float(done.stdout) if command.timed else time.perf_counter() - start
                if done.returncode not in (0, 1):  # 1: a study without a result
                    raise RuntimeError(f"{command.name}: exit code {done.returncode}\n{done.stderr}")
                found[number] = min(found[number], taken)
    return found


def write(folder: Path) -> None:
    """Studies and data of the commands, the same for every checkout."""
    whole = ACCURACY.read_text("utf-8")
    identified = '[identify]\nmodel = "{}"\norders = [40, 80]\nnoise = "1 arcsec"\nnuisance = ["offset"]\n'
    matched = "[assembly]\ndraws = 50\n"
    three = (
        FOUR_BAR.replace("rv-40e", "rv-80e").replace("412", "784")
        + '[requirement.transmission_error]\nupper = "20 arcsec"\n'
    )
    generator = random.Random(0)
    files = {
        ACCURACY.name: whole,
        "three-cranks.toml": (ROOT / "tests" / "three-cranks.toml").read_text("utf-8"),
        "loaded.toml": whole + identified.format("loaded"),
        "four-bar.toml": FOUR_BAR + identified.format("four_bar"),
        "loaded-sets.toml": whole + matched + 'response = "loaded_transmission_error"\n',
        "four-bar-sets.toml": three + matched,
        "unit.csv": _curve(generator, {way: FOUR_BAR_UNIT for way in ("forward", "backward")}),
        "sets.csv": _parts(generator, {"crank": 400}, 2),
        "loaded-unit.csv": _curve(random.Random(1), LOADED_UNIT),
        "three.csv": _parts(generator, {"crank": 21, "disc": 14, "carrier": 5}, 3),
    }
    for name, content in files.items():
        (folder / name).write_text(content, "utf-8")


FOUR_BAR = """[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[tolerances.disc_bore]
half_width = "6.5 um"
[tolerances.carrier_bore]
half_width = "6.5 um"
[tolerances.bearing_clearance]
lower = "4 um"
upper = "12 um"
"""


Wave = tuple[float, float]  # size in arcsec, phase in rad
FOUR_BAR_UNIT: tuple[float, Wave, Wave] = (50, (12, 0.3), (2, -1))  # mean, orders 40 and 80
LOADED_UNIT: dict[str, tuple[float, Wave, Wave]] = {  # unit 5 of seed 1 by the loaded model, offset by 50 arcsec
    "forward": (-20.967, (2.787, -1.358), (1.199, -0.059)),
    "backward": (163.794, (2.663, -1.123), (2.701, 2.452)),
}


def _curve(generator: random.Random, unit: dict[str, tuple[float, Wave, Wave]]) -> str:
    """A measured turn both ways: orders 40 and 80 and noise of 1 arcsec, sampled at 1800 angles."""
    lines = ["angle [deg],error [arcsec],torque [N m],direction"]
    for direction, (mean, *waves) in unit.items():
        for k in range(1800):
            turned = math.radians(0.2 * k)
            error = mean + sum(size * math.cos(n * turned + at) for n, (size, at) in zip((40, 80), waves))
            lines.append(f"{0.2 * k:.6f},{error + generator.gauss(0, 1):.6f},412,{direction}")
    return "\n".join(lines) + "\n"


def _parts(generator: random.Random, counts: dict[str, int], cranks: int) -> str:
    """Measured parts: throws of cranks, bores of discs and carriers, um."""
    bores = [f"[{crank},{axis}]" for crank in range(cranks) for axis in range(2)]
    columns = {
        "crank": ["crank_eccentricity[0]", "crank_eccentricity[1]"],
        "disc": [f"disc_bore{bore}" for bore in bores],
        "carrier": [f"carrier_bore{bore}" for bore in bores],
    }
    used = [column for kind in counts for column in columns[kind]]
    lines = ["kind,id," + ",".join(f'"{column} [um]"' for column in used)]
    for kind, count in counts.items():
        for number in range(count):
            cells = (f"{generator.gauss(0, 2):.3f}" if column in columns[kind] else "" for column in used)
            lines.append(f"{kind},{kind}{number}," + ",".join(cells))
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="checkout of another commit, run in turn with this one")
    parser.add_argument("--only", nargs="+", default=[""], help="beginnings of names")
    parser.add_argument("--repeat", type=int, default=1, help="runs of each, of which the fastest counts")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    options = parser.parse_args()
    figures: dict[str, float] = {}
    for checkout in (ROOT, options.against or ROOT):
        compileall.compile_dir(checkout / "rvjax", quiet=1)
    for command in commands():
        if not command.name.startswith(tuple(options.only)):
            continue
        ours = seconds(command, ROOT, options.repeat)
        other = seconds(command, options.against.resolve(), options.repeat) if options.against else ours
        for label, mine, its in zip(("", ", programs kept"), ours, other):
            figures[f"{command.name}{label}, s"] = mine
            if options.against:
                figures[f"{command.name}{label}: this / other commit"] = mine / its
    publish("whole", figures, options.json)


if __name__ == "__main__":
    main()
