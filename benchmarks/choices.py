"""Does the level that `scene.choose` takes keep the accuracy it promises? Held-out random scenes.

A scene is a random output, design (within the measured spread), torque, size of every tolerance by itself, and
accuracy over five decades. Its units are new samples; the truth is computed with twice the angles of the exact level
in float64. Programs are compiled once for each level; designs and torques are arguments. The whole reducer is excluded,
because a unit takes milliseconds: `tests/test_levels_loaded.py` has scenes of its own in the long profile.
"""

import argparse
import collections
import dataclasses
from functools import partial
from pathlib import Path

from benchmarks.timing import publish, settings

settings()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from rvjax import levels, models  # noqa: E402
from rvjax.levels.measure import evaluate, limits  # noqa: E402
from rvjax.levels.table import stored  # noqa: E402
from rvjax.status import succeeded  # noqa: E402
from rvjax.tolerances import sample  # noqa: E402

UNITS, BLOCK = 32, 512  # units of a scene; at once


def draw(subject, rng, number):
    """Design, tolerances, conditions, output and accuracy of one response."""
    model = stored().models[subject.name]
    spread = model.spread
    design = jax.tree.map(lambda x: float(x * (1 + rng.uniform(-spread, spread))), subject.design)
    low, high = model.sizes[0], model.sizes[-1]
    top = np.exp(rng.uniform(np.log(low), np.log(high)))
    fields, given = {}, limits(subject.errors, subject.design)
    for name, tolerance in vars(given).items():
        if tolerance is not None:
            factor = top * rng.uniform(0.1, 1) if rng.random() < 0.5 else top
            fields[name] = tolerance.replace(lower=tolerance.lower * factor, upper=tolerance.upper * factor)
    tolerances = given.replace(**fields)
    torque = float(rng.uniform(*subject.torque)) if subject.torque else 0.0
    fields_ = dataclasses.fields(models.kind(design).conditions)
    name = next(f.name for f in fields_ if f.metadata["torque"])
    conditions = models.kind(design).conditions(**{name: torque}, **subject.conditions)
    output = list(subject.outputs)[rng.integers(len(subject.outputs))]
    accuracy = model.typical[output][model.sizes.index(1.0)] * 10 ** rng.uniform(-5.5, 0)
    return design, tolerances, conditions, output, accuracy, torque


@partial(jax.jit, static_argnames=("evaluate", "settings", "precision"))
def values(design, errors, torque, *, evaluate, settings, precision):
    """Outputs and status of a block of units, each with a design and a torque of its own."""
    case = jax.tree.map(lambda x: x.astype(precision), (design, errors, torque))
    return jax.vmap(lambda *c: evaluate(dict(settings), *c))(*case)


def finer(settings):
    """The exact level with twice the angles."""
    return tuple((key, 2 * value if key == "angles" else value) for key, value in settings.items())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--scenes", type=int, default=2400)
    parser.add_argument("--seed", type=int, default=12345)
    parser.add_argument("--only", help="models whose name begins so")
    options = parser.parse_args()
    known = [s for s in levels.measured() if s.errors is not None and not s.name.startswith("loaded")]
    known = [s for s in known if s.name in stored().models]
    asked = [s for s in known if s.name.startswith(options.only or "")]
    figures, broken, exact, worst, total, saved = {}, 0, 0, 0.0, 0, []
    unit = jax.jit(jax.vmap(lambda tolerances, index: sample(tolerances, index, seed=99), in_axes=(None, 0)))
    for subject in asked:
        rng = np.random.default_rng([options.seed, len(subject.name)])
        model, by_level, scenes = stored().models[subject.name], collections.defaultdict(list), []
        for number in range(options.scenes // len(asked)):
            design, tolerances, conditions, output, accuracy, torque = draw(subject, rng, number)
            choice = levels.choose(design, (output,), conditions, tolerances=tolerances, accuracy={output: accuracy})[
                output
            ]
            errors = unit(tolerances, jnp.arange(number * UNITS, (number + 1) * UNITS))
            wide = jax.tree.map(lambda x: np.broadcast_to(x, (UNITS, *np.shape(x)[1:])), (errors))
            design, torque = jax.tree.map(lambda x: np.full(UNITS, x), (design, torque))
            by_level[choice.settings, choice.precision].append(len(scenes))
            scenes.append((design, wide, torque, output, accuracy, choice))
        subject_worst = 0.0
        for (settings_, precision), chosen in by_level.items():
            if scenes[chosen[0]][5].bound is None:
                exact += len(chosen)
                total += len(chosen)
                saved += [1.0] * len(chosen)
                continue
            for first in range(0, len(chosen), BLOCK // UNITS):
                part = chosen[first : first + BLOCK // UNITS]
                padded = (part * (BLOCK // UNITS))[: BLOCK // UNITS] if len(part) < BLOCK // UNITS else part
                block = jax.tree.map(lambda *x: np.concatenate(x), *[scenes[k][:3] for k in padded])
                run = partial(values, *block, evaluate=partial(evaluate, subject))
                true, status = run(settings=finer(dict(model.level(model.reference).settings)), precision="float64")
                found, own = run(settings=settings_, precision=precision)
                good = np.asarray(succeeded(status)).reshape(-1, UNITS)
                fine = np.asarray(succeeded(own)).reshape(-1, UNITS)
                for row, k in enumerate(part):
                    output, accuracy, choice = scenes[k][3:]
                    off = np.abs(np.asarray(found[output], float) - np.asarray(true[output])).reshape(-1, UNITS)[row]
                    off = np.where(good[row], np.where(fine[row], off, np.inf), 0)
                    ratio = off.max() / accuracy
                    broken += ratio > 1
                    subject_worst = max(subject_worst, ratio)
                    saved.append(model.level(model.reference).ns / choice.ns)
                    total += 1
        figures[f"{subject.name}, largest error / accuracy"] = float(subject_worst)
        worst = max(worst, subject_worst)
        counts = collections.Counter(s[5].level for s in scenes)
        print(subject.name, dict(counts), f"{subject_worst:.3g}", flush=True)
    figures |= {
        "scenes": total,
        "scenes that take the exact level": exact,
        "scenes whose error is checked": total - exact,
        "scenes beyond their accuracy": int(broken),
        "largest error / accuracy": float(worst),
        "median time of the exact level / time": float(np.median(saved)),
        "units per scene": UNITS,
    }
    publish("choices", figures, options.json)


if __name__ == "__main__":
    main()
