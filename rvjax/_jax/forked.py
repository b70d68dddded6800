"""A process that was forked after JAX had computed: its threads are missing, and every program would wait for ever.

Each computation raises there instead. What needs no program goes on, and so does all in a process that was forked
before JAX computed anything.
"""

import atexit
import ctypes
import os
from typing import NoReturn

import jax
from jax._src import api, core, dispatch, xla_bridge
from jax._src.interpreters import mlir

MESSAGE = (
    "this process was forked after JAX had computed in its parent, and would hang: use spawn, "
    'such as multiprocessing.get_context("spawn"), or fork before the first computation'
)


def _refuse(*_: object, **__: object) -> NoReturn:
    raise RuntimeError(MESSAGE)


def after_fork() -> None:
    """In the child: let no program of JAX begin, if the parent has computed."""
    if not xla_bridge._backends:  # without the lock, which another thread may have held when the process was forked
        return
    core.EvalTrace.process_primitive = _refuse  # type: ignore[method-assign]
    jax.stages.Compiled.__call__ = _refuse  # type: ignore[method-assign]
    jax.config.update("jax_disable_jit", True)  # compiled functions too reach what is evaluated one by one
    for waits in (api.clean_up, dispatch.wait_for_tokens):  # for threads, when the process ends
        atexit.unregister(waits)
    for held in (getattr(mlir, "global_thread_pool", None), *xla_bridge._backends.values()):  # so do destructors
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))  # one more reference than there is: it stays
    library = ctypes.CDLL(None)
    if hasattr(library, "on_exit"):  # and those of LLVM: after Python has ended, the process does at once
        library.on_exit(library._exit, None)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=after_fork)
