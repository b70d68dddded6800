"""The tests under what stands in for other machines: instruction sets, vector widths, LAPACK kernels, optimisation.

    python -m tests.machines                                 all of them, one after the other
    python -m tests.machines --only sse --only nehalem       some of them
    python -m tests.machines tests/test_roots.py -k kepler   arguments of pytest

A bound that was fitted to the rounding of one processor fails here. Every stand-in keeps its compiled programs in a
folder of its own, `.pytest_cache/machines`; the exit status is 1 if any of them failed.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
STAND_INS = {
    "avx2": {"XLA_FLAGS": "--xla_cpu_max_isa=AVX2"},  # no AVX-512
    "sse": {"XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2"},  # no fused multiply-add, two doubles at a time
    "wide": {"XLA_FLAGS": "--xla_cpu_prefer_vector_width=512"},  # where the processor has them
    "haswell": {"OPENBLAS_CORETYPE": "Haswell"},  # the LAPACK of eigenproblems
    "zen": {"OPENBLAS_CORETYPE": "Zen"},
    "nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
    "one-thread": {
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
        "OPENBLAS_NUM_THREADS": "1",
    },
    "unoptimised": {"XLA_FLAGS": "--xla_backend_optimization_level=0"},  # by the code generator that users have
    "optimised": {"XLA_FLAGS": "--xla_backend_optimization_level=3"},  # as users run
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=STAND_INS, help="may be given several times")
    options, arguments = parser.parse_known_args()
    outcome = {}
    for name in options.only or STAND_INS:
        print(f"== {name}: {STAND_INS[name]}", flush=True)
        start = time.monotonic()
        failed = subprocess.run(
            [sys.executable, "-m", "pytest", *arguments], cwd=ROOT, env=environment(name), check=False
        ).returncode
        outcome[name] = f"{f'FAILED ({failed})' if failed else 'passed':12} {time.monotonic() - start:6.0f} s"
    for name, words in outcome.items():
        print(f"{name:12} {words}")
    return int(any("FAILED" in words for words in outcome.values()))


def environment(name: str) -> dict[str, str]:
    """Variables of a stand-in; what the caller has set in XLA_FLAGS stays in front."""
    changes = dict(STAND_INS[name])
    if "XLA_FLAGS" in changes:
        changes["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {changes['XLA_FLAGS']}".strip()
    cache = ROOT / ".pytest_cache" / "machines" / name
    return os.environ | changes | {"JAX_COMPILATION_CACHE_DIR": str(cache)}


if __name__ == "__main__":
    sys.exit(main())
