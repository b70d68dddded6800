"""Forked processes, as `multiprocessing` makes on Linux: before JAX computed they compute, after it they raise."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest

# Every way to fork, in one process of its own: none may wait for ever, and the parent goes on.
SCRIPT = """
import multiprocessing, os, sys, warnings
from concurrent.futures import ProcessPoolExecutor

warnings.simplefilter("ignore")  # JAX's, at each fork
import jax, jax.numpy as jnp, numpy as np
import rvjax
from rvjax import lost_motion, tolerances

rvjax.enable_x64()
fork = multiprocessing.get_context("fork")
errors = rvjax.RVErrors.for_design(rvjax.catalogue.RV_40E, crank_eccentricity=1e-6)
TILT = lambda x: lost_motion.shaft_tilt(x, 0.5)


def tilt(x):
    return float(TILT(x))


def outcome(work):
    try:
        return f"{float(work()):g}"
    except RuntimeError as error:
        return str(error)


def shown(name, run, *arguments):
    try:
        print(name, run(*arguments), flush=True)
    except RuntimeError as error:
        print(name, error, flush=True)


def pool():
    with fork.Pool(1) as workers:
        return workers.map(tilt, [0.0])


def executor():
    with ProcessPoolExecutor(1, mp_context=fork) as workers:
        return list(workers.map(tilt, [0.0]))


def forked(work, ends=lambda: os._exit(0)):
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        print(work(), flush=True)
        ends()
    os.waitpid(child, 0)
    return "ended"


shown("before:", pool)
jitted, ahead, array = jax.jit(TILT), jax.jit(TILT).lower(0.0).compile(), jnp.ones(3)
jitted(0.0), ahead(0.0)
print("parent:", tilt(0.0), flush=True)
shown("pool:", pool)
shown("executor:", executor)
works = dict(
    compiled=lambda: jitted(0.0), ahead=lambda: ahead(0.0), batch=lambda: jax.vmap(TILT)(np.zeros(2))[0],
    slope=lambda: jax.grad(TILT)(0.0), sum=lambda: array.sum(), held=lambda: np.asarray(array).sum(),
    grade=lambda: tolerances.it_width("IT6", 0.03),
)
for name, work in works.items():
    forked(lambda: f"{name}: {outcome(work)}")
shown("exit:", forked, lambda: outcome(lambda: jitted(0.0)), sys.exit)
print("parent:", tilt(0.0), flush=True)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_process_forked_after_use_says_so_and_one_forked_before_it_computes():
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with subprocess.Popen([sys.executable, "-c", SCRIPT], start_new_session=True, **pipes) as process:
        try:
            said, errors = process.communicate(timeout=120)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # children that wait for ever, where it fails
    assert process.returncode == 0, errors
    lines = [line for line in said.splitlines() if ": " in line]
    found = dict(line.split(": ", 1) for line in lines)
    assert found["before"] == "[0.0]"
    assert [line for line in lines if line.startswith("parent")] == ["parent: 0.0"] * 2
    for name in ("pool", "executor", "compiled", "ahead", "batch", "slope", "sum"):
        assert found[name].startswith("this process was forked after JAX had computed") and "use spawn" in found[name]
    assert (found["held"], found["grade"], found["exit"]) == ("3", "1.3e-05", "ended")  # no program, no threads
