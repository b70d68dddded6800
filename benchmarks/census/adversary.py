"""Search for inputs on which the models err most: evolution on their own errors, within the domain.

    python -m benchmarks.census.adversary                                   all models, a few minutes each
    python -m benchmarks.census.adversary --model "mesh_force hertz" --figure float32 --generations 200

From random inputs the best are kept and changed again, by steps that shrink where nothing better comes. Climbed are,
one after the other: float32 against float64, the residual, the error that an independent computation sees, the
derivative against differences. The worst corners are written out so that they can be run again; one above its bound
becomes a test.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import settings

POPULATION = 1024
PARENTS = 32
FIGURES = ("float32", "residual", "value", "derivative")
ANGLES = ("crank_angle", "angle", "tilt", "alpha", "force_angle", "frame_angle", "crank_phase")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", nargs="*", help="names that begin so; all by default")
    parser.add_argument("--figure", nargs="*", choices=FIGURES, default=FIGURES)
    parser.add_argument("--generations", type=int, default=40)
    parser.add_argument("--starts", type=int, default=2, help="searches of every kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    settings()
    np.seterr(all="ignore")
    import jax

    from benchmarks.census.models import models

    found = []
    for model in models():
        if options.model and not model.name.startswith(tuple(options.model)):
            continue
        run = jax.jit(jax.vmap(model.run))
        for name in options.figure:
            rng = np.random.default_rng([options.seed, *model.name.encode()])
            best, case = max((climb(model, run, name, rng, options.generations) for _ in range(options.starts)),
                             key=lambda pair: pair[0])  # fmt: skip
            found.append({"model": model.name, "figure": name, "size": best, "input": case})
            print(f"{model.name}: {name} {best:.3g} {json.dumps(case)[:400]}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def climb(model: Any, run: Any, name: str, rng: Any, generations: int) -> tuple[float, dict[str, Any]]:
    """Largest figure that evolution finds, and its input."""
    case = model.draw(rng, POPULATION)
    figure = measure(model, run, name, case, rng)
    width, best = 0.3, -1.0
    for _ in range(generations if name != "derivative" else max(1, generations // 8)):
        order = np.argsort(-figure)[:PARENTS]
        if figure[order[0]] > best:
            best = float(figure[order[0]])
        else:
            width *= 0.8
        parents = rng.choice(order, POPULATION)
        parents[:PARENTS] = order
        children = {}
        for key, value in case.items():
            taken = value[parents]
            noise = width * rng.standard_normal(taken.shape) * (rng.uniform(size=taken.shape) < 0.5)
            noise[:PARENTS] = 0
            children[key] = taken + noise if key in ANGLES else taken * np.exp(noise)
        case = children
        figure = measure(model, run, name, case, rng)
    lane = int(np.argmax(figure))
    return float(figure[lane]), {key: value[lane].tolist() for key, value in case.items()}


def measure(model: Any, run: Any, name: str, case: dict[str, Any], rng: Any) -> np.ndarray:
    """The figure to climb, 0 outside the domain and where a status explains it."""
    from benchmarks.census.derivatives import derivatives, evaluate, flat
    from benchmarks.census.one_model import GOOD

    if name == "derivative":
        return np.nan_to_num(derivatives(model, run, case, rng, POPULATION)[0], posinf=1e30)
    out = {k: v for k, v in run(case).items()}
    status = np.asarray(out["status"])
    inside = np.isin(status, GOOD) & model.ordinary(case)
    if name == "residual":
        size = np.abs(np.asarray(out["residual"]))
    elif name == "value":
        size = model.judge(dict(case), {k: _numpy(v) for k, v in out.items()})[1]
    else:
        few = {k: v.astype(np.float32) for k, v in case.items()}
        status, scale, wide = evaluate(run, [{k: v.astype(float) for k, v in few.items()}], POPULATION)[0]
        single = run(few)
        inside &= np.isin(status, GOOD) & np.isin(np.asarray(single["status"]), GOOD)
        size = np.abs(flat(single["values"]) - wide).max(1) / scale
    return np.nan_to_num(np.where(inside, size, 0), posinf=1e30)


def _numpy(tree: Any) -> Any:
    import jax

    return jax.tree.map(np.asarray, tree)


if __name__ == "__main__":
    main()
