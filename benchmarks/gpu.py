"""Units of a Monte Carlo study on a GPU, next to all cores of the processor, in one process.

Transmission error and lost motion of the four-bar model, and roller forces. Values and statuses of the same units are
compared before anything is timed. It needs a JAX that supports the GPU:

    JAX_PLATFORMS=cuda,cpu python -m benchmarks.gpu [--only corr] [--json FILE]
"""

import argparse
import os
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.timing import alternate, compiled, publish, settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

jax.config.update("jax_num_cpu_devices", min(8, os.cpu_count() or 1))  # as the command line does

from rvjax import study  # noqa: E402
from rvjax.population.population import Population, drawn, root_key  # noqa: E402
from rvjax.response.response import respond  # noqa: E402

STUDIES = {"rv-40e": 2**20, "corr": 2**17}  # units in one call
OVER, UNITS = jax.sharding.PartitionSpec(None, "units"), jax.sharding.PartitionSpec("units")


def contenders(name, units):
    """The study's response for a batch, on the first GPU and on all devices of the processor."""
    asked = study.load(name)
    response, population = asked.response(), Population.of(asked.tolerances)
    batch = lambda z: respond(response, population, z)  # noqa: E731
    cpu, gpu = jax.devices("cpu"), jax.devices("gpu")[0]
    with jax.default_device(cpu[0]):
        z = np.asarray(drawn(population, root_key(0), jnp.uint32(0), count=units))
    mesh = jax.sharding.Mesh(np.array(cpu), ("units",))
    shared = jax.shard_map(batch, mesh=mesh, in_specs=OVER, out_specs=UNITS, check_vma=False)
    at_cpu, at_gpu = jax.device_put(z, jax.sharding.NamedSharding(mesh, OVER)), jax.device_put(z, gpu)
    on_gpu, _ = compiled(batch, at_gpu)
    with mock.patch("jax.default_backend", return_value="cpu"):  # as in a process without a GPU
        on_cpu, _ = compiled(shared, at_cpu, options=getattr(response, "compiler_options", ()))
    return {"GPU": lambda: on_gpu(at_gpu), "CPU": lambda: on_cpu(at_cpu)}


def measured(name):
    """Times a unit, and what both devices give, compared first."""
    found = contenders(name, STUDIES[name])
    (values, status), (expected, other) = (jax.tree.map(np.asarray, run()) for run in found.values())
    np.testing.assert_array_equal(status, other)
    worst = 0.0
    for key, value in expected.items():
        finite = np.isfinite(value)
        np.testing.assert_array_equal(np.isfinite(values[key]), finite)
        worst = max(worst, np.max(np.abs(values[key] - value)[finite]) / np.std(value[finite]))
    best = {place: 1e6 * seconds / STUDIES[name] for place, seconds in alternate(found).items()}
    return {
        **{f"{name}: {place}, us per unit": us for place, us in best.items()},
        f"{name}: CPU / GPU": best["CPU"] / best["GPU"],
        f"{name}: largest difference / standard deviation": worst,
    }


def main():
    """Measure, after all agree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=STUDIES, default=list(STUDIES))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    figures = {"gpu": jax.devices("gpu")[0].device_kind}
    for name in options.only:
        figures |= measured(name)
    publish("gpu", figures, options.json)


if __name__ == "__main__":
    main()
