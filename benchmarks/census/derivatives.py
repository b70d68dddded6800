"""Derivatives of the census models against differences, one-sided where a model has a kink."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.census.cases import Case, Model
from rvjax.status import Status

WIDTHS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  # of the step of the model


def flat(values: Any) -> np.ndarray:
    """Values of every batch element in one row."""
    parts = []
    for leaf in jax.tree.leaves(values):
        leaf = np.asarray(leaf)
        leaf = leaf.reshape(len(leaf), -1)
        parts += [leaf.real, leaf.imag] if np.iscomplexobj(leaf) else [leaf]
    return np.concatenate(parts, axis=1)


def split(out: dict[str, Any]) -> jax.Array:
    """Values of one case as one real row."""
    parts = [jnp.ravel(x) for x in jax.tree.leaves(out["values"])]
    return jnp.concatenate([jnp.concatenate([x.real, x.imag]) if jnp.iscomplexobj(x) else x for x in parts])


def evaluate(run: Any, cases: list[Case], chunk: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Status, scale and values of batches of equal size, with the one program that was compiled for `chunk` inputs."""
    count = len(next(iter(cases[0].values())))
    together = max(1, chunk // count)
    found = []
    for begin in range(0, len(cases), together):
        part = cases[begin : begin + together]
        joined = {k: np.concatenate([case[k] for case in part]) for k in part[0]}
        out = run({k: np.resize(v, (chunk, *v.shape[1:])) for k, v in joined.items()})
        status, scale, rows = np.asarray(out["status"]), np.asarray(out["scale"]), flat(out["values"])
        found += [tuple(x[i * count : (i + 1) * count] for x in (status, scale, rows)) for i in range(len(part))]
    return found


def derivatives(model: Model, run: Any, lanes: Case, rng: Any, chunk: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the derivative along a random direction from differences, over its size, and where it counts.

    Differences of several widths, each extrapolated twice (Richardson). Where the two sides differ, as at a kink or
    where several angles share the largest value, the derivative must be that of one side or lie between them. What
    differences of two widths disagree by is their rounding; an element off by less than ten times that is not counted.
    """
    change = {
        k: model.step(k, v) * rng.choice([-1.0, 1.0], v.shape) * rng.uniform(0.3, 1, v.shape) for k, v in lanes.items()
    }

    def along(case: Any, change: Any) -> Any:
        return jax.jvp(lambda c: split(model.run(c)), (case,), (change,))[1]

    slope = np.asarray(jax.jit(jax.vmap(along))(lanes, change))
    status, scale, base = evaluate(run, [lanes], chunk)[0]
    size = np.maximum(np.abs(slope).max(1), 1e-9 * scale)[:, None]
    best = np.full(slope.shape, np.inf)
    before, inside, noise, last = None, np.zeros(len(slope), bool), np.full(len(slope), np.inf), np.nan
    for width in WIDTHS:
        places = (-1, -0.5, -0.25, 0.25, 0.5, 1)
        moved = [{k: v + t * width * change[k] for k, v in lanes.items()} for t in places]
        value = {t: row for t, (_, _, row) in zip(places, evaluate(run, moved, chunk))}
        first = [(value[t] - value[-t]) / (2 * t * width) for t in (1, 0.5, 0.25)]
        central = (64 * first[2] - 20 * first[1] + first[0]) / 45
        noise = np.fmin(
            noise, (np.abs(central - last) / np.maximum(size, np.abs(central).max(1, keepdims=True))).max(1)
        )
        last, sides = central, []
        for sign in (1, -1):
            first = [(value[sign * t] - base) / (sign * t * width) for t in (1, 0.5, 0.25)]
            sides.append((32 * first[2] - 12 * first[1] + first[0]) / 21)
        inside |= np.isfinite(central).all(1)  # at the edge of the domain the side that counts may lie outside
        for difference in (central, *sides):
            off = np.abs(difference - slope) / np.maximum(size, np.abs(difference).max(1, keepdims=True))
            best = np.fmin(best, off)
        if before is not None:  # both sides have settled, on different values
            settled = np.all([np.abs(a - b) <= 1e-3 * np.abs(a - sides[1 - k]) for k, (a, b) in
                              enumerate(zip(sides, before))], axis=0)  # fmt: skip
            low, high = np.minimum(*sides), np.maximum(*sides)
            best = np.where(settled & (low <= slope) & (slope <= high), 0, best)
        before = sides
    usable = np.isin(status, (Status.CONVERGED, Status.UNLOADED)) & model.ordinary(lanes) & inside
    best = np.where((np.abs(base) < model.faint * scale[:, None]) & (base != 0), 0, best)
    off = np.where(np.isfinite(slope), best, np.inf).max(1)
    usable &= (off <= 1e-6) | (off > 10 * noise) | ~np.isfinite(slope).all(1)
    return np.where(usable, off, 0), usable


def poisoned(model: Model, lanes: Case) -> int:
    """Batch elements, most of them failed, with a gradient backwards through all finite values that is not finite."""

    def total(case: Any) -> Any:
        out = model.run(case)
        row = split(out)
        return jnp.sum(jnp.where(jnp.isfinite(row), row, 0)), out["status"]

    slope, status = jax.jit(jax.vmap(jax.grad(total, has_aux=True)))(lanes)
    failed = ~np.isin(np.asarray(status), (Status.CONVERGED, Status.UNLOADED, Status.CHANGE_POINT, Status.SINGULAR))
    finite = [np.isfinite(np.asarray(leaf)).reshape(len(failed), -1).all(1) for leaf in slope.values()]
    return int((failed & ~np.all(finite, axis=0)).sum())
