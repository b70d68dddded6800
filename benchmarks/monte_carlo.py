"""A hundred million RV-40E units in one run: rate next to the bare jitted kernel, memory against units.

The response is the four-bar part of the embedded study: peak-to-peak transmission error over a crank turn of 64
angles under load, with the study's tolerances and requirement. The bare kernel is the same two jitted programs
(random numbers, response) called chunk after chunk with nothing read by the host; the two alternate, in batches of a
few hundred thousand units, so that other load slows both alike. Memory is the largest resident set in every tenth
of the run.

    python -m benchmarks.monte_carlo --units 1e8 [--method sobol] [--checkpoint FILE] [--json FILE]
    python -m benchmarks.monte_carlo --seeds 200
"""

import argparse
import functools
import math
import os
import threading
import time
from pathlib import Path

from benchmarks.timing import alternate, publish, settings

settings()

import jax.numpy as jnp  # noqa: E402

from rvjax import study  # noqa: E402
from rvjax.population.population import Population, drawn, root_key  # noqa: E402
from rvjax.response.response import respond  # noqa: E402
from rvjax.study.response import Response  # noqa: E402
from rvjax.tolerances import monte_carlo  # noqa: E402
from rvjax.units import arcmin  # noqa: E402

FIELDS = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance")
OUTPUT = "transmission_error"


def question():
    """Response, tolerances and requirement of the four-bar part of the study."""
    asked = study.load("rv-40e")
    others = {name: None for name in asked.fields if name not in FIELDS}
    respond_with = Response.of(asked.design, (OUTPUT,), asked.conditions)
    return respond_with, asked.tolerances.replace(**others), {OUTPUT: asked.requirements[OUTPUT]}


def resident():
    """Memory of this process in MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


class Memory:
    """Largest resident set in each part of a run, sampled every 20 ms."""

    def __init__(self):
        self.largest, self._on = 0.0, True
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self):
        while self._on:
            self.largest = max(self.largest, resident())
            time.sleep(0.02)

    def part(self):
        """The largest since the last call."""
        found, self.largest = max(self.largest, resident()), 0.0
        return found

    def stop(self):
        """End watching."""
        self._on = False
        self._thread.join()


def race(response, tolerances, required, chunk, method, chunks=12):
    """Smallest ns a unit of the statistics, of the bare programs, and of the response alone, in turn."""
    key = root_key(0)
    population = Population.of(tolerances)
    z = drawn(population, key, jnp.uint32(0), count=chunk)

    def whole():
        units = chunks * chunk
        monte_carlo(response, tolerances, samples=units, seed=0, chunk=chunk, method=method, requirements=required)

    def kernel():  # chunk after chunk without waiting between them
        for number in range(chunks):
            out = respond(response, population, drawn(population, key, jnp.uint32(number * chunk), count=chunk))
        return out

    def response_alone():
        for _ in range(chunks):
            out = respond(response, population, z)
        return out

    best = alternate({"monte_carlo": whole, "kernel": kernel, "response_alone": response_alone}, seconds=5, rounds=15)
    return {name: 1e9 * seconds / (chunks * chunk) for name, seconds in best.items()}


def sobol_gain(seeds, units=16384):
    """Errors of the whole study's estimates by both methods: seen over seeds, stated, and covered by the intervals."""
    asked = study.load("rv-40e")
    run = functools.partial(monte_carlo, asked.response(), asked.tolerances, requirements=asked.requirements)
    true = run(samples=2**21, seed=10**6, method="sobol")
    figures = {
        "mean": lambda s, name: s.mean[name],
        "sd": lambda s, name: s.sd[name],
        "quantile 99.865 %": lambda s, name: s.quantiles[0.99865][name],
        "yield": lambda s, name: s.yield_[name],
    }
    print(f"{seeds} studies of {units} units; the truth from {2**21} Sobol units")
    print(
        f"{'response':20s} {'figure':18s} {'method':7s} {'rms error':>10s} {'stated':>10s} {'covered':>8s} {'gain':>6s}"
    )
    found = {
        method: [run(samples=units, seed=s, method=method) for s in range(seeds)] for method in ("random", "sobol")
    }
    for name in asked.requirements:
        for figure, of in figures.items():
            truth, seen = of(true, name).value, {}
            for method, runs in found.items():
                estimates = [of(statistics, name) for statistics in runs]
                seen[method] = math.sqrt(sum((e.value - truth) ** 2 for e in estimates) / seeds)
                stated = math.sqrt(sum(e.error**2 for e in estimates) / seeds)
                covered = sum(e.lower <= truth <= e.upper for e in estimates) / seeds
                gain = f"{seen['random'] / seen[method]:6.1f}" if seen[method] else "     -"
                row = f"{name:20s} {figure:18s} {method:7s} {seen[method]:10.3g} {stated:10.3g} {covered:8.3f} {gain}"
                print(row)


def main():
    """Race, then the long run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--units", type=float, default=1e7)
    parser.add_argument("--chunk", type=int, default=32768)
    parser.add_argument("--method", default="random")
    parser.add_argument("--checkpoint", help="write a checkpoint while running")
    parser.add_argument("--seeds", type=int, default=0, help="only compare Sobol points with random ones over seeds")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    options = parser.parse_args()
    if options.seeds:
        return sobol_gain(options.seeds)
    units, chunk = int(options.units), options.chunk
    response, tolerances, required = question()
    ns = race(response, tolerances, required, chunk, options.method)

    curve, memory, began = [], Memory(), time.perf_counter()
    # The run is watched through its progress: every tenth of it gives a point of the curve.
    found = watched_run(response, tolerances, required, units, options, curve, memory, began)
    seconds = time.perf_counter() - began
    memory.stop()
    print(f"{'units':>12s} {'seconds':>9s} {'memory MB':>10s}")
    for done, elapsed, largest in curve:
        print(f"{done:12,d} {elapsed:9.1f} {largest:10.1f}")
    first, last = curve[0][2], max(point[2] for point in curve[1:])
    mean = found.mean[OUTPUT]
    publish(
        "monte_carlo",
        {
            "units": units,
            "chunk": chunk,
            "random_numbers_per_unit": Population.of(tolerances).numbers,
            "seconds": seconds,
            "ns_per_unit_of_the_run": 1e9 * seconds / units,
            **{f"ns_per_unit_{name}": value for name, value in ns.items()},
            "monte_carlo_over_kernel": ns["monte_carlo"] / ns["kernel"],
            "monte_carlo_over_response_alone": ns["monte_carlo"] / ns["response_alone"],
            "memory_growth_MB_after_the_first_tenth": last - first,
            "mean_arcmin": mean.value / arcmin,
            "mean_standard_error_arcmin": mean.error / arcmin,
            "rejects_ppm": found.ppm[OUTPUT].value,
            "rejects_ppm_lower": found.ppm[OUTPUT].lower,
            "rejects_ppm_upper": found.ppm[OUTPUT].upper,
            "failed": found.failed,
        },
        options.json,
    )


def watched_run(response, tolerances, required, units, options, curve, memory, began):
    """The long run, with a point of the memory curve at every tenth."""
    from rvjax.tolerances.batch import statistics

    add, tenth = statistics.Accumulator.add, max(units // 10, options.chunk)

    def watching(self, number, start, values, status, **own):
        add(self, number, start, values, status, **own)
        done = start + len(status)
        if done // tenth > len(curve) or done == units:
            curve.append((done, time.perf_counter() - began, memory.part()))

    statistics.Accumulator.add = watching
    try:
        return monte_carlo(
            response,
            tolerances,
            samples=units,
            seed=0,
            chunk=options.chunk,
            method=options.method,
            requirements=required,
            checkpoint=options.checkpoint,
        )
    finally:
        statistics.Accumulator.add = add


if __name__ == "__main__":
    main()
