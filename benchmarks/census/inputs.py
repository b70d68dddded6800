"""Mutated studies and CSV files through every command.

    python -m benchmarks.census.inputs [--studies 300] [--files 200]

Each input is a sound file with one to three changes. In two of three they are gentle: numbers up to a factor of two
away, other units and allowed words, tables that are left out. The others are values that no part can have, wrong types,
lines that are missing, twice or misspelt, cut files, bytes that are no text. A command must end within a minute with
exit code 0, 1 or 2. With code 2 standard error is one line. A traceback is never allowed.
"""

import argparse
import collections
import contextlib
import io
import json
import re
import signal
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import numpy as np

LIMIT = 60  # s of the processor
GENTLE = 2 / 3  # of the inputs

STUDY = """[design]
base = "rv-40e"
cycloid.equidistant_modification = "-20 um"
[conditions]
angles = 8
closure = "first_order"
[tolerances.crank_eccentricity]
grade = "IT6"
size = "25 mm"
[tolerances.bearing_clearance]
lower = "4 um"
upper = "12 um"
[tolerances.pin_radius]
half_width = "2 um"
[tolerances.disc_runout]
lower = "0 um"
upper = "15 um"
[cost.bearing_clearance]
scale = 2
reference = "5 um"
finest = "1 um"
coarsest = "7.9 um"
[middle.pin_radius]
lower = "-4 um"
upper = "4 um"
[requirement.lost_motion]
lower = "-60 arcmin"
upper = "60 arcmin"
target = 0.99
[requirement.transmission_error]
upper = "200 arcsec"
target = 0.9
[assembly]
response = "lost_motion"
draws = 2
[identify]
model = "four_bar"
orders = [40, 80]
noise = "2 arcsec"
nuisance = ["offset", "mounting"]
[run]
seed = 0
samples = 256
certificate_samples = 1024
"""
DESIGN = (
    STUDY
    + """[variable."cycloid.equidistant_modification"]
lower = "-60 um"
upper = "-5 um"
"""
)
CURVE = "angle [deg],error [arcsec]\n" + "".join(f"{k},{10 * (k % 9)}\n" for k in range(360))
BENCH = "angle [deg],error [arcsec],torque [N m],direction\n" + "".join(
    f"{k},{50 + 30 * (-1) ** k},{torque},{word}\n"
    for torque, word in ((412, "forward"), (-412, "backward"))
    for k in range(360)
)
PARTS = "kind,id,disc_runout [um],pin_radius [um]\n" + "".join(
    f"flanks,f{k},{3 * k},\npins,p{k},,{k / 2 - 1}\n" for k in range(4)
)
OF_STUDY = {
    "check": [],
    "montecarlo": ["--samples", "200"],
    "allocate": [],
    "design": [],
    "report": ["--output", "page.html"],
    "budget": ["--samples", "16", "--torque", "10 N m"],
    "identify": ["--check"],
    "compensate": ["curve.csv"],
    "assemble": ["parts.csv"],
    "compare": [],
}
BEFORE = {"compare": ["answer", "--on"]}  # arguments in front of the study
OF_FILE = {"compensate": ("curve.csv", CURVE), "identify": ("bench.csv", BENCH), "assemble": ("parts.csv", PARTS)}
VALUES = (
    '"nan um"', '"1e308 um"', '"-3 um"', '"0 um"', '"3 kg"', '"3"', '"1e-400 um"', '"1e9 N m"', '"90 deg"', "nan",
    "inf", "-inf", "1e308", "-1", "0", "2.5", "true", '""', "[]", "{}", "[1, [2]]", '"x"', "99999999999999999999",
    "1979-05-27", '"\\u0000"', '"\\u001b[31m"', "1_000", "0x10", '"ä um"', '"3,5 um"', '"1e3000 um"',
)  # fmt: skip
CELLS = (
    "nan", "inf", "-1", "1e308", "1e-400", "", "x", "0", "1,5", '"', "ä", "\0", "1e30", "0x1", " 3 ", "-0.0", "TRUE",
)  # fmt: skip
WORDS = {
    "grade": [f'"IT{n}"' for n in range(3, 12)],
    "base": [f'"rv-{size}e"' for size in (20, 40, 80, 320)],
    "closure": ['"first_order"', '"quadratic"', '"closed_form"', '"newton"'],
    "orders": ["[40]", "[39, 40]", "[1, 80]", "[80, 40, 120]"],
    "nuisance": ["[]", '["offset"]', '["mounting"]', '["phase", "offset"]'],
    "angles": ["1", "2", "3", "16"],
    "draws": ["1", "3"],
    "seed": ["1", "12345"],
}
UNITS = {"um": ("mm", 1e-3), "mm": ("um", 1e3), "arcmin": ("deg", 1 / 60), "arcsec": ("arcmin", 1 / 60)}
LINES = (
    'distribution = "uniform"', 'distribution = "lognormal"', "shift = 0.2", "cp = 1.1", 'output_torque = "100 N m"',
    'cranks = "free"', 'power = 0.7', 'fixed = 2.0', "joint_target = 0.8", "confidence = 0.9", "grades = true",
)  # fmt: skip


class TooLong(Exception):
    """A command did not end within the limit."""


def gently_changed_study(text: str, random: np.random.Generator) -> bytes:
    """A study file with one to three changes that a user could mean."""
    lines = text.splitlines()
    for _ in range(random.integers(1, 4)):
        k, kind = int(random.integers(len(lines))), int(random.integers(10))
        key, equals, value = lines[k].partition(" = ")
        if kind <= 6 and key in WORDS:
            lines[k] = f"{key} = {random.choice(WORDS[key])}"
        elif kind <= 4 and equals:
            lines[k] = f"{key} = {scaled(value, float(random.uniform(0.5, 2.0)))}"
        elif kind == 5 and equals:
            lines[k] = f"{key} = {in_other_unit(value)}"
        elif kind == 7 and equals:
            del lines[k]
        elif kind == 8:
            lines.insert(k + 1, str(random.choice(LINES)))
        elif kind == 9:
            lines = without_table(lines, k)
    return ("\n".join(lines) + "\n").encode()


def scaled(value: str, factor: float) -> str:
    """A text with its first number times a factor; whole numbers stay whole."""
    whole = re.fullmatch(r"\d+", value)
    return re.sub(
        r"(?<![\w.])-?\d+(\.\d+)?",
        lambda m: f"{round(float(m[0]) * factor) if whole else float(m[0]) * factor:g}",
        value,
        count=1,
    )


def in_other_unit(value: str) -> str:
    """A quantity in another unit, as large as before."""
    found = re.fullmatch(r'"(-?[\d.]+) (\w+)"', value)
    if found is None or found[2] not in UNITS:
        return value
    unit, factor = UNITS[found[2]]
    return f'"{float(found[1]) * factor:.9g} {unit}"'


def without_table(lines: list[str], k: int) -> list[str]:
    """The lines without the table around line k."""
    heads = [i for i, line in enumerate(lines) if line.startswith("[")]
    first = max((i for i in heads if i <= k), default=0)
    return lines[:first] + lines[min((i for i in heads if i > k), default=len(lines)) :]


def gently_changed_file(text: str, random: np.random.Generator) -> bytes:
    """A CSV file with one to three changes as a bench could make them."""
    header, *rows = text.splitlines()
    for _ in range(random.integers(1, 4)):
        k, kind = int(random.integers(len(rows))), int(random.integers(7))
        if kind <= 2:
            first, *cells = rows[k].split(",")
            rows[k] = ",".join([first, *(scaled(cell, float(random.uniform(0.5, 2.0))) for cell in cells)])
        elif kind == 3:
            rows = rows[::-1]
        elif kind == 4:
            del rows[k]
        elif kind == 5:
            header = header.replace("arcsec", "arcmin") if "arcsec" in header else header.replace("um", "mm")
        else:
            header, rows = header.replace(",", ";"), [row.replace(",", ";") for row in rows]
    return ("\n".join([header, *rows]) + "\n").encode()


def mutated_study(text: str, random: np.random.Generator) -> bytes:
    """A study file with one to three changes."""
    if random.random() < GENTLE:
        return gently_changed_study(text, random)
    lines = text.splitlines()
    for _ in range(random.integers(1, 4)):
        k, kind = int(random.integers(len(lines))), int(random.integers(10))
        key, equals, value = lines[k].partition(" = ")
        if kind <= 3 and equals:
            lines[k] = f"{key} = {random.choice(VALUES)}"
        elif kind == 4 and equals:
            number = re.sub(r"[-+]?\d+\.?\d*", lambda m: f"{float(m[0]) * 10.0 ** random.integers(-9, 10):g}", value)
            lines[k] = f"{key} = {number}"
        elif kind == 5:
            lines[k] = misspelt(lines[k], random)
        elif kind == 6:
            del lines[k]
        elif kind == 7:
            lines.insert(int(random.integers(len(lines) + 1)), lines[k])
        elif kind == 8:
            lines.insert(k, f"{random.choice(('speed', 'base', 'order', 'upper', 'class'))} = {random.choice(VALUES)}")
        else:
            other = int(random.integers(len(lines)))
            lines[k], lines[other] = lines[other], lines[k]
        lines = lines or [""]
    return cut("\n".join(lines) + "\n", random)


def mutated_file(text: str, random: np.random.Generator) -> bytes:
    """A CSV file with one to three changes."""
    if random.random() < GENTLE:
        return gently_changed_file(text, random)
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(random.integers(1, 4)):
        k, kind = int(random.integers(len(rows))), int(random.integers(9))
        k = k if random.random() < 0.7 else 0  # the header is one row of many
        j = int(random.integers(len(rows[k])))
        if kind <= 2:
            rows[k][j] = str(random.choice(CELLS))
        elif kind == 3:
            rows[k] = rows[k][:j]
        elif kind == 4:
            rows[k].insert(j, rows[k][j])
        elif kind == 5:
            rows.insert(k, list(rows[k]))
        elif kind == 6:
            rows = [row[:j] + row[j + 1 :] for row in rows]
        elif kind == 7:
            rows[k][j] = misspelt(rows[k][j], random)
        else:
            rows = rows[: k + 1]
        rows = [row or [""] for row in rows]
    return cut("\n".join(map(",".join, rows)) + "\n", random)


def misspelt(text: str, random: np.random.Generator) -> str:
    """A text without one of its letters, or with one of them twice."""
    at = int(random.integers(len(text) + 1))
    return text[:at] + text[at + 1 :] if random.random() < 0.5 else text[:at] + text[at - 1 : at] + text[at:]


def cut(text: str, random: np.random.Generator) -> bytes:
    """Bytes of a text; of one in ten some are lost, or are none of any text."""
    data, at = text.encode(), int(random.integers(len(text)))
    return data if random.random() < 0.9 else data[:at] + (b"" if random.random() < 0.5 else b"\xff\xfe\0" + data[at:])


def ends(arguments: list[str], limit: float = LIMIT) -> tuple[int | None, list[str], str]:
    """Exit code of a command (None: an exception), its lines on standard error, and what is wrong with them."""
    from rvjax import cli

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TooLong

    out, err, code, wrong = io.StringIO(), io.StringIO(), None, ""
    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cli.main(arguments)
    except TooLong:
        wrong = f"no end within {limit} s"
    except BaseException:  # every one would be a traceback
        wrong = traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    said = [line for line in err.getvalue().splitlines() if not line.startswith("rvjax: warning: ")]
    if not wrong and (code not in (0, 1, 2) or "Traceback" in out.getvalue() + err.getvalue()):
        wrong = f"exit code {code}"
    elif not wrong and code == 2 and (len(said) != 1 or not said[0].startswith("rvjax: error: ")):
        wrong = f"{len(said)} lines with exit code 2"
    return code, said, wrong


def cases(studies: int, files: int, seed: int) -> Iterator[tuple[str, dict[str, bytes], list[str]]]:
    """(command, its files, its arguments) of each input; the commands take turns."""
    random = np.random.default_rng(seed)
    sound = {"study.toml": STUDY.encode(), "curve.csv": CURVE.encode(), "parts.csv": PARTS.encode()}
    for k in range(studies):
        command = list(OF_STUDY)[k % len(OF_STUDY)]
        arguments = [*BEFORE.get(command, []), "study.toml", *OF_STUDY[command]]
        text = DESIGN if command == "design" else STUDY
        yield command, sound | {"study.toml": mutated_study(text, random)}, arguments
    for k in range(files):
        command = list(OF_FILE)[k % len(OF_FILE)]
        name, text = OF_FILE[command]
        yield command, sound | {name: mutated_file(text, random)}, ["study.toml", name]


def run(studies: int, files: int, seed: int = 0, commands: tuple[str, ...] = ()) -> tuple[dict[str, int], list[str]]:
    """Counts of the exit codes by command, and what is wrong, one text each."""
    from rvjax import cli

    counts, wrong = collections.Counter[str](), []
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if studies and (not commands or "compare" in commands):
            Path("sound.toml").write_text(STUDY)
            cli.main(["allocate", "sound.toml", "--results", "answer", "--quiet"])
        for command, contents, arguments in cases(studies, files, seed):
            if commands and command not in commands:
                continue
            for name, data in contents.items():
                Path(name).write_bytes(data)
            quiet = [] if command == "check" else ["--quiet"]
            begun = time.process_time()
            code, said, fault = ends([command, *arguments, *quiet])
            counts[f"{command} {code}"] += 1
            if fault:
                print(command, fault[-1500:], said[:3], f"{time.process_time() - begun:.0f} s", flush=True)
                changed = next(data for name, data in contents.items() if name in arguments and data)
                wrong.append(f"{command} {' '.join(arguments)}: {fault[-300:]}\n{said[:3]}\n{changed!r}")
    return dict(sorted(counts.items())), wrong


def main() -> None:
    """Run the census and print its counts as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--studies", type=int, default=300)
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--command", nargs="*", default=(), help="these commands alone")
    options = parser.parse_args()
    counts, wrong = run(options.studies, options.files, options.seed, tuple(options.command))
    print("\n\n".join(wrong))
    print(json.dumps({"counts": counts, "wrong": len(wrong)}, indent=1))


if __name__ == "__main__":
    main()
