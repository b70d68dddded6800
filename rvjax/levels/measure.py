"""Error and cost of every level of a subject, side by side in one run."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.levels.choice import design_numbers, reach
from rvjax.levels.estimators import measure_statistics
from rvjax.levels.subjects import SPREAD, Subject, Way, subjects
from rvjax.levels.table import Level, Model, Table
from rvjax.levels.timing import alternate, compiled, machine
from rvjax.status import succeeded

Program = Callable[..., Any]


def measure(*, quick: bool = False, seed: int = 0, say: Callable[[str], None] = lambda _: None) -> Table:
    """The table of all models on this machine.

    Args:
        quick: fewer levels and cases.
        seed: of the cases.
        say: told what is measured next.
    """
    models = {}
    for subject in subjects(quick=quick):
        say(subject.name)
        models[subject.name] = measure_model(subject, seed=seed, seconds=0.1 if quick else 0.3)
    say("statistics")
    models["statistics"] = measure_statistics(quick=quick, seed=seed)
    return Table({**machine(), "load": _load()}, seed, models)


def measure_model(subject: Subject, *, seed: int, seconds: float = 0.3) -> Model:
    """Every level of one model against its reference.

    Args:
        subject: what to measure.
        seed: of the cases.
        seconds: of timing for each level.
    """
    plan = [(way, precision) for way in subject.ways for precision in way.precisions]
    first = subject.draw(0, 1.0, seed)
    inputs = {precision: _cast(first, precision) for precision in ("float64", "float32")}
    with ThreadPoolExecutor(2) as pool:  # the compiler leaves the interpreter alone
        made = list(pool.map(lambda item: compiled(_batch(subject, item[0]), *inputs[item[1]]), plan))
    names = [f"{way.name}, {precision}" for way, precision in plan]
    reference = names.index(f"{subject.ways[-1].name}, float64")
    errors, typical, failed = _errors(subject, [program for program, _ in made], [p for _, p in plan], reference, seed)
    runs = {
        name: (lambda program=program, given=inputs[precision]: program(*given))
        for name, (program, _), (_, precision) in zip(names, made, plan)
    }
    best = alternate(runs, seconds=seconds, rounds=3)
    levels = tuple(
        Level(
            name=name,
            settings=way.settings,
            precision=precision,
            largest={o: list(errors[o][0][k]) for o in subject.outputs},
            rms={o: list(errors[o][1][k]) for o in subject.outputs},
            ns=1e9 * best[name] / subject.batch,
            compile_s=facts["compile_s"],
            memory_MB=facts["temporary_MB"],
            cases=subject.batch,
        )
        for k, (name, (_, facts), (way, precision)) in enumerate(zip(names, made, plan))
    )
    return Model(
        name=subject.name,
        outputs=subject.outputs,
        case=subject.case,
        design=_read(subject, made[0][0], inputs[plan[0][1]]),
        spread=SPREAD,
        errors={} if subject.tolerances is None else reach(subject.tolerances),
        sizes=list(subject.sizes),
        torque=subject.torque,
        conditions=subject.conditions,
        typical=typical,
        failed=failed,
        reference=names[reference],
        levels=levels,
    )


def _load() -> list[float]:
    return list(os.getloadavg()) if hasattr(os, "getloadavg") else []


def _cast(tree: Any, precision: str) -> Any:
    return jax.tree.map(lambda x: jnp.asarray(x, precision), tree)


def _read(subject: Subject, program: Program, case: Any) -> dict[str, float]:
    """Numbers of the design that matter: those whose change changes an output, and all counts."""
    design, *rest = case
    before = jax.device_get(program(*case)[0])
    leaves, tree = jax.tree_util.tree_flatten_with_path(design)
    unread = set()
    for k, (path, leaf) in enumerate(leaves):
        changed = [x for _, x in leaves]
        changed[k] = leaf * 1.01 + jnp.where(leaf == 0, jnp.asarray(1e-5, leaf.dtype), 0)
        after = jax.device_get(program(jax.tree.unflatten(tree, changed), *rest)[0])
        if all(np.array_equal(before[o], after[o], equal_nan=True) for o in before):
            unread.add(".".join(key.name for key in path))
    return {name: value for name, value in design_numbers(subject.design).items() if name not in unread}


def _batch(subject: Subject, way: Way) -> Program:
    return jax.vmap(lambda *case: subject.evaluate(way.settings, *case))


def _errors(
    subject: Subject, programs: Sequence[Program], precisions: Sequence[str], reference: int, seed: int
) -> tuple[dict[str, Any], dict[str, list[float]], tuple[int, int]]:
    """{output: (largest, rms), each (levels, sizes)}, rms of the reference, cases without reference."""
    shape = (len(programs), len(subject.sizes))
    largest = {o: np.zeros(shape) for o in subject.outputs}
    squares = {o: np.zeros(shape) for o in subject.outputs}
    typical, counted = {o: np.zeros(shape[1]) for o in subject.outputs}, np.zeros(shape[1])
    for s, size in enumerate(subject.sizes):
        for call in range(subject.calls):
            case = subject.draw(call, size, seed)
            given = {precision: _cast(case, precision) for precision in set(precisions)}
            values, status = jax.device_get(programs[reference](*given["float64"]))
            good = np.asarray(succeeded(status))
            counted[s] += good.sum()
            for o in subject.outputs:
                typical[o][s] += np.sum(np.mean(values[o][good].reshape(good.sum(), -1) ** 2, axis=1))
            for k, program in enumerate(programs):
                found, own = jax.device_get(program(*given[precisions[k]]))
                fine = np.asarray(succeeded(own))[good]
                for o in subject.outputs:
                    off = np.abs(found[o].astype(float) - values[o])[good].reshape(good.sum(), -1)
                    off[~fine] = np.inf  # no value where the reference has one
                    largest[o][k, s] = max(largest[o][k, s], off.max(initial=0.0))
                    squares[o][k, s] += np.sum(np.mean(off**2, axis=1))
    errors = {o: (largest[o].tolist(), np.sqrt(squares[o] / counted).tolist()) for o in subject.outputs}
    total = subject.calls * subject.batch * shape[1]
    rms = {o: np.sqrt(typical[o] / counted).tolist() for o in subject.outputs}
    return errors, rms, (int(total - counted.sum()), total)
