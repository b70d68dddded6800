"""Times of candidates: they run in turn, the minimum of each counts, and other load slows all alike."""

import os
import platform
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax

from rvjax.compile_cache import Options, understood
from rvjax.records import PyTree


def alternate(
    candidates: Mapping[str, Callable[[], PyTree]], *, seconds: float = 2.0, rounds: int = 25
) -> dict[str, float]:
    """Minimum seconds of each candidate, run in turn for `rounds` and `seconds` each, or 10 x `seconds` together."""
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


def compiled(
    function: Callable[..., PyTree], *arguments: PyTree, options: Options = ()
) -> tuple[jax.stages.Compiled, dict[str, float]]:
    """A function compiled for `arguments` with options of XLA, with compile seconds and temporary memory in MB."""
    start = time.perf_counter()
    program = jax.jit(function, compiler_options=understood(options)).lower(*arguments).compile()
    seconds = time.perf_counter() - start
    memory: Any = program.memory_analysis()
    return program, {"compile_s": round(seconds, 3), "temporary_MB": round(memory.temp_size_in_bytes / 2**20, 2)}


def machine() -> dict[str, str | int | None]:
    """Computer and versions of the measurement."""
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
