"""From nothing to the first result of each model: a fresh process that imports, compiles and runs one call.

Each runs three times: without kept programs, into an empty folder of kept programs (`JAX_COMPILATION_CACHE_DIR`), and
from that folder.
"""

import os
import subprocess
import sys
import tempfile
import time

from benchmarks.timing import arguments, publish

CALLS = {
    "mesh_force": """
design = catalogue.CORR
solve = lambda torque: rvjax.mesh_force.solve(design, CamRollerErrors(), input_torque=torque, output_angle=0.1)
print(rvjax.check(jax.jit(solve)(100.0)).windup)""",
    "four_bar": """
turn = lambda torque: rvjax.four_bar.revolution(catalogue.RV_40E, RVErrors(), output_torque=torque)
print(rvjax.check(jax.jit(turn)(412.0)).peak_to_peak)""",
    "lost_motion": """
print(rvjax.check(jax.jit(rvjax.lost_motion.geometric)(catalogue.RV_20E, catalogue.RV_20E_ERRORS)).total)""",
    "dynamics": """
speed = jax.jit(lambda w: rvjax.dynamics.response(catalogue.RV_320E, sun_speed=w, output_torque=-3136.0).amplitude)
print(abs(speed(160.0)).max())""",
    "loaded": """
from rvjax.loaded.cases import MACHINE
print(rvjax.check(rvjax.loaded.equilibrium(MACHINE, RVErrors(), input_angle=0.1, output_torque=412.0)).error)""",
}
HEAD = "import jax, rvjax; from rvjax import catalogue, RVErrors, CamRollerErrors; rvjax.enable_x64()\n"


def seconds(code: str, folder: str | None) -> float:
    """Of a fresh process that runs the code."""
    settings = (
        {"JAX_COMPILATION_CACHE_DIR": folder, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"} if folder else {}
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")} | settings
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", HEAD + code], check=True, env=environment, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main():
    path = arguments(__doc__.splitlines()[0]).json
    figures = {}
    for name, code in CALLS.items():
        with tempfile.TemporaryDirectory() as folder:
            for label, where in (("", None), (" filling the cache", folder), (" from the cache", folder)):
                figures[f"{name}{label}, s"] = seconds(code, where)
    publish("first_call", figures, path)


if __name__ == "__main__":
    main()
