"""Census of the extremes: random inputs over the domain of every model and beyond it, each judged.

    python benchmarks/extremes.py [--model four_bar ...] [--inputs 100000] [--seed 0] [--climb 40] [--json FILE]

For each model and each set of static options: lanes per status; lanes whose value is not finite under a status
that promises one, or finite under a status that promises NaN; lanes whose status or value an independent
computation contradicts; the largest residual; derivatives against central differences; float32 against float64.
The worst inputs are printed so that they can be run again; `--climb` searches from them for worse ones.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import extremes_models
import timing
from extremes_models import Model
from rvjax.status import Status

KEPT = (
    Status.CONVERGED,
    Status.UNLOADED,
    Status.CHANGE_POINT,
    Status.SINGULAR,
    Status.UNSTABLE,
    Status.PRESSURE_ANGLE,
)
CHUNK = 20_000
SHOWN = 300  # characters of an input; the file holds all
SAMPLE = 2_000  # lanes whose derivatives are compared


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", nargs="*", help="names that begin so; all by default")
    parser.add_argument("--inputs", type=int, default=100_000, help="per model, shared by its variants")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--climb", type=int, default=0, help="steps of the search for worse inputs")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    timing.settings()
    np.seterr(all="ignore")
    found = []
    wanted = [m for m in extremes_models.models() if not options.model or m.name.startswith(tuple(options.model))]
    families = {m.name.split()[0] for m in wanted}
    for family in sorted(families):
        members = [m for m in wanted if m.name.split()[0] == family]
        for number, model in enumerate(members):
            found.append(
                census(model, max(1, options.inputs // len(members)), options.seed + 1000 * number, options.climb)
            )
            show(found[-1])
    if options.json:
        options.json.write_text(json.dumps({"seed": options.seed, "census": found}, indent=1))


def census(model: Model, inputs: int, seed: int, climb: int) -> dict[str, Any]:
    """Draw, run, judge."""
    rng = np.random.default_rng(seed)
    run = jax.jit(jax.vmap(model.run))
    start, total = time.perf_counter(), {}
    counts: dict[str, int] = {}
    silent = leaked = wrong_status = differ = 0
    worst = {
        name: Worst()
        for name in ("residual", "value", "float32", "derivative", "silent", "silent float32", "status", "poisoned")
    }
    for begin in range(0, inputs, CHUNK):
        size = min(CHUNK, inputs - begin)
        case = extremes_models.spoiled(model.draw(rng, size), rng)
        padded = {k: np.concatenate([v, v[:1].repeat(min(CHUNK, inputs) - size, 0)]) for k, v in case.items()}
        out = cut(run(padded), size)
        status, values = out["status"], flat(out["values"])
        finite, kept = np.isfinite(values), np.isin(status, KEPT)
        for number, many in zip(*np.unique(status, return_counts=True)):
            counts[Status(int(number)).name] = counts.get(Status(int(number)).name, 0) + int(many)
        bad = np.where(kept, ~finite.all(1), (~np.isnan(values)).any(1) if model.nan_when_failed else False)
        silent, leaked = silent + int((bad & kept).sum()), leaked + int((bad & ~kept).sum())
        worst["silent"].take(bad.astype(float), case, status)
        good = np.isin(status, (Status.CONVERGED, Status.UNLOADED))
        worst["residual"].take(
            np.where(good & extremes_models.moderate(case), np.abs(out["residual"]), 0), case, status
        )
        expected, error = model.judge(case, out)
        contradicted = (expected >= 0) & (expected != status)
        wrong_status += int(contradicted.sum())
        worst["status"].take(contradicted.astype(float), case, status)
        worst["value"].take(np.where(good, error, 0), case, status)

        few = {k: v.astype(np.float32) for k, v in padded.items()}
        single = cut(run(few), size)
        double = cut(run({k: v.astype(np.float64) for k, v in few.items()}), size)
        both = np.isin(double["status"], (0,)) & np.isin(single["status"], (0,))
        fits = np.isfinite(flat(single["values"])).all(1)
        same = single["status"] == double["status"]
        differ += int((~same).sum())
        single_kept = np.isin(single["status"], KEPT)
        silent32 = single_kept & ~fits
        total["silent_float32"] = total.get("silent_float32", 0) + int(silent32.sum())
        if silent32.any():
            worst["silent float32"].take(silent32.astype(float), case, status)
        gap = np.abs(flat(single["values"]).astype(float) - flat(double["values"])).max(1) / double["scale"]
        gap = np.where(both & model.ordinary(case), gap, 0)
        worst["float32"].take(gap, case, status)
        total.setdefault("float32_quantiles", []).append(
            np.quantile(gap[gap > 0], [0.5, 0.99]) if gap.any() else [0, 0]
        )
    lanes = model.draw(rng, SAMPLE)
    off, status = derivatives(model, lanes, rng)
    worst["derivative"].take(off, lanes, status)
    total["derivative_above_1e-6"] = int((off > 1e-6).sum())
    total["poisoned_gradients"] = poisoned(model, extremes_models.spoiled(model.draw(rng, SAMPLE), rng, 1.0), worst)
    result = {
        "model": model.name,
        "inputs": inputs,
        "seconds": round(time.perf_counter() - start, 1),
        "statuses": counts,
        "silent": silent,
        "finite_where_NaN_is_due": leaked,
        "wrong_status": wrong_status,
        "status_differs_in_float32": differ,
        **{k: (np.mean(v, axis=0).tolist() if k.endswith("quantiles") else v) for k, v in total.items()},
        "derivative_sample": int(np.isin(status, (0,)).sum()),
        "worst": {name: item.record() for name, item in worst.items() if item.size > 0},
    }
    if climb:
        result["climbed"] = search(model, run, worst, rng, climb)
    return result


class Worst:
    """The input with the largest figure."""

    def __init__(self) -> None:
        self.size, self.case, self.status = 0.0, None, ""

    def take(self, figure: np.ndarray, case: dict[str, np.ndarray], status: np.ndarray) -> None:
        figure = np.where(np.isnan(figure), np.inf, figure)
        lane = int(np.argmax(figure))
        if figure[lane] > self.size:
            self.size, self.case = float(figure[lane]), replay(case, lane)
            self.status = Status(int(status[lane])).name

    def record(self) -> dict[str, Any]:
        return {"figure": self.size, "status": self.status, "input": self.case}


def replay(case: dict[str, np.ndarray], lane: int) -> dict[str, Any]:
    """One input as plain numbers."""
    return {name: value[lane].tolist() for name, value in case.items()}


def flat(values: Any) -> np.ndarray:
    """Values of every lane in one row."""
    parts = []
    for leaf in jax.tree.leaves(values):
        leaf = np.asarray(leaf)
        leaf = leaf.reshape(len(leaf), -1)
        parts += [leaf.real, leaf.imag] if np.iscomplexobj(leaf) else [leaf]
    return np.concatenate(parts, axis=1)


def cut(out: Any, size: int) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:size], out)


def derivatives(model: Model, lanes: dict[str, np.ndarray], rng: Any) -> tuple[np.ndarray, np.ndarray]:
    """|forward derivative along a random direction - differences| over their size, 0 for lanes that failed.

    Central and one-sided differences of several widths, each extrapolated twice (Richardson): the nearest counts,
    for at a kink the derivative is that of one side.
    """
    direction = {
        k: model.step(k, v) * rng.choice([-1.0, 1.0], v.shape) * rng.uniform(0.3, 1, v.shape) for k, v in lanes.items()
    }

    def along(case: Any, change: Any) -> Any:
        def run(case: Any) -> Any:
            out = model.run(case)
            return jax.tree.map(lambda x: (jnp.real(x), jnp.imag(x)) if jnp.iscomplexobj(x) else x, out["values"]), out

        values, slope, out = jax.jvp(run, (case,), (change,), has_aux=True)
        return values, slope, out["status"], out["scale"]

    _, slope, status, scale = jax.jit(jax.vmap(along))(lanes, direction)
    slope, status, scale = flat(slope), np.asarray(status), np.asarray(scale)
    run = jax.jit(jax.vmap(lambda case: model.run(case)["values"]))
    at = lambda t: flat(run({k: v + t * direction[k] for k, v in lanes.items()}))  # noqa: E731
    base, best = at(0.0), np.full(status.shape, np.inf)
    for width in (1e-1, 1e-2, 1e-3, 1e-4):
        value = {t: at(t * width) for t in (-1, -0.5, -0.25, 0.25, 0.5, 1)}
        first = [(value[t] - value[-t]) / (2 * t * width) for t in (1, 0.5, 0.25)]
        central = (64 * first[2] - 20 * first[1] + first[0]) / 45
        sides = []
        for sign in (1, -1):
            first = [(value[sign * t] - base) / (sign * t * width) for t in (1, 0.5, 0.25)]
            sides.append((32 * first[2] - 12 * first[1] + first[0]) / 21)
        for difference in (central, *sides):
            size = np.maximum(np.abs(difference).max(1), np.abs(slope).max(1))
            off = np.abs(difference - slope).max(1) / np.maximum(size, 1e-9 * scale)
            best = np.fmin(best, np.where(np.isnan(off), np.inf, off))
    usable = np.isin(status, (0,)) & model.ordinary(lanes) & np.isfinite(base).all(1)
    best = np.where(usable & np.isfinite(slope).all(1), np.where(np.isinf(best), 0, best), best)
    failed = ~usable
    return np.where(failed, np.where(np.isfinite(slope).all(1) | np.isnan(base).any(1), 0, np.inf), best), status


def poisoned(model: Model, lanes: dict[str, np.ndarray], worst: dict[str, Worst]) -> int:
    """Failed lanes whose gradient, backwards through all finite values, is not finite."""

    def total(case: Any) -> Any:
        out = model.run(case)
        parts = [jnp.abs(leaf) if jnp.iscomplexobj(leaf) else leaf for leaf in jax.tree.leaves(out["values"])]
        return sum(jnp.sum(jnp.where(jnp.isfinite(part), part, 0)) for part in parts), out["status"]

    slope, status = jax.jit(jax.vmap(jax.grad(total, has_aux=True)))(lanes)
    status = np.asarray(status)
    bad = ~np.isin(status, KEPT) & ~np.isfinite(flat(slope)).all(1)
    worst["poisoned"].take(bad.astype(float), lanes, status)
    return int(bad.sum())


def search(model: Model, run: Any, worst: dict[str, Worst], rng: Any, steps: int) -> dict[str, Any]:
    """Random local search from the worst float32 and value lanes: where the model's own errors grow."""
    found = {}
    for name in ("float32", "value", "residual"):
        if worst[name].case is None:
            continue
        here = {k: np.asarray(v, float) for k, v in worst[name].case.items()}
        best, width, many = worst[name].size, 0.3, 512
        for _ in range(steps):
            near = {
                k: v + width * model.step(k, v[None]) * rng.standard_normal((many, *v.shape)) for k, v in here.items()
            }
            out = cut(run(near), many)
            if name == "float32":
                few = {k: v.astype(np.float32) for k, v in near.items()}
                single = cut(run(few), many)
                double = cut(run({k: v.astype(float) for k, v in few.items()}), many)
                figure = np.abs(flat(single["values"]).astype(float) - flat(double["values"])).max(1) / double["scale"]
                figure = np.where((single["status"] == 0) & (double["status"] == 0) & model.ordinary(near), figure, 0)
            elif name == "value":
                figure = np.where(out["status"] == 0, model.judge(near, out)[1], 0)
            else:
                figure = np.where(out["status"] == 0, np.abs(out["residual"]), 0)
            lane = int(np.argmax(np.nan_to_num(figure)))
            if figure[lane] > best:
                best, here = float(figure[lane]), {k: v[lane] for k, v in near.items()}
            else:
                width *= 0.7
        found[name] = {"figure": best, "input": {k: v.tolist() for k, v in here.items()}}
    return found


def show(found: dict[str, Any]) -> None:
    statuses = ", ".join(f"{name} {count:,}" for name, count in sorted(found["statuses"].items(), key=lambda x: -x[1]))
    print(f"\n{found['model']}: {found['inputs']:,} inputs, {found['seconds']} s\n  {statuses}")
    rest = {k: v for k, v in found.items() if k not in ("model", "inputs", "seconds", "statuses", "worst", "climbed")}
    print("  " + ", ".join(f"{k} {v}" for k, v in rest.items()))
    for name, item in found["worst"].items():
        print(f"  worst {name}: {item['figure']:.3g} {item['status']} {json.dumps(item['input'])[:700]}")
    for name, item in found.get("climbed", {}).items():
        print(f"  climbed {name}: {item['figure']:.3g} {json.dumps(item['input'])[:500]}", flush=True)


if __name__ == "__main__":
    main()
