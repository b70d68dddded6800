"""Shared by all benchmarks: settings, JSON, C compiled on the spot, and the clock of `rvjax tradeoff`.

Candidates are run in turn and the minimum of each is kept, so that other load slows all alike;
the ratios of the minima are the figures to compare. On one core (`taskset -c 0`) the clock is the processor time of
this process, in which other programs have no part.
"""

import argparse
import ctypes
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rvjax.cli import xla_flags
from rvjax.levels.measure import alternate as in_turn, compiled, machine

__all__ = ["alternate", "arguments", "c_library", "compiled", "machine", "publish", "settings"]


def alternate(candidates: dict[str, Callable[[], Any]], **limits: Any) -> dict[str, float]:
    """Minimum seconds of each candidate, run in turn, by the clock above."""
    one = machine()["cores"] == 1
    return in_turn(candidates, clock=time.process_time if one else time.perf_counter, **limits)


def settings() -> None:
    """Settings of every benchmark: float64, the command line's flags of XLA and memory. Call before JAX is used."""
    os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *xla_flags()]).strip()
    import rvjax
    from rvjax._jax.programs import keep_memory

    rvjax.enable_x64()
    keep_memory()


def c_library(source: str) -> ctypes.CDLL | None:
    """C source compiled with the local gcc and loaded; None where there is no gcc."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="rvjax-benchmark-"))
    (folder / "reference.c").write_text(source)
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "reference.c", "-o", "reference.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "reference.so"))


def arguments(description: str) -> argparse.Namespace:
    """Command line of a benchmark: where the JSON goes."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    return parser.parse_args()


def publish(name: str, figures: dict[str, Any], path: Path | None) -> None:
    """Print the figures and, where a path is given, write them as JSON with the computer of the measurement."""
    for key, value in figures.items():
        print(f"{key:48s} {value:.4g}" if isinstance(value, float) else f"{key:48s} {value}")
    if path is not None:
        path.write_text(json.dumps({"benchmark": name, "machine": machine(), "figures": figures}, indent=1))
