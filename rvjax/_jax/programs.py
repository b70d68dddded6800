"""Compilation of programs, those that the command line keeps in the cache folder of the user, and memory kept for them.

A kept program is found by what it computes, by the versions of JAX and XLA and by their flags; the folder is that of
one version of rvjax on one kind of processor. One that another run is just writing is compiled again. Gain, with the
traced programs of `exported`: `rvjax allocate rv-40e` takes 16.4 instead of 30.3 s in a second run. `quick` gives a
program of one case the compiler options that suit it, for which `jax.jit` raises an error within another program.
"""

import ctypes
import functools
import hashlib
import os
import platform
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
import jax.extend.core
import numpy as np

from rvjax._jax.sizes import CPU, platform_of

P = ParamSpec("P")
R = TypeVar("R")
OFF = "RVJAX_KEEP_PROGRAMS"  # "0": nothing is kept
LARGEST = 1_000_000_000  # bytes; beyond, the programs that were used longest ago go

Options = tuple[tuple[str, bool | int], ...]  # (option of XLA, value)

QUICK: Options = (("xla_cpu_use_fusion_emitters", False), ("xla_llvm_disable_expensive_passes", True))
"""For `jax.jit(..., compiler_options=dict(QUICK))` round hundreds of small kernels, such as a batch of `loaded`. XLA's
older generator of code compiles them in half to two thirds of the time, and they run as fast; mesh forces would take
twice as long."""


@functools.lru_cache(maxsize=16)
def understood(options: Options) -> dict[str, bool | int] | None:
    """Options for `jax.jit`, those that this version of XLA has; None for none."""
    return dict(option for option in options if _known(option)) or None


@functools.cache
def _known(option: tuple[str, bool | int]) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options=dict([option])).lower(0.0).compile()
    except (jax.errors.JaxRuntimeError, ValueError):
        return False
    return True


def inside(*arguments: object) -> bool:
    """True if another program is being traced, whose options count."""
    return _traced() or any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments))


def batched_alone(*arguments: object) -> bool:
    """True under `jax.vmap` outside any other program; derivatives accept no options of the compiler."""
    leaves = jax.tree.leaves(arguments)
    while any(hasattr(leaf, "batch_dim") for leaf in leaves):  # JAX exports no type of these tracers
        leaves = [leaf.val if hasattr(leaf, "batch_dim") else leaf for leaf in leaves]
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves) and not _traced()


_place: Any = jax.extend.core if hasattr(jax.extend.core, "get_opaque_trace_state") else jax.core  # where JAX has it
_trace_state = _place.get_opaque_trace_state
_alone: list[object] = []  # the latest state of JAX outside of any program


def _traced() -> bool:
    state: object = _trace_state(convention="rvjax")
    if _alone == [state]:  # an operation takes sixty times as long
        return False
    if isinstance(jax.lax.neg(np.float32(0)), jax.core.Tracer):
        return True
    _alone[:] = [state]
    return False


ONCE: Options = (*QUICK, ("xla_backend_optimization_level", 0))
"""For a program of one case, which takes its time to start kernels: 0.47 instead of 0.45 ms for an equilibrium, and is
compiled in half the time."""


def quick(*static: int, options: Options = QUICK) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """`jax.jit` with separate compiler options where the function is not part of another program.

    Under `jax.vmap` the options are `QUICK`: a batch of `loaded.torsion` compiles in 9 instead of 17 s. They are those
    of a processor; a GPU has none.

    Args:
        static: numbers of the static arguments.
        options: of the compiler, for one case.
    """

    def made(function: Callable[P, R]) -> Callable[P, R]:
        part = jax.jit(function, static_argnums=static)
        alone = functools.cache(
            lambda used: jax.jit(function, static_argnums=static, compiler_options=understood(used))
        )  # compiled at the first call

        @functools.wraps(function)
        def call(*arguments: P.args, **named: P.kwargs) -> R:
            is_inside = inside(arguments, named)
            if is_inside and not batched_alone(arguments, named):
                return part(*arguments, **named)
            if platform_of((arguments, named)) != CPU:
                return part(*arguments, **named)
            return alone(QUICK if is_inside else options)(*arguments, **named)

        return call

    return made


_folder: list[Path] = []  # of `keep`


def kept_folder() -> Path | None:
    """The folder of kept programs; None where none are kept, as in a program of the user's own."""
    return _folder[0] if _folder else None


def keep(version: str) -> Path | None:
    """Keep programs from now on; the folder, or None where nothing is kept.

    `RVJAX_KEEP_PROGRAMS=0` switches it off; `JAX_COMPILATION_CACHE_DIR` names another folder and is left alone.
    """
    _folder.clear()
    if os.environ.get(OFF) == "0" or jax.config.values["jax_compilation_cache_dir"]:
        return None
    folder = _caches() / "rvjax" / f"programs-{version}-{_processor()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        prune(folder, LARGEST)
    except OSError:  # a home that cannot be written: compile as before
        return None
    warnings.filterwarnings("ignore", message="Error .*persistent compilation cache")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    _folder[:] = [folder]
    return folder


def prune(folder: Path, largest: int) -> None:
    """Remove the files that were used longest ago until the rest fit."""
    found = []
    for path in folder.iterdir():
        try:
            stat = path.stat()
        except FileNotFoundError:  # another run was quicker
            continue
        found.append((max(stat.st_atime, stat.st_mtime), stat.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found, key=lambda item: item[0]):
        if total <= largest:
            break
        path.unlink(missing_ok=True)
        total -= size


def keep_memory() -> None:
    """Let glibc serve large blocks from a heap that never shrinks; nothing where there is another C library.

    Otherwise every call of a compiled program maps its results and temporaries again, and touching fresh pages takes a
    quarter of the time of a batch of mesh forces. The most that a process holds at once stays what it was.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc; Windows
        return
    trim_threshold, mmap_max = -1, -4
    mallopt(mmap_max, 0)
    mallopt(trim_threshold, 2**31 - 1)


def _caches() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _processor() -> str:
    """Digest of the processor features, because computers of several kinds may share a folder."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        able = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    except OSError:
        able = platform.processor()
    return hashlib.sha256(f"{platform.machine()} {able}".encode()).hexdigest()[:12]
