"""JAX's distributed runtime: how a process joins it, and its store of keys and values.

The processes of `montecarlo --distributed` meet here once, get their numbers and leave the runtime, which would end all
of them with one. A thread ends a process whose partners do not start. No gain in time: it finds the processes of a
Slurm, Open MPI or Kubernetes job.
"""

import contextlib
import itertools
import os
import sys
import threading
from collections.abc import Callable
from typing import Any

import jax

_RUNS = itertools.count()
_WAIT = 50  # ms to wait for a key before the next look


def place() -> tuple[int, int]:
    """Number of this process, and of all; (0, 1) unless `jax.distributed.initialize` was called."""
    return jax.process_index(), jax.process_count()


def _client() -> Any:
    from jax._src import distributed

    return distributed.global_state.client


class Store:
    """Messages of one run in the store of the runtime, which ends all processes when one of them ends."""

    def __init__(self) -> None:
        """Number the run; all processes make the same runs."""
        self.number, self.count = place()
        self._run = next(_RUNS)

    def put(self, name: str, content: bytes) -> None:
        """Send a message to all."""
        _client().key_value_set_bytes(f"rvjax/{self._run}/{name}", content)

    def get(self, name: str) -> bytes | None:
        """Return a message, None before it is there."""
        try:
            return _client().blocking_key_value_get_bytes(f"rvjax/{self._run}/{name}", _WAIT)
        except jax.errors.JaxRuntimeError as error:
            if "DEADLINE_EXCEEDED" in str(error) or "NOT_FOUND" in str(error):
                return None
            raise

    def check(self) -> None:
        """The runtime watches the processes."""

    def end(self) -> None:
        """Remove the messages of the run before: all processes have left it."""
        if self.number == 0:
            _client().key_value_delete(f"rvjax/{self._run - 1}/")


def meet(
    address: str | None, count: int | None, number: int | None, *, limit: float, first: Callable[[int], bytes]
) -> tuple[int, int, bytes]:
    """Meet the other processes in JAX's distributed runtime, and leave it.

    The runtime would end all processes with a C++ trace as soon as one ends. So it only numbers them and sends one
    message of the first to all. No backend of JAX starts, so that each process later uses its own devices alone.

    Args:
        address: HOST:PORT of the first process; None: all are those of the cluster job (Slurm, Open MPI, Kubernetes).
        count: of the processes.
        number: of this one.
        limit: time to wait for the others, s.
        first: makes the message of the first process from their count.

    Returns:
        Number of this process, their count, and the message of the first one.

    Raises:
        ValueError: no cluster is known here, or the first process could not make its message.
    """
    over = threading.Event()
    where = f"{count} processes at {address}" if address else "the processes of this cluster job"

    def give_up() -> None:
        if not over.wait(limit):
            print(
                f"rvjax: error: --distributed: {where} did not all start within {limit:.0f} s; start them all, or set "
                "--timeout",
                file=sys.stderr,
                flush=True,
            )
            os._exit(2)  # the runtime waits in C++, and would abort the process

    threading.Thread(target=give_up, daemon=True).start()
    later = int(limit) + 60
    try:
        jax.distributed.initialize(
            address, count, number, initialization_timeout=later, shutdown_timeout_seconds=later,
            heartbeat_timeout_seconds=later,
        )  # fmt: skip
    except (ValueError, RuntimeError, OSError) as error:
        over.set()
        reason = " ".join(str(error).split())
        if "coordinator_address should be defined" in reason:
            reason = (
                "found no Slurm, Open MPI or Kubernetes job here; start rvjax with srun or mpirun, "
                "or give --coordinator, --processes and --process-id"
            )
        raise ValueError(f"--distributed: {reason}") from None
    from jax._src import distributed

    place = distributed.global_state.process_id, distributed.global_state.num_processes
    client, failed = _client(), ""
    if place[0] == 0:
        try:
            said = b"+" + first(place[1])
        except (ValueError, OSError) as error:
            failed = " ".join(str(error).split())
            said = b"-" + failed.encode()
        client.key_value_set_bytes("rvjax/first", said)
    else:
        said = client.blocking_key_value_get_bytes("rvjax/first", 1000 * later)
    client.wait_at_barrier("rvjax/met", 1000 * later)
    with contextlib.suppress(RuntimeError):
        jax.distributed.shutdown()
    distributed.global_state.process_id, distributed.global_state.num_processes = 0, 1  # `shutdown` leaves them
    over.set()
    if said[:1] == b"-":
        reason = said[1:].decode()
        raise ValueError(reason if place[0] == 0 else f"process 1 of {place[1]} has ended: {reason}")
    return *place, said[1:]
