"""Variables of the process that must be set before JAX is imported; importing this module sets them."""

import os
import sys
from importlib.metadata import version
from pathlib import Path

if sys.dont_write_bytecode:  # dozens of processes: each would compile what it imports, 3 s of JAX alone
    sys.dont_write_bytecode = False
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")  # not next to the sources
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
KEPT = Path(__file__).parents[1] / ".pytest_cache" / "jax"  # compiled programs
if KEPT.is_dir():  # made at the end of a run: the first one of a clone keeps none, which takes 4 % of its CPU time
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(KEPT))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a worker for each core: threads of small products took 6 % more
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "1")  # not one a core from whichever test runs a command first
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA logs two lines for every kept program it loads
if "xla_backend_optimization_level" not in os.environ.get("XLA_FLAGS", ""):
    # XLA's older code generator, in one piece, no optimisation: 15 s of compilation -> 3 s in a mix of three models.
    quick = (
        "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true "
        "--xla_cpu_parallel_codegen_split_count=1 "
        # Each runs ten times and more over a program, for its speed alone: an eighth of the compilation; bits stay.
        "--xla_disable_hlo_passes=reshape-mover,while-loop-constant-sinking,while-loop-invariant-code-motion"
    )
    if int(version("jaxlib").split(".")[1]) < 10:  # later ones end the process: they lack the older code generator
        quick += " --xla_cpu_use_fusion_emitters=false"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {quick}".strip()
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")  # hundreds of small ones cost a quarter
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")  # no line of source beside every operation
