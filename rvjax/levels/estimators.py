"""What an estimate over many units costs and how far it is off: bias of the method plus sampling error."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from rvjax import models
from rvjax.catalogue import RV_40E
from rvjax.four_bar.outputs import LINKS
from rvjax.levels.choice import design_numbers, reach
from rvjax.levels.table import Level, Model
from rvjax.tolerances import Outcome, Tolerance, for_design, monte_carlo, rss


def measure_statistics(*, quick: bool, seed: int) -> Model:
    """Mean and standard deviation of the transmission error of a batch of RV-40E units, by every method."""
    tolerances = for_design(RV_40E, **{name: Tolerance(*ends) for name, ends in LINKS.items()})
    kind = models.kind(RV_40E)
    given = kind.conditions(output_torque=412.0, angles=16)

    def value(errors: Any) -> Any:
        return Outcome(*kind.outputs["transmission_error"].evaluate(RV_40E, errors, given))

    def drawn(method: str, units: int, number: int) -> tuple[float, float]:
        found = monte_carlo(value, tolerances, samples=units, seed=number, method=method, chunk=min(units, 16384))
        return float(found.mean.value), float(found.sd.value)

    def propagated(_: int) -> tuple[float, float]:
        found = rss(value, tolerances)
        return float(found.mean), float(found.sd)

    ways: dict[str, Callable[[int], tuple[float, float]]] = {"rss, order 1": propagated}
    for units in (1024, 16384, 262_144)[: 2 if quick else 3]:
        ways |= {f"{method}, {units} units": partial(drawn, method, units) for method in ("random", "sobol")}
    exact_name = "sobol, reference"
    ways[exact_name] = partial(drawn, "sobol", 2**18 if quick else 2**21)
    truth = ways[exact_name](seed + 999)
    levels = []
    for name, run in ways.items():
        repeats = 1 if name == exact_name or name.startswith("rss") else 8
        started = time.perf_counter()
        run(seed)
        first = time.perf_counter() - started
        off, seconds = [], []
        for k in range(repeats):
            started = time.perf_counter()
            found = run(seed + k)
            seconds.append(time.perf_counter() - started)
            off.append(np.abs(np.subtract(found, truth)))
        largest, rms = np.max(off, axis=0), np.sqrt(np.mean(np.square(off), axis=0))
        if name == exact_name:
            largest, rms = np.zeros(2), np.zeros(2)
        levels.append(
            Level(
                name=name,
                settings={},
                precision="float64",
                largest={"mean": [float(largest[0])], "sd": [float(largest[1])]},
                rms={"mean": [float(rms[0])], "sd": [float(rms[1])]},
                ns=1e9 * min(seconds),
                compile_s=max(0.0, first - min(seconds)),
                memory_MB=0.0,
                cases=1,
            )
        )
    return Model(
        name="statistics",
        outputs={"mean": "rad", "sd": "rad"},
        case="mean and standard deviation of the transmission error of all units (16 angles)",
        design=design_numbers(RV_40E),
        spread=0.0,
        errors=reach(tolerances),
        sizes=[1.0],
        torque=None,
        conditions={},
        typical={"mean": [truth[0]], "sd": [truth[1]]},
        failed=(0, 0),
        reference=exact_name,
        levels=tuple(levels),
    )
