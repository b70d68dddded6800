"""A device of JAX for each core, where units take longer than their start."""

import contextlib
import os

# A loop over blocks of units has one thread, so each core becomes a device of JAX, which takes its part of every chunk;
# more devices would leave each too few blocks.
_MOST_DEVICES = 8


def share_cores(processes: int) -> None:
    """A device of JAX for each core, among `processes`; JAX_NUM_CPU_DEVICES says otherwise."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or "host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(RuntimeError):  # the caller of `main` already uses JAX
        jax.config.update("jax_num_cpu_devices", max(1, min(cores // processes, _MOST_DEVICES)))
