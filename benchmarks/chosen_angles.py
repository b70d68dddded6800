"""Angles of a turn of the output chosen for each unit: what they lose against all angles, and what a unit takes.

    python -m benchmarks.chosen_angles

The peak to peak of the transmission error and the largest pin pressure of 1,024 units, of each embedded study with its
initial tolerances, against 481 angles; the same of equal angles and of a crank turn. Near the limit are units above
three quarters of the value that 98.6 % of the units keep. Seconds are those of one core, best of three calls.
"""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.timing import settings

settings()

from rvjax import study  # noqa: E402  (after the flags)
from rvjax.population import Population, drawn, root_key  # noqa: E402
from rvjax.response import parts  # noqa: E402
from rvjax.study import Response, Study  # noqa: E402

UNITS, ANGLES, SHARE, NEAR = 1024, 481, 0.986, 0.75
ERROR, PRESSURE = "loaded_transmission_error", "turn_pin_pressure"
WAYS = {
    "all angles": {},
    **{f"{n} chosen angles": dict(chosen_angles=n) for n in (12, 16, 24, 32)},
    **{f"{n} equal angles": dict(samples=n) for n in (25, 97, 193)},
    "crank turn": None,
}


def solved(own: Study, z: np.ndarray, conditions: object) -> tuple[np.ndarray, np.ndarray, float]:
    """Errors and pressures (n,) of the units, and ms of a unit."""
    asked = replace(own, conditions=conditions)
    response = Response.of(asked.design, (ERROR, PRESSURE), asked.conditions)
    (part,) = parts(asked.at_few(response), population := Population.of(asked.tolerances))
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        values, status, _ = part.solve(population, z)
        seconds.append(time.perf_counter() - start)
    if status.any():
        raise ValueError(f"{np.count_nonzero(status)} units failed")
    return values[part.names.index(ERROR)], values[part.names.index(PRESSURE)], 1e3 * min(seconds) / len(values[0])


def rows(name: str) -> Iterator[str]:
    """A line for each way of a study."""
    own = study.load(name, solve=False)
    z = np.asarray(drawn(Population.of(own.tolerances), root_key(99), np.uint32(0), count=UNITS))
    whole = None
    for way, changes in WAYS.items():
        turn = dict(span="output_turn", samples=ANGLES)
        conditions = own.conditions if changes is None else replace(own.conditions, **turn | changes)
        error, pressure, ms = solved(own, z, conditions)
        whole = whole or (error, pressure)
        near = whole[0] > NEAR * np.quantile(whole[0], SHARE)
        lost = [1 - error / whole[0], (1 - error / whole[0])[near], 1 - pressure / whole[1]]
        kept = [np.quantile(some, SHARE) / np.quantile(all_, SHARE) for some, all_ in zip((error, pressure), whole)]
        yield f"{way:18}" + "".join(f"{100 * x.mean():9.1f}" for x in lost) + f"{kept[0]:9.3f}{kept[1]:9.3f}{ms:9.3f}"


def main() -> None:
    """Print the table of both studies."""
    for name in ("rv-40e-whole", "cycloidal-17"):
        print(f"{name:18}  error %   near %  press. %  q error  q press.  ms/unit")
        for line in rows(name):
            print(line, flush=True)


if __name__ == "__main__":
    main()
