"""Monte Carlo on several devices, in several processes, and killed at any moment.

Oracles: the uninterrupted run on one device in one process, to the last bit where the chunk is the same and to
round-off (1e-12 relative, counts equal) where it is not.
"""

import multiprocessing
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from scale_study import bits, curves, run, same_to_roundoff

from rvjax.tolerances import load
from rvjax.tolerances.batch import statistics

ROOT = Path(__file__).parents[2]

CHILD = """
import jax
jax.config.update("jax_enable_x64", True)
if {address!r}:
    jax.distributed.initialize({address!r}, num_processes=2, process_id={process})
import scale_study as here
found = {{m: here.run(20_500, method=m, **{options}) for m in ("random", "sobol")}}
found["again"] = here.run(20_500, **{options})
found["few"] = here.run(700, **{options})
found["long"] = here.run(20_500, **({options} | dict(chunk=4096)))
from rvjax.tolerances import save
about = {{"devices": len(jax.local_devices()), "processes": jax.process_count()}}
save({{"curves": here.curves() if {thorough} else [], "found": found}} | about, {path!r})
"""


def child(path, *, devices=1, address="", process=0, options=None, thorough=False):
    code = CHILD.format(address=address, process=process, options=options or {}, path=str(path), thorough=thorough)
    own = {"JAX_NUM_CPU_DEVICES": str(devices), "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT / "tests")}
    environment = os.environ | own
    return subprocess.Popen([sys.executable, "-c", code], env=environment, cwd=ROOT)


@pytest.fixture(scope="module")
def alone():
    found = {m: run(20_500, method=m) for m in ("random", "sobol")}
    return found | {"few": run(700), "long": run(20_500, chunk=4096)}


def test_eight_devices_give_what_one_gives(tmp_path, alone, thorough):
    assert child(tmp_path / "eight.json", devices=8, thorough=thorough).wait(120) == 0
    result = load(tmp_path / "eight.json")
    assert result["devices"] == 8
    for name, expected in alone.items():
        same_to_roundoff(result["found"][name], expected)
    assert bits(result["found"]["again"]) == bits(result["found"]["random"])
    for shared, whole in zip(result["curves"], curves() if thorough else []):
        np.testing.assert_allclose(shared, whole, rtol=0, atol=1e-15)


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


@pytest.mark.long  # test_cli_montecarlo.py asks two processes for the figures of one
def test_two_processes_give_the_bits_of_one(tmp_path, alone):
    address = f"127.0.0.1:{free_port()}"
    both = [child(tmp_path / f"{p}.json", address=address, process=p) for p in (0, 1)]
    assert [process.wait(120) for process in both] == [0, 0]
    for p in (0, 1):
        result = load(tmp_path / f"{p}.json")
        assert result["processes"] == 2
        for name, expected in alone.items():
            assert bits(result["found"][name]) == bits(expected), name


def slow_study(path, samples):
    """A study in a process of its own that takes at least 4 ms a chunk."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", f"{path}.programs")  # compile once for all processes
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    add = statistics.Accumulator.add

    def slow(*arguments, **options):
        with Path(f"{path}.begun").open("ab") as begun:
            begun.write(b".")
        time.sleep(0.004)
        add(*arguments, **options)

    statistics.Accumulator.add = slow
    run(samples, checkpoint=path, checkpoint_every=0)


def test_killed_at_ten_random_moments_and_resumed(tmp_path):
    """One to six chunks after each start."""
    path, samples = tmp_path / "c", 100_500
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["jax", "rvjax.tolerances"])
    rng, reached = np.random.default_rng(0), []
    for _ in range(10):
        process = context.Process(target=slow_study, args=(path, samples))
        process.start()
        begun = Path(f"{path}.begun")
        chunks = rng.integers(1, 7)
        while not begun.exists() or begun.stat().st_size < chunks:
            assert process.is_alive()
            time.sleep(0.001)
        time.sleep(rng.uniform(0.0, 0.004))
        process.kill()  # SIGKILL
        process.join()
        assert process.exitcode == -9
        begun.unlink()
        with np.load(path) as file:  # whole at any moment
            reached.append(int(file["chunks"].sum()) if "chunks" in file else 0)  # one range from 0, or none
    assert reached == sorted(reached) and 0 < reached[-1] < 100
    assert len(set(reached)) > 3
    assert bits(run(samples, checkpoint=path)) == bits(run(samples))
