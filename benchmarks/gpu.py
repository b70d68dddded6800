"""Studies on a GPU next to all cores of the processor: units in one process, then whole commands.

    JAX_PLATFORMS=cuda,cpu python -m benchmarks.gpu [--only rv-40e-whole] [--seconds 180] [--json FILE]

Values and statuses of the same units are compared before anything is timed. Commands run with an empty folder of kept
programs, then with what that run has kept; each figure comes with its goal. A command is ended when the time is
over, later ones are left out. It needs a JAX that supports the GPU.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from importlib import resources
from pathlib import Path

import numpy as np

from benchmarks.timing import alternate, compiled, publish, settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_num_cpu_devices", min(8, os.cpu_count() or 1))  # as the command line does
jax.config.update("jax_default_device", "cpu")

from rvjax import study  # noqa: E402
from rvjax.population.population import Population, drawn, root_key  # noqa: E402
from rvjax.response import parts, units_on  # noqa: E402
from rvjax.response.response import respond  # noqa: E402
from rvjax.study.reader import parse_study  # noqa: E402

CHEAP = {"rv-40e": 2**20, "corr": 2**17}  # units in one call
WHOLE, UNITS = "rv-40e-whole", 2**13
OVER, ALONG = jax.sharding.PartitionSpec(None, "units"), jax.sharding.PartitionSpec("units")
ERROR = "transmission_error"
COMMANDS = {  # name: command line, and goals for its first run and for one with kept programs, s
    "allocate rv-40e-whole": (["allocate", WHOLE, "--fresh"], (60.0, 15.0)),
    "montecarlo rv-40e-whole, 262,144 units": (["montecarlo", WHOLE, "--samples", "262144"], (None, None)),
    "montecarlo transmission error, 1e7 units": (["montecarlo", "error.toml", "--samples", "1e7"], (60.0, None)),
    "montecarlo rv-40e-whole, 1e6 units": (["montecarlo", WHOLE, "--samples", "1e6"], (60.0, 25.0)),
}
GOALS = {f"{WHOLE}: lost_motion: GPU, us per unit": 10.0}


def gpus():
    """The GPUs of this process."""
    return jax.local_devices(backend="gpu")


def cheap(name):
    """The study's response for a batch, on the first GPU and on all devices of the processor."""
    asked, units = study.load(name), CHEAP[name]
    response, population = asked.response(), Population.of(asked.tolerances)
    batch = lambda z: respond(response, population, z)  # noqa: E731
    cpu, gpu = jax.devices("cpu"), gpus()[0]
    z = np.asarray(drawn(population, root_key(0), jnp.uint32(0), count=units))
    mesh = jax.sharding.Mesh(np.array(cpu), ("units",))
    shared = jax.shard_map(batch, mesh=mesh, in_specs=OVER, out_specs=ALONG, check_vma=False)
    at_cpu, at_gpu = jax.device_put(z, jax.sharding.NamedSharding(mesh, OVER)), jax.device_put(z, gpu)
    on_gpu, _ = compiled(batch, at_gpu)
    on_cpu, _ = compiled(shared, at_cpu, options=getattr(response, "compiler_options", ()))
    return {name: {"GPU": lambda: on_gpu(at_gpu), "CPU": lambda: on_cpu(at_cpu)}}, units


def whole():
    """Transmission error and lost motion of loaded units, as a command solves them, with the copies to the host."""
    found = {}
    for name, asked in ((ERROR, error_alone()[1]), ("lost_motion", study.load(WHOLE, solve=False))):
        response, population = asked.response(solve=False), Population.of(asked.tolerances)
        z = np.asarray(drawn(population, root_key(0), jnp.uint32(0), count=UNITS))
        (part,) = (part for part in parts(response, population) if any(name in each for each in part.names[:1]))

        def solved(devices, part=part, population=population, z=z):
            with units_on(devices):
                values, status = part.solve(population, z)
            return dict(zip(part.names, values)), status

        found[f"{WHOLE}: {name}"] = {"GPU": lambda s=solved: s(gpus()), "CPU": lambda s=solved: s([])}
    return found, UNITS


def measured(found, units):
    """Times a unit, and the digits that agree: of the largest difference over the standard deviation."""
    figures = {}
    for name, runs in found.items():
        (values, status), (expected, other) = (jax.tree.map(np.asarray, run()) for run in runs.values())
        np.testing.assert_array_equal(status, other)
        for key, value in expected.items():
            finite = np.isfinite(value)
            np.testing.assert_array_equal(np.isfinite(values[key]), finite)
            worst = np.max(np.abs(values[key] - value)[finite], initial=0.0) / max(np.std(value[finite]), 1e-300)
            figures[f"{name}: {key}, digits"] = float(-np.log10(max(worst, 1e-17)))
        best = {place: 1e6 * seconds / units for place, seconds in alternate(runs).items()}
        figures |= {f"{name}: {place}, us per unit": us for place, us in best.items()}
        figures[f"{name}: CPU / GPU"] = best["CPU"] / best["GPU"]
    return figures


def error_alone():
    """The loaded study without requirements but that on the transmission error: its text, and as it is read."""
    whole = (resources.files("rvjax.study") / "embedded" / f"{WHOLE}.toml").read_text("utf-8")
    read = [line for line in whole.splitlines() if not line.startswith(("life_samples", "probe_angles", "angles"))]
    head, *tables = "\n".join(read).split("\n[")
    others = "requirement.", "cost.", "[duty"
    text = "\n[".join([head, *(t for t in tables if t.startswith(f"requirement.{ERROR}]") or not t.startswith(others))])
    return text, parse_study(text, name="error", solve=False)


def seconds(line, folder, limit):
    """Seconds of a command; None where it was ended at the limit."""
    kept = {"XDG_CACHE_HOME": str(folder / "cache"), "JAX_PLATFORMS": os.environ.get("JAX_PLATFORMS", "cuda,cpu")}
    start = time.perf_counter()
    try:
        command = [sys.executable, "-m", "rvjax", *line, "--quiet"]
        done = subprocess.run(
            command, cwd=folder, env=os.environ | kept, check=False, capture_output=True, text=True, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return None
    if done.returncode not in (0, 1):  # 1: a study without a result
        raise RuntimeError(f"{line}: exit code {done.returncode}\n{done.stderr}")
    return time.perf_counter() - start


def timed(names, end):
    """Seconds of commands by name and run, in words where the time is over."""
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "error.toml").write_text(error_alone()[0], "utf-8")
        for name in names:
            line, goals = COMMANDS[name]
            for run, goal in zip(("first", "kept"), goals):
                left, key = end - time.perf_counter(), f"{name}, {run}, s"
                taken = seconds(line, Path(folder), left) if left > 5 else None
                what = f"not ended in {left:.0f} s" if left > 5 else "not run, no time left"
                figures[key] = what if taken is None else taken
                print(f"{key:60s} {figures[key]}   goal {goal}", flush=True)
    return figures


def main():
    """Measure, after all agree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    kinds = [*CHEAP, WHOLE, "commands"]
    parser.add_argument(
        "--only", nargs="+", choices=kinds, default=[WHOLE, "commands"], help="by default the loaded study"
    )
    parser.add_argument("--seconds", type=float, default=180.0, help="for all; commands are ended then")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    end = time.perf_counter() + options.seconds
    figures = {"gpu": gpus()[0].device_kind}
    for name in options.only:
        if name == "commands":
            figures |= timed(COMMANDS, end)
        else:
            figures |= measured(*(whole() if name == WHOLE else cheap(name)))
    publish("gpu", figures, options.json)
    for name, goal in GOALS.items():
        if name in figures:
            print(f"{name}: {figures[name]:.3g}, goal {goal:g}")


if __name__ == "__main__":
    main()
