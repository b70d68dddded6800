"""Comparison of the four-bar model and the loaded model: tolerances certified in one, evaluated in the other.

`python -m benchmarks.two_studies` solves rv-40e, rv-40e-whole and rv-40e-whole without limits on life and forces. It
evaluates the results on the loaded model, at rated torque and at the torque of a test bench, 3 % of it, and keeps them
in `benchmarks/two_studies.json`, which the docs show: half an hour. What is kept stays; `--fresh` starts again.
"""

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import rvjax
from rvjax import study
from rvjax.commands.budget import error_budget
from rvjax.commands.compare import cost_of, put_into
from rvjax.population.estimates import wilson
from rvjax.render import plain
from rvjax.response.response import BLOCK
from rvjax.study.reader import EMBEDDED
from rvjax.tolerances import allocate, monte_carlo

KEPT = Path(__file__).parent / "two_studies.json"
TEST_TORQUE = "12.36 N m"  # 3 % of 412 N m
UNITS = 4096
SEED = 77
MORE = """
[requirement.test_torque]
response = "second_transmission_error"
upper = "1 arcmin"
target = 0.99

[requirement.four_bar]
response = "transmission_error"
upper = "1 arcmin"
target = 0.99

[requirement.pin_force]
upper = "100 kN"
target = 0.99

"""
OWN = ("loaded_transmission_error", "misfit", "bench_lost_motion")
"""Responses that both studies require."""
FORCES = ("life", "turn_pin_pressure", "arm_bearing_force")
"""Responses that rv-40e-whole requires besides."""
LINKAGE = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance")
"""Errors of the four-bar model."""


def observed() -> study.Study:
    """rv-40e-whole with the transmission error at the test torque, that of the four-bar and the largest pin force."""
    whole = (EMBEDDED / "rv-40e-whole.toml").read_text("utf-8")
    whole = whole.replace("[requirement.misfit]", f"{MORE}[requirement.misfit]")
    whole = whole.replace('rated_torque = "412 N m"', f'rated_torque = "412 N m"\nsecond_torque = "{TEST_TORQUE}"')
    return study.parse_study(whole, name="rv-40e-whole, observed", solve=False)


def optimum(asked: study.Study) -> dict[str, Any]:
    """Result of `rvjax allocate`, without the other content of a report."""
    found = allocate(
        asked.units, asked.tolerances, asked.requirements, costs=asked.costs, samples=asked.samples,
        seed=asked.seed, certificate_samples=min(asked.certificate_samples, 262_144), middles=asked.middles,
        joint_target=asked.joint_target,
    )  # fmt: skip
    limits = {f: getattr(found.tolerances, f) for f in asked.costs | asked.middles}
    return {
        "status": found.status,
        "cost": found.cost,
        "start cost": found.start_cost,
        "limits": {f: [float(one.lower), float(one.upper)] for f, one in limits.items()},
    }


def with_limits(tolerances: Any, limits: dict[str, list[float]]) -> Any:
    """Tolerances with the limits of a result."""
    return tolerances.replace(
        **{name: getattr(tolerances, name).replace(lower=low, upper=high) for name, (low, high) in limits.items()}
    )


def judged(asked: study.Study, answer: Any) -> dict[str, Any]:
    """Yields with intervals, 99 % quantiles, and the correlation of both models."""
    whole = put_into(asked, answer)
    found = monte_carlo(
        asked.response(), whole, samples=UNITS, seed=SEED, chunk=BLOCK, requirements=asked.requirements, keep=True
    )  # fmt: skip
    values = {name: np.asarray(found.values[name]) for name in asked.requirements}
    good = np.isfinite(values["loaded_transmission_error"])
    errors = ("transmission_error", "loaded_transmission_error", "second_transmission_error")
    correlation = np.corrcoef([values[name][good] for name in errors])[0]
    far = {name: 0.01 if np.isinf(asked.requirements[name].upper) else 0.99 for name in values}  # where the limit is
    quantiles = {name: float(np.quantile(value[good], far[name])) for name, value in values.items()}
    shares = {name: found.yield_[name] for name in asked.requirements if name != "pin_force"}
    for name, responses in (("accuracy", OWN), ("all of rv-40e-whole", OWN + FORCES)):
        kept = [asked.requirements[response].margins(values[response]) <= 0 for response in responses]
        shares[name] = wilson(int(np.all(kept, axis=0).sum()), UNITS, found.confidence)
    return {
        "yield": {name: [one.value, one.lower, one.upper] for name, one in shares.items()},
        "99 % quantile": {name: value / asked.output(name).shown[1] for name, value in quantiles.items()},
        "correlation with the four-bar": {"412 N m": correlation[1], "12.4 N m": correlation[2]},
        "failures": found.failures,
        "cost": cost_of(asked, whole),
    }


def main() -> None:
    """Run, or go on from what is kept."""
    rvjax.enable_x64()
    kept = json.loads(KEPT.read_text()) if KEPT.exists() and "--fresh" not in sys.argv else {}

    def keep(name: str, made: Any) -> Any:
        if name not in kept:
            started = time.perf_counter()
            kept[name] = made()
            KEPT.write_text(json.dumps(kept, indent=1) + "\n")
            print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
        return kept[name]

    four, whole = (study.load(name, solve=False) for name in ("rv-40e", "rv-40e-whole"))
    picture = keep("result of rv-40e", lambda: optimum(four))
    asked = observed()
    cheap = with_limits(four.tolerances, picture["limits"])
    alone = asked.tolerances.replace(**dict.fromkeys((f for f in asked.fields if f not in LINKAGE), None))
    linkage = dataclasses.replace(asked, tolerances=alone, costs={f: asked.costs[f] for f in LINKAGE})
    keep("optimum of the four-bar, its errors alone", lambda: judged(linkage, cheap))
    half = cheap.replace(equidistant_modification=four.tolerances.equidistant_modification)
    keep("optimum of the four-bar", lambda: judged(asked, half))
    flanks = {n: getattr(four.design.cycloid, n) for n in ("equidistant_modification", "shift_modification")}
    pressed = dataclasses.replace(asked, design=asked.design.replace(cycloid=asked.design.cycloid.replace(**flanks)))
    keep("optimum of the four-bar, with its flanks", lambda: judged(pressed, cheap))
    keep("tolerances of rv-40e-whole", lambda: judged(asked, asked.tolerances))
    keep("budget of rv-40e-whole", lambda: plain(error_budget(whole)))
    free = dataclasses.replace(whole, requirements={name: whole.requirements[name] for name in OWN})
    accurate = keep("result without limits on forces", lambda: optimum(free))
    keep("optimum without limits on forces", lambda: judged(asked, with_limits(asked.tolerances, accurate["limits"])))
    machine = keep("result of rv-40e-whole", lambda: optimum(whole))
    keep("optimum of the whole reducer", lambda: judged(asked, with_limits(asked.tolerances, machine["limits"])))


if __name__ == "__main__":
    main()
