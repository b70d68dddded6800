"""Models whose batches are loops over blocks, on all cores: a device of JAX for each, next to C and Numba with threads.

`jax.shard_map` gives each device its part of the batch, as `rvjax montecarlo` does. Mesh forces (hertz) as in
`mesh_force`, peaks of lines over 40 speeds as in `dynamic_error`; results are compared before anything is timed.
"""

import ctypes
import os

import numpy as np

from benchmarks.timing import alternate, arguments, c_library, compiled, publish, settings

settings()

import jax  # noqa: E402  (after the flags)

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
jax.config.update("jax_num_cpu_devices", CORES)

from benchmarks import dynamic_error, mesh_force  # noqa: E402
from benchmarks.mesh_force_others import in_numba, source  # noqa: E402

UNITS = 64 * dynamic_error.CHUNK
OVER, WHOLE = jax.sharding.PartitionSpec("units"), jax.sharding.PartitionSpec()


def shared(function, whole, *columns):
    """A function of a whole record and batches, compiled for parts of the batches on all devices, and its arguments."""
    mesh = jax.sharding.Mesh(np.array(jax.devices()), ("units",))
    specs = (WHOLE, *(OVER for _ in columns))
    mapped = jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=OVER, check_vma=False)
    placed = jax.device_put((whole, *columns), tuple(jax.sharding.NamedSharding(mesh, spec) for spec in specs))
    program, _ = compiled(mapped, *placed)
    return lambda: program(*placed)


def mesh_forces():
    """Contenders for all forces of a batch."""
    columns, rollers = mesh_force.draw(mesh_force.CASES), mesh_force.ROLLERS
    run = shared(lambda _, *x: mesh_force.solve("hertz", *x), (), *columns)
    design = np.array([getattr(mesh_force.CORR, name) for name in mesh_force.DESIGN])
    turn = 2 * np.pi * np.arange(rollers) / rollers
    outputs = [np.empty((mesh_force.CASES, rollers)) for _ in range(3)] + [np.empty(mesh_force.CASES)]

    def numba():
        in_numba(design, *columns, np.cos(turn), np.sin(turn), *outputs)
        return outputs[3]

    found = {"rvjax": lambda: run().windup, "numba": numba}
    library = c_library(source(rollers))
    if library is not None:
        rows, results = mesh_force.c_arrays(columns)
        arrays = (design, *rows, *results)

        def c_cases():
            pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
            library.solve(ctypes.c_long(mesh_force.CASES), *pointers, None)
            return results[3]

        found["C"] = c_cases
    return found, mesh_force.CASES


def peaks_of_lines():
    """Contenders for the peaks of all lines of a batch."""
    found, arguments = dynamic_error.contenders(UNITS)
    run = shared(dynamic_error.peaks, *arguments)
    one = {"rvjax": lambda: run().reshape(UNITS, -1)}
    return one | ({"C": found["C, all threads"]} if "C, all threads" in found else {}), UNITS


def main():
    """Measure, after all agree."""
    path = arguments(__doc__.splitlines()[0]).json
    figures = {"cores": CORES}
    for name, (contenders, size) in {"mesh forces": mesh_forces(), "peaks of lines": peaks_of_lines()}.items():
        expected = np.array(contenders["rvjax"]())
        for other, run in contenders.items():
            np.testing.assert_allclose(np.asarray(run()), expected, rtol=1e-9, err_msg=f"{name}, {other}")
        best = alternate(contenders, seconds=2.0)
        figures |= {f"{name}, {other}, ns": 1e9 * seconds / size for other, seconds in best.items()}
        figures |= {f"{name}, rvjax / {other}": best["rvjax"] / best[other] for other in best if other != "rvjax"}
    publish("cores", figures, path)


if __name__ == "__main__":
    main()
