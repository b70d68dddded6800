"""Console of all commands: printing, exit codes, devices.

A device of JAX for each core, where units take longer than their start; a GPU, where they take much longer.
"""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import TextIO

# A loop over blocks of units has one thread, so each core becomes a device of JAX, which takes its part of every chunk;
# more devices would leave each too few blocks.
_MOST_DEVICES = 8

_GPU_GAINS = 5.0
"""Seconds of two cores that units take at least for a GPU, which has to start. 131,072 units of all six outputs of
`rv-40e-whole`, 26 s of two cores, took 19 s with start and compilation on an H100."""


def may_use_gpu(command: str, processes: int) -> bool:
    """True if JAX has a GPU, as far as its packages say, and one process of such a command computes many units.

    Args:
        command: its name.
        processes: that share its units.
    """
    return command in ("allocate", "montecarlo", "report") and processes == 1 and find_spec("jax_plugins") is not None


@contextlib.contextmanager
def units_placed(seconds: Callable[[], float | None]) -> Iterator[str]:
    """A context within which units are computed where they gain: on the GPUs of JAX, if `JAX_PLATFORMS` names none.

    All else stays on the default device, for `rvjax` the processor.

    Args:
        seconds: of two cores that the units take, None for unknown; called only if there is a GPU.

    Yields:
        The devices of the units in words.
    """
    import jax

    from rvjax.response import units_devices, units_on

    named, gpus = os.environ.get("JAX_PLATFORMS"), list[jax.Device]()
    with contextlib.suppress(RuntimeError):  # JAX has none
        gpus = jax.local_devices(backend="gpu")
    if gpus and not named and (seconds() or 0.0) < _GPU_GAINS:
        gpus = []
    with units_on(gpus):
        devices = units_devices()
        kind = "the processor" if devices[0].platform == "cpu" else devices[0].device_kind
        yield kind if len(devices) == 1 else f"{kind}, {len(devices)} devices"


def share_cores(processes: int) -> None:
    """A device of JAX for each core, among `processes`; JAX_NUM_CPU_DEVICES says otherwise."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or "host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(RuntimeError):  # the caller of `main` already uses JAX
        jax.config.update("jax_num_cpu_devices", max(1, min(cores // processes, _MOST_DEVICES)))


READING, WRITING = "reading the study", "tables and pictures"  # phases
EXIT_OK, EXIT_NO_ANSWER, EXIT_BAD_INPUT = 0, 1, 2


def say(text: str, file: TextIO | None = None) -> None:
    """Print text; characters that control a terminal are spelled out.

    Args:
        text: one or several lines.
        file: stream; None is standard output.
    """
    from rvjax.base import progress

    lines = (
        "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
        for line in text.split("\n")
    )
    with progress.aside():
        print("\n".join(lines), file=file)


def tell(device: str) -> None:
    """Say where units are computed, if JAX has a GPU: else there is no choice.

    Args:
        device: in words, by `units_placed`.
    """
    import jax

    if any(each.platform != "cpu" for each in jax.local_devices()):
        say(f"rvjax: units on {device}", file=sys.stderr)
