"""Parts with measured errors, kinds of parts, and the distribution of the errors of a kind."""

import dataclasses
import operator
from collections.abc import Hashable, Iterable, Sequence
from typing import SupportsIndex

import jax
import numpy as np

from rvjax.assembly.belief import Belief, belief
from rvjax.records import PyTree, Record
from rvjax.tolerances import Tolerance

Path = tuple[PyTree, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One measured part.

    Attributes:
        id: what is written on it.
        errors: measured, SI: a record, a dict or a number.
        sd: standard deviation of the measurement, SI: one number, or of the structure of `errors`; inf: not measured.
            One number leaves out the fields of a record that are plain zeros in all parts.
    """

    id: Hashable
    errors: PyTree
    sd: PyTree = 0.0

    def __post_init__(self) -> None:
        leaves = jax.tree_util.tree_flatten_with_path(self.errors)[0]
        if not leaves:
            raise ValueError(f"part {self.id!r}: errors = {self.errors!r}: holds no number")
        for path, leaf in leaves:
            name = jax.tree_util.keystr(path, simple=True, separator=".") or "errors"
            try:
                numbers, spread = np.asarray(leaf), np.asarray(at_path(self.sd, path, 0.0), float)
                finite = np.isfinite(numbers).all()
            except (TypeError, ValueError):
                raise ValueError(f"part {self.id!r}: {name} = {leaf!r}: must be a number with a spread") from None
            if not finite:
                raise ValueError(f"part {self.id!r}: {name} = {leaf!r}: must be finite")
            if not (spread >= 0).all():
                raise ValueError(f"part {self.id!r}: sd of {name} = {spread.min():.6g}: must be zero or positive")
            if np.iscomplexobj(numbers) and spread.any():
                raise ValueError(f"part {self.id!r}: {name} = {leaf!r}: a complex error has no standard deviation")


@dataclasses.dataclass(frozen=True, eq=False)
class Kind:
    """All parts that may be mounted in a slot.

    Attributes:
        parts: in the order in which they lie there.
        indices: angular positions in which a part may be mounted.
        stock: pieces of each part (classes of pins or shims); None: one of each.
        population: tolerances that the parts come from, of the structure of their errors; None: unknown.
    """

    parts: Sequence[Part]
    _: dataclasses.KW_ONLY
    indices: int = 1
    stock: Sequence[int] | None = None
    population: PyTree = None

    def __post_init__(self) -> None:
        parts = tuple(self.parts) if isinstance(self.parts, Iterable) else (self.parts,)
        for part in parts:
            if not isinstance(part, Part):
                raise ValueError(f"parts: {part!r} must be a Part")
        object.__setattr__(self, "parts", parts)
        if not self.parts:
            raise ValueError("parts: must hold at least one part")
        seen = set()
        for part in self.parts:
            if part.id in seen:
                raise ValueError(f"part {part.id!r}: duplicate id")
            seen.add(part.id)
        if _whole(self.indices) < 1:
            raise ValueError(f"indices = {self.indices!r}: must be a whole number of at least 1")
        if self.stock is not None:
            if not isinstance(self.stock, Sequence | np.ndarray):
                raise ValueError(f"stock = {self.stock!r}: must be a sequence of whole numbers, one for each part")
            if len(self.stock) != len(self.parts):
                raise ValueError(f"stock: {len(self.stock)} numbers for {len(self.parts)} parts")
            for part, pieces in zip(self.parts, self.stock):
                if _whole(pieces) < 0:
                    raise ValueError(f"stock = {pieces!r} of part {part.id!r}: must be a whole number, 0 or more")
            if not sum(self.stock):
                raise ValueError("stock: must hold at least one piece")

    @property
    def pieces(self) -> np.ndarray:
        """Pieces of each part (parts,)."""
        return np.ones(len(self.parts), int) if self.stock is None else np.array(self.stock, int)


def _whole(number: SupportsIndex) -> int:
    try:
        return operator.index(number)
    except TypeError:
        return -1


def at_path(structure: object, path: Path, absent: object) -> PyTree:
    """Entry of a structure for a leaf of another structure: the leaf at its path, or the leaf above.

    Args:
        structure: dict, record, list, tuple, or a leaf for all.
        path: of the leaf, as `jax.tree_util` gives it.
        absent: where it has none.
    """
    for key in path:
        if not isinstance(structure, (dict, Record, list, tuple)) or isinstance(structure, Tolerance):
            return structure
        name = getattr(key, "key", getattr(key, "name", getattr(key, "idx", None)))
        if isinstance(structure, dict):
            structure = structure.get(name, absent)
        elif isinstance(structure, Record):
            structure = getattr(structure, str(name), absent)
        else:
            structure = structure[name] if isinstance(name, int) and name < len(structure) else absent
    return structure


def _left_out(value: object, part: Part) -> bool:
    """Return whether a field of a record is not measured: the default 0.0, without a standard deviation."""
    return isinstance(value, float) and value == 0.0 and isinstance(part.sd, (int, float))


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """All parts of a kind, in an order that depends on the errors only.

    A plan does not depend on names and order of the parts.

    Attributes:
        kind: as given.
        order: place in `kind.parts` of each part (parts,).
        pieces: of each part (parts,).
        beliefs: of each leaf of the errors that is no constant zero.
        still: places of the leaves that are a constant zero.
        structure: of the errors of one part.
    """

    kind: Kind
    order: np.ndarray
    pieces: np.ndarray
    beliefs: tuple[Belief, ...]
    still: frozenset[int]
    structure: PyTree

    @property
    def certain(self) -> bool:
        """True if no error is random."""
        return all(one.certain for one in self.beliefs)

    def id_of(self, place: int) -> Hashable:
        """Label of a part."""
        return self.kind.parts[int(self.order[place])].id

    def drawn(self, rng: np.random.Generator, draws: int, *, alike: bool) -> list[np.ndarray]:
        """Errors by leaf (parts, draws, *shape).

        Args:
            rng: random numbers.
            draws: their count; 1 with nothing to draw.
            alike: antithetic draws that are common to all parts; else each part has its own.
        """
        leaves = []
        for one in self.beliefs:
            shape = one.mean.shape[1:]
            if one.certain:
                leaves.append(np.broadcast_to(one.mean[:, None], (len(one.mean), draws, *shape)))
                continue
            if alike:
                half = rng.standard_normal((1, draws // 2, *shape))
                z = np.concatenate([half, -half, np.zeros((1, draws % 2, *shape))], axis=1)
            else:
                z = rng.standard_normal((len(one.mean), draws, *shape))
            leaves.append(one.drawn(z))
        return leaves


def known(kind: Kind, slot: str) -> Known:
    """Measured parts of one kind.

    Raises:
        ValueError: parts whose errors differ in structure or shape.
    """
    columns, structure = [], None
    for part in kind.parts:
        leaves, own = jax.tree_util.tree_flatten_with_path(part.errors)
        if structure is not None and own != structure:
            raise ValueError(f"{slot}: the errors of part {part.id!r} must have the structure of the parts before it")
        structure = own
        columns.append(leaves)
    population = getattr(kind.population, "tolerances", kind.population)
    values, spreads, tolerances, still = [], [], [], set()
    for place, (path, _) in enumerate(columns[0]):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        given = [column[place][1] for column in columns]
        tolerance = at_path(population, path, None)
        if tolerance is not None and not isinstance(tolerance, Tolerance):
            raise ValueError(f"{slot}: population of {name} = {tolerance!r}: must be a Tolerance or None")
        of_record = bool(path) and isinstance(path[-1], jax.tree_util.GetAttrKey)
        if of_record and tolerance is None and all(map(_left_out, given, kind.parts)):
            still.add(place)
            continue
        try:
            stacked = np.stack(np.broadcast_arrays(*map(np.asarray, given)))
            spread = [
                np.broadcast_to(np.asarray(at_path(p.sd, path, 0.0), float), stacked.shape[1:]) for p in kind.parts
            ]
        except ValueError:
            raise ValueError(f"{slot}: {name} must have one shape in all parts") from None
        if tolerance is None and np.isinf(spread).any():
            raise ValueError(f"{slot}: {name} is not measured (sd = inf); give its population")
        values.append(stacked if np.iscomplexobj(stacked) else stacked.astype(float))
        spreads.append(np.stack(spread))
        tolerances.append(tolerance)
    keys = [
        np.concatenate([np.empty(0), *(np.ravel(x[k]) for x in (*values, *spreads))]) for k in range(len(kind.parts))
    ]
    pieces = kind.pieces
    order = np.array(sorted(range(len(kind.parts)), key=lambda k: (tuple(keys[k].view(float)), pieces[k])))
    beliefs = tuple(belief(v[order], s[order], t) for v, s, t in zip(values, spreads, tolerances))
    return Known(kind, order, pieces[order], beliefs, frozenset(still), structure)
