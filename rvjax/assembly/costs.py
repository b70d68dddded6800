"""Response of many combinations of parts: one compiled program, blocks of one size."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import in_blocks
from rvjax._jax.sizes import ASSEMBLED
from rvjax.assembly.belief import Known
from rvjax.records import PyTree, Scalar
from rvjax.response import evaluate, per_response
from rvjax.status import succeeded
from rvjax.tolerances import Requirement

UnitResponse = Callable[[dict[str, PyTree], dict[str, PyTree]], PyTree]
"""(parts {slot: errors}, index {slot: int}) -> scalar or Outcome."""

MOST = 2**24
"""Combinations whose costs are kept side by side: beyond, sort some slot first."""


@per_response(static=("shapes", "counts", "at"))
def respond(
    response: UnitResponse,
    leaves: Mapping[str, Sequence[jax.Array]],
    index: Mapping[str, jax.Array],
    *,
    shapes: tuple["Shape", ...],
    counts: tuple[int, ...],
    at: tuple[int, ...] | None = None,
) -> jax.Array:
    """Responses (batch,), nan where a unit failed.

    Args:
        response: (parts {slot: errors}, index {slot: int}) -> scalar or Outcome.
        leaves: moving errors of each slot (batch, *shape).
        index: angular positions of each slot (batch,).
        shapes: of the errors of each slot.
        counts: angular positions that each slot has.
        at: the same plain indices for all units, for a response that cannot take traced ones; None: those in `index`.
    """

    def one(leaves: Mapping[str, Sequence[jax.Array]], index: Mapping[str, jax.Array]) -> jax.Array:
        parts = {shape.slot: shape.assembled(leaves[shape.slot]) for shape in shapes}
        turned: dict[str, PyTree] = dict(zip(parts, at or ()))
        if at is None:
            turned = {slot: _weak(index[slot], count) for slot, count in zip(parts, counts)}
        values, status = evaluate(lambda _: response(parts, turned), None)
        if len(values) != 1:
            raise ValueError(f"response: must be one number, it has {', '.join(values)}")
        (value,) = values.values()
        return jnp.where(succeeded(status) & jnp.isfinite(value), value, jnp.nan)

    return jax.vmap(one)(leaves, index)


def _weak(index: jax.Array, count: int) -> Scalar:
    """Return a traced index that mixes with numbers of any type, as a plain integer does."""
    return sum(jnp.where(index == k, k, 0) for k in range(1, count)) if count > 1 else 0


@dataclasses.dataclass(frozen=True)
class Shape:
    """Structure of the errors of the parts in a slot, without numbers; part of the program's key."""

    slot: str
    structure: PyTree
    still: frozenset[int]

    def assembled(self, leaves: Sequence[jax.Array]) -> PyTree:
        """Errors of one part from its moving leaves."""
        moving = iter(leaves)
        count = len(leaves) + len(self.still)
        return self.structure.unflatten([0.0 if k in self.still else next(moving) for k in range(count)])


class Machine:
    """A response and the parts of its slots, ready to value any units."""

    def __init__(self, response: UnitResponse, slots: Mapping[str, Known]) -> None:
        """Slots in the order in which combinations name their parts.

        Raises:
            ValueError: more combinations than fit side by side.
        """
        self.response, self.slots = response, dict(slots)
        self.counts = tuple(known.kind.indices for known in slots.values())
        self.indices = np.array(list(itertools.product(*map(range, self.counts))), np.int32)
        self.shape = tuple(len(known.order) for known in slots.values())
        if math.prod(self.shape) > MOST:
            shown = " x ".join(map(str, self.shape))
            raise ValueError(f"kinds: {shown} combinations are more than {MOST}; plan fewer slots at once")
        self._shapes = tuple(Shape(slot, known.structure, known.still) for slot, known in slots.items())
        self._traced: bool | None = None

    def values(
        self, drawn: Mapping[str, list[np.ndarray]], place: np.ndarray, index: np.ndarray, draw: np.ndarray
    ) -> np.ndarray:
        """Responses (batch,), nan where a unit failed.

        Args:
            drawn: errors of each slot by leaf (parts, draws, *shape).
            place: part of each slot (batch, slots).
            index: angular position of each slot (batch, slots).
            draw: number of the draw (batch,).
        """
        lanes = len(place)
        block = ASSEMBLED[lanes > ASSEMBLED[0]]

        def of_block(place: np.ndarray, index: np.ndarray, draw: np.ndarray) -> np.ndarray:
            leaves = {slot: [leaf[place[:, k], draw] for leaf in drawn[slot]] for k, slot in enumerate(self.slots)}
            return self._block(leaves, index)

        return in_blocks(of_block, block, place, index, draw)

    def _block(self, leaves: dict[str, list[np.ndarray]], index: np.ndarray) -> np.ndarray:
        by_slot = {slot: index[:, k] for k, slot in enumerate(self.slots)}

        def run(at: tuple[int, ...] | None) -> np.ndarray:
            return np.asarray(respond(self.response, leaves, by_slot, shapes=self._shapes, counts=self.counts, at=at))

        if len(self.indices) == 1:
            return run(tuple(0 for _ in self.counts))
        if self._traced is not False:
            try:
                values = run(None)
            except TypeError:  # an index that has to be a plain integer: one program for each
                if self._traced:
                    raise
                self._traced = False
            else:
                self._traced = True
                return values
        values = np.empty(len(index))
        for at in np.unique(index, axis=0):
            here = (index == at).all(axis=1)
            values[here] = run(tuple(at.tolist()))[here]
        return values


@dataclasses.dataclass(frozen=True)
class Costs:
    """Costs of every combination of parts in its best angular position.

    Attributes:
        mean: expected response, inf where it fails (parts of slot 0, parts of slot 1, ...).
        outside: share of draws in which the unit is no good, of the same shape; None without a requirement.
        index: number of the best position, of the same shape.
        every_mean: expected response over all positions, failed ones left out, nan where all fail.
        every_good: share of good units over all positions; None without a requirement.
        level: all combinations cost the same in all positions.
    """

    mean: np.ndarray
    outside: np.ndarray | None
    index: np.ndarray
    every_mean: np.ndarray
    every_good: np.ndarray | None
    level: bool

    @property
    def count(self) -> int:
        """Number of combinations; all are valued."""
        return self.mean.size

    def of(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Expected response and number of the best position of some combinations (cells, slots), each (cells,)."""
        at = tuple(place.T)
        return self.mean[at], self.index[at]


def costs(
    machine: Machine, drawn: Mapping[str, list[np.ndarray]], draws: int, requirement: Requirement | None, by_yield: bool
) -> Costs:
    """Value all combinations of parts in all positions on the same draws.

    Args:
        machine: response and parts.
        drawn: errors of each slot.
        draws: their count.
        requirement: limits of a good unit, or None.
        by_yield: the best position is that of the most good units, else that of the least mean.
    """
    shape, total = machine.shape, math.prod(machine.shape)
    mean, outside = valued(machine, drawn, draws, requirement, np.arange(total))
    finite = np.isfinite(mean)
    best = best_turn(mean, outside, by_yield)
    rows = np.arange(total)
    with np.errstate(invalid="ignore"):
        every = np.where(finite, mean, 0).sum(axis=1) / finite.sum(axis=1)
    size = np.abs(mean[finite]).max(initial=0.0)
    level = bool(finite.all() and np.ptp(mean) <= 1e-12 * size and np.ptp(outside) == 0)
    return Costs(
        mean=mean[rows, best].reshape(shape),
        outside=None if requirement is None else outside[rows, best].reshape(shape),
        index=best.reshape(shape),
        every_mean=every.reshape(shape),
        every_good=None if requirement is None else (1 - outside.mean(axis=1)).reshape(shape),
        level=level,
    )


def valued(
    machine: Machine,
    drawn: Mapping[str, list[np.ndarray]],
    draws: int | np.ndarray,
    requirement: Requirement | None,
    cells: np.ndarray,
    turns: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Expected response, inf where a unit fails, and share of draws outside the limits, each (cells, positions).

    Args:
        machine: response and parts.
        drawn: errors of each slot.
        draws: their count, or the numbers of those that are taken.
        requirement: limits of a good unit, or None.
        cells: flat numbers of combinations (cells,).
        turns: numbers of the positions; None: all.
    """
    turns = np.arange(len(machine.indices)) if turns is None else turns
    taken = np.arange(draws) if isinstance(draws, int) else draws
    each = len(turns) * len(taken)
    mean, outside = np.empty((len(cells), len(turns))), np.empty((len(cells), len(turns)))
    at_once = max(1, (1 << 20) // each)
    for start in range(0, len(cells), at_once):
        part = cells[start : start + at_once]
        cell, turn, draw = (x.ravel() for x in np.meshgrid(part, turns, taken, indexing="ij"))
        place = np.stack(np.unravel_index(cell, machine.shape), axis=1)
        values = machine.values(drawn, place, machine.indices[turn], draw).reshape(len(part), len(turns), len(taken))
        mean[start : start + at_once] = np.where(np.isnan(values).any(axis=2), np.inf, values.mean(axis=2))
        outside[start : start + at_once] = 1 - good(values, requirement).mean(axis=2)
    return mean, outside


def best_turn(mean: np.ndarray, outside: np.ndarray, by_yield: bool) -> np.ndarray:
    """Number of the best position of each combination (cells,).

    Args:
        mean: of the response (cells, positions).
        outside: share of draws that are no good (cells, positions).
        by_yield: the fewest bad draws first, then the least mean; else the least mean.
    """
    return np.lexsort((mean, outside), axis=1)[:, 0] if by_yield else mean.argmin(axis=1)


def good(values: np.ndarray, requirement: Requirement | None) -> np.ndarray:
    """Return whether units keep the limits; failed ones do not.

    Args:
        values: responses, nan where a unit failed.
        requirement: limits, None for none.
    """
    if requirement is None:
        return np.isfinite(values)
    return (values >= requirement.lower) & (values <= requirement.upper)
