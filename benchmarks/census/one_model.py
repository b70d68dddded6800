"""Census of one model: random inputs sampled, run and checked, a chunk at a time so that memory stays flat."""

import json
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.census.cases import Case, Model, spoiled
from benchmarks.census.derivatives import derivatives, evaluate, flat, poisoned
from rvjax.status import Status

KEPT = (
    Status.CONVERGED,
    Status.UNLOADED,
    Status.CHANGE_POINT,
    Status.SINGULAR,
    Status.UNSTABLE,
    Status.PRESSURE_ANGLE,
)
GOOD = (Status.CONVERGED, Status.UNLOADED)


class Sizes(NamedTuple):
    """Inputs of a chunk, those of them that run in single precision too, and those whose derivatives are compared."""

    chunk: int = 8_192
    single: int = 1_024
    sample: int = 2_000


FULL = Sizes()


class Worst:
    """The input with the largest figure."""

    def __init__(self) -> None:
        self.size, self.case, self.status = 0.0, None, ""

    def take(self, figure: np.ndarray, case: Case, status: np.ndarray) -> None:
        figure = np.where(np.isnan(figure), np.inf, figure)
        lane = int(np.argmax(figure))
        if figure[lane] > self.size:
            self.size, self.case = float(figure[lane]), {name: value[lane].tolist() for name, value in case.items()}
            self.status = Status(int(status[lane])).name

    def record(self) -> dict[str, Any]:
        return {"figure": self.size, "status": self.status, "input": self.case}


def census(
    model: Model, inputs: int, seed: int, until: float, progress: Callable[[int], None], sizes: Sizes = FULL
) -> dict[str, Any]:
    """Figures of `inputs` random inputs, or of fewer if the clock passes `until`."""
    rng = np.random.default_rng([seed, *model.name.encode()])
    run = jax.jit(jax.vmap(model.run))
    counts: dict[str, int] = {}
    counted = dict.fromkeys(("silent", "finite where NaN is due", "wrong status", "judged", "float32 silent"), 0)
    worst = {name: Worst() for name in ("residual", "value", "float32", "silent", "wrong status", "derivative")}
    begin, start = 0, time.perf_counter()
    while begin < inputs and (begin == 0 or time.perf_counter() < until):
        size = min(sizes.chunk, inputs - begin)
        case = spoiled(model.draw(rng, sizes.chunk), rng)
        whole = jax.tree.map(np.asarray, run(case))
        case, out = first(case, size), first(whole, size)
        status, values = out["status"], flat((out["values"], out.get("windup", ())))
        for number, many in zip(*np.unique(status, return_counts=True)):
            counts[Status(int(number)).name] = counts.get(Status(int(number)).name, 0) + int(many)
        kept = np.isin(status, KEPT)
        silent, leaked = kept & ~np.isfinite(values).all(1), ~kept & ~np.isnan(values).any(1)
        counted["silent"] += int(silent.sum())
        counted["finite where NaN is due"] += int(leaked.sum())
        worst["silent"].take((silent | leaked).astype(float), case, status)
        good = np.isin(status, GOOD)
        residual = np.abs(out["residual"]) / out.get("residual_scale", 1)
        worst["residual"].take(np.where(good & model.sound(case), residual, 0), case, status)

        seen = max(1, int(size * model.judged))
        some, shown = first(case, seen), first(out, seen)
        due, error = model.judge(dict(some), shown)
        wrong = (due >= 0) & (due != status[:seen])
        counted["judged"] += seen
        counted["wrong status"] += int(wrong.sum())
        worst["wrong status"].take(wrong.astype(float), some, status)
        worst["value"].take(np.where(good[:seen], error, 0), some, status)

        if begin // sizes.chunk % 4 == 0:
            silent, gap, few = in_single(model, run, case, sizes)
            counted["float32 silent"] += silent
            worst["float32"].take(gap, few, status)
        begin += size
        progress(size)
    lanes = model.draw(rng, sizes.sample)
    off, compared = derivatives(model, run, lanes, rng, sizes.chunk)
    worst["derivative"].take(off, lanes, np.zeros(sizes.sample, int))
    return {
        "group": model.group,
        "model": model.name,
        "inputs": begin,
        "seconds": round(time.perf_counter() - start, 1),
        "statuses": dict(sorted(counts.items(), key=lambda item: -item[1])),
        **counted,
        "derivatives": int(compared.sum()),
        "derivatives above 1e-6": int((off > 1e-6).sum()),
        "poisoned gradients": poisoned(model, spoiled(model.draw(rng, sizes.sample), rng, 1.0)),
        "worst": {name: item.record() for name, item in worst.items() if item.size > 0},
    }


def in_single(model: Model, run: Any, case: Case, sizes: Sizes) -> tuple[int, np.ndarray, Case]:
    """Silent failures of single precision, its gap to double precision on the same numbers, and these numbers."""
    few = {k: v[: sizes.single].astype(np.float32) for k, v in case.items()}
    single = jax.tree.map(np.asarray, run(few))
    wide = {k: v.astype(np.float64) for k, v in few.items()}
    status, scale, values = evaluate(run, [wide], sizes.chunk)[0]
    silent = np.isin(single["status"], KEPT) & ~np.isfinite(flat(single["values"])).all(1)
    both = np.isin(status, GOOD) & np.isin(single["status"], GOOD) & model.ordinary(wide)
    gap = np.abs(flat(single["values"]).astype(float) - values).max(1) / scale
    return int(silent.sum()), np.where(both, gap, 0), wide


def first(tree: Any, count: int) -> Any:
    return jax.tree.map(lambda leaf: leaf[:count], tree)


def show(found: dict[str, Any]) -> None:
    """Print the figures of one model."""
    statuses = ", ".join(f"{name} {count:,}" for name, count in found["statuses"].items())
    print(f"\n{found['model']}: {found['inputs']:,} inputs, {found['seconds']} s\n  {statuses}")
    rest = {k: v for k, v in found.items() if k not in ("group", "model", "inputs", "seconds", "statuses", "worst")}
    print("  " + ", ".join(f"{k} {v}" for k, v in rest.items()))
    for name, item in found["worst"].items():
        print(f"  worst {name}: {item['figure']:.3g} {item['status']} {json.dumps(item['input'])[:600]}", flush=True)
