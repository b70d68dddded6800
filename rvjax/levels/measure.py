"""Error and cost of every level that a model describes, side by side in one run.

Times of candidates: they run in turn, the minimum of each counts, and other load slows all alike.
"""

import dataclasses
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax._jax.programs import Options, understood
from rvjax.errors import Errors
from rvjax.levels.choice import design_numbers, reach
from rvjax.levels.table import Level, Model, Table
from rvjax.outputs import Cases, Reading, Way
from rvjax.records import Array, Design, PyTree
from rvjax.status import succeeded, worst
from rvjax.tolerances import Tolerance, for_design, sample


def alternate(
    candidates: Mapping[str, Callable[[], object]],
    *,
    seconds: float = 2.0,
    rounds: int = 25,
) -> dict[str, float]:
    """Minimum seconds of each candidate, run in turn for `rounds` and `seconds` each, or 10 x `seconds` together."""
    for run in candidates.values():
        jax.block_until_ready(run())
    best = dict.fromkeys(candidates, float("inf"))
    spent = dict.fromkeys(candidates, 0.0)
    turn = 0
    while (turn < rounds or min(spent.values()) < seconds) and sum(spent.values()) < 10 * seconds:
        for name, run in candidates.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            elapsed = time.perf_counter() - start
            best[name], spent[name] = min(best[name], elapsed), spent[name] + elapsed
        turn += 1
    return best


def compiled(
    function: Callable[..., object], *arguments: object, options: Options = ()
) -> tuple[jax.stages.Compiled, dict[str, float]]:
    """A function compiled for `arguments` with options of XLA, with compile seconds and temporary memory in MB."""
    start = time.perf_counter()
    program = jax.jit(function, compiler_options=understood(options)).lower(*arguments).compile()
    seconds = time.perf_counter() - start
    memory: Any = program.memory_analysis()
    return program, {"compile_s": round(seconds, 3), "temporary_MB": round(memory.temp_size_in_bytes / 2**20, 2)}


def machine() -> dict[str, str | int | None]:
    """Computer and versions of the measurement."""
    model = ""
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "")
    return {
        "processor": model or platform.processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "backend": jax.default_backend(),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


SPREAD = 0.05  # of every number of the design
Program = Callable[..., PyTree]
Rows = list[list[float]]


def measure(*, quick: bool = False, seed: int = 0, say: Callable[[str], None] = lambda _: None) -> Table:
    """Measure the table of all models on this computer.

    Args:
        quick: fewer levels and cases.
        seed: of the cases.
        say: called with the text of the next measurement.
    """
    models = {}
    for cases in measured(quick=quick):
        say(cases.name)
        models[cases.name] = measure_model(cases, seed=seed, seconds=0.1 if quick else 0.3)
    load = list(os.getloadavg()) if hasattr(os, "getloadavg") else []
    return Table({**machine(), "load": load}, seed, models)


def measured(*, quick: bool = False) -> list[Cases]:
    """The cases that every model describes."""
    return [cases for d in models.descriptions() if d.cases for cases in d.cases(quick)]


def limits(errors: Mapping[str, tuple[float, float] | Mapping[str, PyTree]], design: Design) -> PyTree:
    """Tolerances from the limits of described cases.

    Args:
        errors: (lower, upper), or the arguments of a `Tolerance`, by field.
        design: whose errors they are.
    """
    made = {name: Tolerance(**of) if isinstance(of, Mapping) else Tolerance(*of) for name, of in errors.items()}
    return for_design(design, **made)


def draw(cases: Cases, call: int, size: float, seed: int) -> tuple[PyTree, PyTree, PyTree]:
    """Designs, errors and the rest of a batch of cases, float64, the same at every error size but for the scale."""
    rng = np.random.default_rng([seed, call])

    def around(x: Array) -> Array:
        """Numbers of the batch about one of the design, or about each of an array."""
        return x * (1 + rng.uniform(-SPREAD, SPREAD, (cases.batch, *np.shape(x))))

    design = jax.tree.map(around, cases.design)
    if cases.extra is not None:
        extra = cases.extra(rng, cases.batch, size)
    else:
        extra = rng.uniform(*(cases.torque or (0.0, 0.0)), cases.batch)
    if cases.errors is None:
        return design, None, extra
    units = jnp.arange(call * cases.batch, (call + 1) * cases.batch)
    drawn = limits(cases.errors, cases.design)
    errors = jax.jit(jax.vmap(lambda unit: sample(drawn, unit, seed=seed)))(units)
    return design, jax.tree.map(lambda x: jnp.broadcast_to(size * x, (cases.batch, *jnp.shape(x)[1:])), errors), extra


def evaluate(
    cases: Cases,
    settings: Mapping[str, object],
    design: Design,
    errors: Errors,
    extra: object,
    instead: Mapping[str, str] | None = None,
) -> tuple[dict[str, Array], Array]:
    """Values of all outputs of one case and their worst status, under the conditions of the cases and a level.

    Args:
        cases: to which it belongs.
        settings: conditions that select a level.
        design: of the case.
        errors: of the case.
        extra: its torque, unless the cases say otherwise.
        instead: substitute outputs of other models; an output without a substitute is nan.
    """
    if cases.evaluate is not None:
        return cases.evaluate(settings, design, errors, extra)
    kind = models.kind(cases.design)
    fields = dataclasses.fields(kind.conditions)
    torque = {f.name: extra for f in fields if f.metadata["torque"]} if cases.torque else {}
    given = kind.conditions(**{**cases.question, **cases.conditions, **settings, **torque})
    errors = errors.bounded(cases.bounds) if cases.bounds else errors
    names = instead or {name: name for name in cases.outputs}
    results: dict[Any, Any] = {}  # which outputs may share
    results_of = {}
    for name, source in names.items():
        of = kind.outputs[source].evaluate
        if isinstance(of, Reading):
            results_of[name] = of.within(results, design, errors, given)
        else:
            results_of[name] = of(design, errors, given)
    values = {name: value for name, (value, _) in results_of.items()}
    nothing = jnp.full_like(next(iter(values.values())), jnp.nan)
    return {o: values.get(o, nothing) for o in cases.outputs}, worst(jnp.stack([s for _, s in results_of.values()]))


def measure_model(cases: Cases, *, seed: int, seconds: float = 0.3) -> Model:
    """Errors and times of all levels of one model.

    Args:
        cases: what to measure.
        seed: of the cases.
        seconds: of timing for each level.
    """
    plan = [(way, precision) for way in cases.ways for precision in way.precisions]
    first = draw(cases, 0, 1.0, seed)
    inputs = {precision: _cast(first, precision) for precision in ("float64", "float32")}
    made = [_compiled(cases, way, inputs[precision]) for way, precision in plan]
    names = [f"{way.name}, {precision}" for way, precision in plan]
    reference = names.index(f"{cases.ways[-1].name}, float64")
    errors, typical, failed = _errors(cases, [program for program, _ in made], [p for _, p in plan], reference, seed)
    timed, units = [program for program, _ in made], cases.batch
    if cases.timed:
        units, (_, *drawn) = cases.timed, draw(dataclasses.replace(cases, batch=cases.timed), 0, 1.0, seed)
        inputs = {precision: _cast((cases.design, *drawn), precision) for precision in inputs}
        timed = [_compiled(cases, way, inputs[precision], own_design=False)[0] for way, precision in plan]
    runs = {
        name: (lambda program=program, given=inputs[precision]: program(*given))
        for name, program, (_, precision) in zip(names, timed, plan)
    }
    best = alternate(runs, seconds=seconds, rounds=3)
    levels = tuple(
        Level(
            name=name,
            settings=dict(way.settings),
            precision=precision,
            largest={o: list(errors[o][0][k]) for o in cases.outputs},
            rms={o: list(errors[o][1][k]) for o in cases.outputs},
            ns=1e9 * best[name] / units,
            compile_s=facts["compile_s"],
            memory_MB=facts["temporary_MB"],
            cases=cases.batch,
            instead=dict(way.instead),
            without=way.without,
        )
        for k, (name, (_, facts), (way, precision)) in enumerate(zip(names, made, plan))
    )
    return Model(
        name=cases.name,
        outputs=dict(cases.outputs),
        case=cases.case,
        design=_read(
            cases, [program for (program, _), (_, p) in zip(made, plan) if p == "float64"], _cast(first, "float64")
        ),
        spread=SPREAD,
        errors={} if cases.errors is None else reach(limits(cases.errors, cases.design)),
        sizes=list(cases.sizes),
        torque=cases.torque,
        conditions=dict(cases.conditions),
        typical=typical,
        failed=failed,
        reference=names[reference],
        levels=levels,
        question=dict(cases.question),
        others=cases.others,
        drawn=cases.batch * cases.calls,
    )


def _cast(tree: object, precision: str) -> PyTree:
    return jax.tree.map(lambda x: jnp.asarray(x, precision), tree)


def _read(cases: Cases, programs: Sequence[Program], case: PyTree) -> dict[str, float]:
    """Numbers of the design that matter: those whose change changes an output of some level, and all counts."""
    design, *rest = case
    leaves, tree = jax.tree_util.tree_flatten_with_path(design)
    unread = {".".join(key.name for key in path): k for k, (path, _) in enumerate(leaves)}
    for program in programs:
        before = jax.device_get(program(*case)[0])
        for name, k in list(unread.items()):
            changed = [x for _, x in leaves]
            leaf = changed[k]
            changed[k] = leaf * 1.01 + jnp.where(leaf == 0, jnp.asarray(1e-5, leaf.dtype), 0)
            after = jax.device_get(program(jax.tree.unflatten(tree, changed), *rest)[0])
            if not all(np.array_equal(before[o], after[o], equal_nan=True) for o in before):
                del unread[name]
    return {k: value for k, value in design_numbers(cases.design).items() if k.partition("[")[0] not in unread}


def _compiled(
    cases: Cases, way: Way, given: Sequence[object], own_design: bool = True
) -> tuple[Program, dict[str, float]]:
    """A level for a batch whose cases have a design of their own or one for all, compiled as studies do."""
    outputs = [(way.instead or {}).get(name, name) for name in cases.outputs] if cases.evaluate is None else []
    one = lambda d, e, extra: evaluate(cases, way.settings, d, e, extra, way.instead)  # noqa: E731
    batch = jax.vmap(one, in_axes=(0 if own_design else None, 0, 0))
    return compiled(batch, *given, options=models.kind(cases.design).compiler_options(outputs))


def _errors(
    cases: Cases, programs: Sequence[Program], precisions: Sequence[str], reference: int, seed: int
) -> tuple[dict[str, tuple[Rows, Rows]], dict[str, list[float]], tuple[int, int]]:
    """{output: (largest, rms), each (levels, sizes)}, rms of the reference, cases without reference."""
    shape = (len(programs), len(cases.sizes))
    largest = {o: np.zeros(shape) for o in cases.outputs}
    squares = {o: np.zeros(shape) for o in cases.outputs}
    typical, counted = {o: np.zeros(shape[1]) for o in cases.outputs}, np.zeros(shape[1])
    for s, size in enumerate(cases.sizes):
        for call in range(cases.calls):
            case = draw(cases, call, size, seed)
            given = {precision: _cast(case, precision) for precision in set(precisions)}
            values, status = jax.device_get(programs[reference](*given["float64"]))
            good = succeeded(np.asarray(status))
            counted[s] += good.sum()
            for o in cases.outputs:
                typical[o][s] += np.sum(np.mean(values[o][good].reshape(good.sum(), -1) ** 2, axis=1))
            for k, program in enumerate(programs):
                computed, own = jax.device_get(program(*given[precisions[k]]))
                fine = succeeded(np.asarray(own))[good]
                for o in cases.outputs:
                    off = np.abs(computed[o].astype(float) - values[o])[good].reshape(good.sum(), -1)
                    off[~fine] = np.inf  # no value where the reference has one
                    off[np.isnan(off)] = np.inf
                    largest[o][k, s] = max(largest[o][k, s], off.max(initial=0.0))
                    squares[o][k, s] += np.sum(np.mean(off**2, axis=1))
    errors = {o: (largest[o].tolist(), np.sqrt(squares[o] / counted).tolist()) for o in cases.outputs}
    total = cases.calls * cases.batch * shape[1]
    rms = {o: np.sqrt(typical[o] / counted).tolist() for o in cases.outputs}
    return errors, rms, (int(total - counted.sum()), total)
