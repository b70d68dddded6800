"""Largest factor on all tolerances at which matched parts keep the yield of random assembly."""

import dataclasses
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax.assembly.belief import deviates, draw, known
from rvjax.assembly.choice import chosen
from rvjax.assembly.costs import Machine, UnitResponse, costs, good
from rvjax.assembly.parts import Kind, Part, at_path
from rvjax.assembly.supply import supply_of
from rvjax.records import PyTree
from rvjax.roots import bisect
from rvjax.tolerances import Requirement, Tolerance

WIDEST = 64.0
"""Factor at which the search ends."""

DRAWS = 16  # of what is not known of a part
STEPS = 8  # bisections of the factor


@dataclasses.dataclass(frozen=True, eq=False)
class Opening:
    """Largest factor on all tolerances.

    Attributes:
        factor: on all half-widths, at least 1; `WIDEST` where matching still keeps the yield there.
        curve: factors tried, ascending, with the yield of plans and of random assembly (tried, 3).
        target: yield of random assembly at factor 1, which plans keep up to `factor`.
    """

    factor: float
    curve: np.ndarray
    target: float

    def opened(self, tolerances: object) -> PyTree:
        """Return the same structure with every half-width times the factor, as `allocate` takes it."""
        return _widen(tolerances, self.factor)


@checked
def opening(
    response: UnitResponse,
    kinds: Mapping[str, Kind],
    tolerances: PyTree,
    *,
    requirement: Requirement,
    sets: int = 64,
    seed: int = 0,
) -> Opening:
    """Return the largest factor on all half-widths at which plans keep the yield of random assembly.

    Sets of virtual parts, as many as there are, sampled with the same random numbers at every factor, measured with the
    standard deviations of the parts, planned for the most good units, and valued with their true errors. Errors
    without a tolerance stay as they are.

    Args:
        response: as for `plan`.
        kinds: numbers of parts, their indices, stocks and measurement uncertainties.
        tolerances: at factor 1: {slot: structure}, or one structure for all slots.
        requirement: limits of a good unit.
        sets: of virtual parts.
        seed: of the random numbers.

    Raises:
        ValueError: no tolerance for any error, fewer than one set, or as for `plan`.
    """
    if sets < 1:
        raise ValueError(f"sets = {sets!r}: must be at least 1")
    if len(kinds) < 2:
        raise ValueError(f"kinds: {len(kinds)} slots, must be at least 2")
    by_slot = isinstance(tolerances, dict) and set(kinds) <= set(tolerances)
    stocks = {
        id(kind): _Virtual(kind, tolerances[slot] if by_slot else tolerances, sets, seed, number)
        for number, (slot, kind) in enumerate(kinds.items())
    }
    if not any(stock.moving for stock in stocks.values()):
        raise ValueError("tolerances: must hold a Tolerance of an error of the parts")

    def yields(factor: float, number: int) -> tuple[float, float]:
        """Share of good units of the plan, and of all combinations, of one set of true parts."""
        made = {key: stock.parts(factor, number) for key, stock in stocks.items()}
        by_kind = {key: known(kind, "kinds") for key, (kind, _) in made.items()}
        slots = {slot: by_kind[id(kind)] for slot, kind in kinds.items()}
        machine, supply = Machine(response, slots), supply_of(slots)
        true = {}
        for slot, kind in kinds.items():
            one, truth = slots[slot], made[id(kind)][1]
            moving = [place for place in range(len(truth[0])) if place not in one.still]
            true[slot] = [np.stack([truth[k][place] for k in one.order])[:, None] for place in moving]
        known_at = costs(machine, true, 1, requirement, True)
        weight = supply.weight()
        assert known_at.every_good is not None
        random = float((weight * known_at.every_good).sum() / weight.sum())
        draws = 1 if all(one.certain for one in slots.values()) else DRAWS
        seen = known_at
        if draws > 1:
            seen = costs(machine, draw(slots, seed, 0, draws, alike=True), draws, requirement, True)
        build = np.array(chosen(seen, supply, "yield", 4, np.random.default_rng([seed % 2**64, 5, number]))[0])
        turn = machine.indices[seen.index[tuple(build.T)]]
        values = machine.values(true, build, turn, np.zeros(len(build), int))
        return float(good(values, requirement).mean()), random

    tried: dict[float, tuple[float, float]] = {}

    def kept(power: float | np.ndarray) -> bool:
        """Return whether plans keep the yield at this power of two as factor."""
        factor = 2.0 ** float(power)
        matched, random = np.mean([yields(factor, number) for number in range(sets)], axis=0)
        tried[factor] = (float(matched), float(random))
        return tried[factor][0] >= tried[1.0][1]

    best, worst = 0.0, 1.0
    if kept(best):
        while 2**worst <= WIDEST and kept(worst):
            best, worst = worst, worst + 1
        best = float(bisect(kept, best, worst, steps=STEPS if 2**worst <= WIDEST else 0)[0])
    curve = np.array([(k, *tried[k]) for k in sorted(tried)])
    return Opening(2.0**best, curve, tried[1.0][1])


class _Virtual:
    """Virtual parts of one stock: the random numbers are sampled once."""

    def __init__(self, kind: Kind, tolerances: object, sets: int, seed: int, number: int) -> None:
        self.kind, self.tolerances = kind, getattr(tolerances, "tolerances", tolerances)
        self.structure: PyTree
        leaves, self.structure = jax.tree_util.tree_flatten_with_path(kind.parts[0].errors)
        self.given = [[np.asarray(leaf) for leaf in jax.tree.leaves(part.errors)] for part in kind.parts]
        self.sd = [[np.asarray(at_path(part.sd, path, 0.0), float) for path, _ in leaves] for part in kind.parts]
        self.moving = {
            place: tolerance.replace(shape=self.given[0][place].shape)
            for place, (path, _) in enumerate(leaves)
            if isinstance(tolerance := at_path(self.tolerances, path, None), Tolerance)
        }
        rng = np.random.default_rng([seed % 2**64, 4, number])
        size: Callable[[int], tuple[int, ...]] = lambda place: (sets, 2, *self.given[0][place].shape, len(kind.parts))  # noqa: E731
        self.z = {place: rng.standard_normal(size(place)) for place in self.moving}

    def parts(self, factor: float, number: int) -> tuple[Kind, list[list[PyTree]]]:
        """Return a set as it is measured, and its true errors by part and leaf."""
        truth: list[list[PyTree]] = [list(own) for own in self.given]
        seen: list[list[PyTree]] = [list(own) for own in self.given]
        for place, tolerance in self.moving.items():
            z, noise = self.z[place][number]
            errors = np.moveaxis(np.asarray(deviates(_widen(tolerance, factor), jnp.asarray(z)), float), -1, 0)
            for k, error in enumerate(errors):
                sd = np.where(np.isfinite(self.sd[k][place]), self.sd[k][place], 0.0)
                truth[k][place], seen[k][place] = error, error + sd * noise[..., k]
        parts = [Part(p.id, self.structure.unflatten(own), p.sd) for p, own in zip(self.kind.parts, seen)]
        population = _widen(self.tolerances, factor)
        return Kind(parts, indices=self.kind.indices, stock=self.kind.stock, population=population), truth


def _widen(tolerances: object, factor: float) -> object:
    """Multiply the half-width of all tolerances of a structure by a factor."""

    def wider(leaf: object) -> object:
        return leaf.with_half_width(factor * float(leaf.half_width)) if isinstance(leaf, Tolerance) else leaf

    return jax.tree.map(wider, tolerances, is_leaf=lambda leaf: leaf is None or isinstance(leaf, Tolerance))
