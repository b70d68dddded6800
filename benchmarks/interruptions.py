"""Interruptions of a run: signals, a full and a read-only disk, other devices and threads; each with its outcome.

Every case is a process of its own that counts units of one study. Its figures, to the last bit, are compared with those
of an undisturbed run: the table of benchmarks/NOTES.md.

    python -m benchmarks.interruptions
"""

import argparse
import dataclasses
import hashlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

UNITS, CHUNK = 3_000_000, 20_000


def work(checkpoint, *, full):
    """Count the units; print a digest of every figure."""
    import jax.numpy as jnp

    import rvjax
    from rvjax.status import Status
    from rvjax.tolerances import Outcome, Requirement, Tolerance, monte_carlo

    if full:  # no file may grow beyond this: writing fails in the middle
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    def response(e):
        value = {"y": jnp.sin(3 * e["a"]) + e["b"] ** 2, "z": e["a"] * e["b"]}
        return Outcome(value, jnp.where(e["b"] > 2.9, int(Status.NO_BRACKET), 0))

    rvjax.enable_x64()
    tolerances = {"a": Tolerance.symmetric(1.0), "b": Tolerance.symmetric(3.0)}
    need = {"y": Requirement(upper=3.0), "z": Requirement(lower=-0.5, upper=0.5)}
    options = dict(samples=UNITS, seed=5, chunk=CHUNK, requirements=need, checkpoint=checkpoint)
    print("begun", flush=True)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        found = monte_carlo(response, tolerances, **options)
    for warning in seen:
        print("warned:", str(warning.message)[-90:])
    counts = dict(failures=found.failures, yields={n: y.value for n, y in found.yield_.items()})
    plain = dataclasses.replace(found, study={}, versions={})
    digest = hashlib.sha256(repr(plain).encode()).hexdigest()[:16]
    print("figures", digest, hashlib.sha256(repr(counts).encode()).hexdigest()[:16])


def start(checkpoint=None, *, flags="", threads=None, full=False):
    """A process that counts."""
    here = [sys.executable, "-m", "benchmarks.interruptions", "--work", *([str(checkpoint)] if checkpoint else ["-"])]
    line = ["taskset", "-c", threads] if threads else []
    environment = os.environ | {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()}
    arguments = line + here + (["--full"] if full else [])
    return subprocess.Popen(arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(process):
    """Digests of all values and counts, and the messages."""
    said, complained = process.communicate(timeout=500)
    figures = [line.split()[1:] for line in said.splitlines() if line.startswith("figures")]
    notes = [line for line in said.splitlines() if line.startswith("warned")]
    return (figures[0] if figures else None), process.returncode, [*notes, *complained.strip().splitlines()[-1:]]


def interrupted(folder, number):
    """A run that a signal ends once its checkpoint has moved on, and the run after it."""
    checkpoint = folder / signal.Signals(number).name
    process = start(checkpoint)
    while process.poll() is None and not (checkpoint.is_file() and checkpoint.stat().st_size > 10_000):
        time.sleep(0.02)
    process.send_signal(number)
    _, code, _ = ended(process)
    left = [path.name for path in folder.iterdir() if path.name.startswith(checkpoint.name)]
    figures, _, _ = ended(start(checkpoint))
    return figures, f"ended with {code}, left {', '.join(left)}"


def main():
    """Try everything and print the rows of the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", help=argparse.SUPPRESS)
    parser.add_argument("--full", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        work(None if options.work == "-" else options.work, full=options.full)
        return
    whole, _, _ = ended(start())

    def row(name, figures, note):
        if figures is None:
            outcome = "refused"
        else:
            outcome = "the same bits" if figures == whole else "equal counts" if figures[1] == whole[1] else "DIFFERENT"
        print(f"| {name} | {outcome} | {note} |", flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            row(f"{signal.Signals(number).name} and go on", *interrupted(folder, number))
        figures, code, notes = ended(start(folder / "full", full=True))
        row("no space for the checkpoint", figures, f"ended with {code}; {' '.join(notes)[:150]}")
        figures, code, notes = ended(start(Path("/proc/no/checkpoint")))
        row("a place that takes no files", figures, f"ended with {code}; {' '.join(notes)[-110:]}")
    for count in (2, 3, 4):
        figures, _, _ = ended(start(flags=f"--xla_force_host_platform_device_count={count}"))
        row(f"{count} devices", figures, "")
    for threads in ("0", "1"):
        row(f"processor {threads} alone", ended(start(threads=threads))[0], "")
    row("one thread in Eigen", ended(start(flags="--xla_cpu_multi_thread_eigen=false"))[0], "")


if __name__ == "__main__":
    main()
