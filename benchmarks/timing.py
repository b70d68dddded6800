"""Shared by all benchmarks: alternating minimum times, the machine, JSON, C compiled on the spot.

Candidates are run in turn and the minimum of each is kept, so that a busy machine slows all alike;
the ratios of the minima are the figures to compare.
"""

import argparse
import ctypes
import json
import os
import platform
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def settings() -> None:
    """What every benchmark runs with: float64 and, where they exist, 512-bit vectors. Call before JAX is used."""
    if "avx512f" in (Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_prefer_vector_width=512".strip()
    import rvjax

    rvjax.enable_x64()


def alternate(
    candidates: Mapping[str, Callable[[], Any]], *, seconds: float = 2.0, rounds: int = 25
) -> dict[str, float]:
    """Minimum seconds of each candidate, run in turn for `rounds` and `seconds` each, or 10 x `seconds` together."""
    import jax

    for run in candidates.values():
        jax.block_until_ready(run())
    best = dict.fromkeys(candidates, float("inf"))
    spent = dict.fromkeys(candidates, 0.0)
    turn = 0
    while (turn < rounds or min(spent.values()) < seconds) and sum(spent.values()) < 10 * seconds:
        for name, run in candidates.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            elapsed = time.perf_counter() - start
            best[name], spent[name] = min(best[name], elapsed), spent[name] + elapsed
        turn += 1
    return best


def compiled(function: Callable[..., Any], *arguments: Any) -> tuple[Any, dict[str, float]]:
    """A jitted function compiled for `arguments`, with compile seconds and temporary memory in MB."""
    import jax

    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    seconds = time.perf_counter() - start
    memory = program.memory_analysis()
    return program, {"compile_s": round(seconds, 3), "temporary_MB": round(memory.temp_size_in_bytes / 2**20, 2)}


def machine() -> dict[str, Any]:
    """Where and with what the figures were measured."""
    import jax

    model = ""
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "")
    return {
        "processor": model or platform.processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "backend": jax.default_backend(),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def c_library(source: str) -> ctypes.CDLL | None:
    """C source compiled with the machine's gcc and loaded; None where there is no gcc."""
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
    """Print the figures and, where a path is given, write them as JSON with the machine they belong to."""
    for key, value in figures.items():
        print(f"{key:48s} {value:.4g}" if isinstance(value, float) else f"{key:48s} {value}")
    if path is not None:
        path.write_text(json.dumps({"benchmark": name, "machine": machine(), "figures": figures}, indent=1))
