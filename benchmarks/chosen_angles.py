"""Angles of a turn of the output chosen for each unit: how far values are from those at all, and what a unit takes.

    python -m benchmarks.chosen_angles

The peak to peak of the transmission error and the largest pin pressure of 1,024 units, of each embedded study with its
initial tolerances, against 481 angles; the same of equal angles and of a crank turn. "mean" and "sd" are the mean of
the deviation and its standard deviation; "limit" is the value that 98.6 % of the units keep over that at all angles;
"kept" is the share of the units whose value at all angles is below that limit. Seconds are those of one core, best of
three calls.
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
from rvjax.tolerances import Requirement  # noqa: E402

UNITS, ANGLES, SHARE = 1024, 481, 0.986
ERROR, PRESSURE = "loaded_transmission_error", "turn_pin_pressure"
WAYS = {
    "all angles": {},
    **{f"{n} chosen angles": dict(chosen_angles=n) for n in (8, 10, 12, 16, 24, 32)},
    **{f"{n} equal angles": dict(samples=n) for n in (25, 97, 193)},
    "crank turn, 24": dict(span="crank_turn", samples=24),
}


def solved(own: Study, z: np.ndarray, conditions: object) -> tuple[np.ndarray, np.ndarray, float]:
    """Errors and pressures (n,) of the units, and ms of a unit."""
    asked = replace(own, conditions=conditions, requirements=dict.fromkeys((ERROR, PRESSURE), Requirement(upper=1.0)))
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
        conditions = replace(own.conditions, **dict(span="output_turn", samples=ANGLES, chosen_angles=None) | changes)
        error, pressure, ms = solved(own, z, conditions)
        whole = whole or (error, pressure)
        line = f"{way:18}"
        for some, all_ in zip((error, pressure), whole):
            deviation, limit = 100 * (some / all_ - 1), np.quantile(some, SHARE)
            moved, kept = limit / np.quantile(all_, SHARE), 100 * np.mean(all_ <= limit)
            line += f"{deviation.mean():9.1f}{deviation.std():6.1f}{moved:8.3f}{kept:7.1f}"
        yield line + f"{ms:9.3f}"


def main() -> None:
    """Print the table of both studies."""
    for name in ("rv-40e-whole", "cycloidal-17"):
        columns = f"{'mean %':>9}{'sd %':>6}{'limit':>8}{'kept %':>7}"
        print(f"{name:18}{'error':>9}{'':21}{'pressure':>9}\n{'':18}{2 * columns}  ms/unit")
        for line in rows(name):
            print(line, flush=True)


if __name__ == "__main__":
    main()
