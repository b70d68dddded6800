"""The observation of a model as a vector of real numbers, leaves in the order of `jax.tree`, complex ones as pairs."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import PyTree

ALL = "all"
"""Name of the only group of an observation that is no dict or record."""


def flatten(observation: PyTree) -> jax.Array:
    """All numbers of an observation as one real vector (m,); of complex ones real and imaginary part in turn."""
    parts = []
    for leaf in jax.tree.leaves(observation):
        number = jnp.asarray(leaf)
        if jnp.iscomplexobj(number):
            number = jnp.stack([number.real, number.imag], axis=-1)
        parts.append(jnp.ravel(number).astype(jnp.result_type(float)))
    return jnp.concatenate(parts)


@dataclasses.dataclass(frozen=True)
class Layout:
    """Place of each number of an observation in its vector."""

    treedef: Any
    paths: tuple[Any, ...]
    shapes: tuple[tuple[int, ...], ...]
    complex: tuple[bool, ...]

    @classmethod
    def of(cls, observation: PyTree) -> "Layout":
        """Return the layout of an observation, or of its shapes.

        Raises:
            ValueError: it holds no number.
        """
        leaves, treedef = jax.tree_util.tree_flatten_with_path(observation)
        shapes = tuple(tuple(np.shape(leaf)) for _, leaf in leaves)
        made = cls(treedef, tuple(path for path, _ in leaves), shapes, tuple(_is_complex(leaf) for _, leaf in leaves))
        if not made.size:
            raise ValueError("model: its observation holds no number")
        return made

    @property
    def sizes(self) -> tuple[int, ...]:
        """Real numbers of each leaf."""
        return tuple(math.prod(shape) * (1 + pairs) for shape, pairs in zip(self.shapes, self.complex))

    @property
    def size(self) -> int:
        """Real numbers in all, m."""
        return sum(self.sizes)

    @property
    def names(self) -> list[str]:
        """A name for each real number, such as "te[3].imag"."""
        found = []
        for name, shape, pairs in zip(self._leaf_names(), self.shapes, self.complex):
            for index in np.ndindex(shape):
                place = name + (f"[{','.join(map(str, index))}]" if shape else "")
                found += [f"{place}.real", f"{place}.imag"] if pairs else [place]
        return found

    @property
    def groups(self) -> dict[str, np.ndarray]:
        """Places of each group (a key of a dict or record observation, else "all")."""
        found: dict[str, list[int]] = {}
        start = 0
        for path, size in zip(self.paths, self.sizes):
            named = path and isinstance(path[0], (jax.tree_util.DictKey, jax.tree_util.GetAttrKey))
            name = jax.tree_util.keystr(path[:1], simple=True) if named else ALL
            found.setdefault(name, []).extend(range(start, start + size))
            start += size
        return {name: np.array(places) for name, places in found.items()}

    def data(self, data: PyTree, *, batched: bool = False) -> np.ndarray:
        """Measured data as a vector (m,), or (units, m) where every leaf has the units on axis 0; NaN is missing.

        Raises:
            ValueError: another structure or shape, unequal counts of units, infinite, or nothing measured.
        """
        rows, counts = [], {}
        for name, shape, pairs, leaf in self._match("data", data):
            number = _numbers(f"data{name}", leaf, pairs)
            lead = np.shape(number)[:1] if batched else ()
            if np.shape(number) != lead + shape or (batched and not lead):
                expected = f"(units, {', '.join(map(str, shape))})" if batched else str(shape)
                raise ValueError(f"data{name}: shape {np.shape(number)}, the model gives {expected}")
            counts[f"data{name}"] = lead
            if pairs:
                number = np.stack([number.real, number.imag], axis=-1)
                number = np.where(np.isnan(number).any(axis=-1, keepdims=True), np.nan, number)
            if np.isinf(number).any():
                where = tuple(int(i) for i in np.argwhere(np.isinf(number))[0])
                raise ValueError(f"data{name}{list(where)} = {number[where]}: must be finite, or NaN where missing")
            rows.append(number.reshape(*lead, math.prod(shape) * (1 + pairs)))
        if len(set(counts.values())) > 1:
            raise ValueError(
                f"data: unequal counts of units, {', '.join(f'{n} has {c[0]}' for n, c in counts.items())}"
            )
        vector = np.concatenate(rows, axis=-1)
        if batched and not len(vector):
            raise ValueError("data: 0 units, must hold at least one")
        empty = np.isnan(vector).all(axis=-1)
        if empty.any():
            raise ValueError(f"data{f'[{int(np.argmax(empty))}]' if batched else ''} = NaN: all of it is missing")
        return vector

    def sd(self, sd: PyTree) -> np.ndarray:
        """Standard deviation of every real number (m,).

        Raises:
            ValueError: another structure or shape.
        """
        if jax.tree_util.all_leaves([sd]) and np.ndim(sd) == 0:
            return np.full(self.size, float(sd))
        rows = []
        for name, shape, pairs, leaf in self._match("noise.sd", sd):
            number = np.asarray(leaf, float)
            try:
                number = np.broadcast_to(number, shape)
            except ValueError:
                raise ValueError(f"noise.sd{name}: shape {number.shape}, the model gives {shape}") from None
            rows.append(np.repeat(number.reshape(-1), 1 + pairs))
        return np.concatenate(rows)

    def tree(self, vector: np.ndarray) -> PyTree:
        """Return the observation of a vector (..., m), leaves (..., *shape)."""
        leaves = []
        for shape, pairs, part in zip(self.shapes, self.complex, self._split(vector)):
            part = part.reshape((*vector.shape[:-1], *shape, *([2] if pairs else [])))
            leaves.append(part[..., 0] + 1j * part[..., 1] if pairs else part)
        return self.treedef.unflatten([leaf if leaf.ndim else leaf[()] for leaf in leaves])

    def _split(self, vector: np.ndarray) -> list[np.ndarray]:
        return np.split(vector, np.cumsum(self.sizes)[:-1], axis=-1)

    def _leaf_names(self) -> list[str]:
        named = (jax.tree_util.keystr(path, simple=True, separator=".") for path in self.paths)
        return [name or "data" for name in named]

    def _match(self, argument: str, tree: PyTree) -> Iterator[tuple[str, tuple[int, ...], bool, PyTree]]:
        """Yield name, shape and kind of each leaf of the observation with the same leaf of `tree`."""
        try:
            leaves = self.treedef.flatten_up_to(tree)
        except (ValueError, TypeError):
            expected = self.treedef.unflatten([f"shape {shape}" for shape in self.shapes])
            raise ValueError(
                f"{argument}: structure {jax.tree.structure(tree)}, the model gives {expected}".replace("\n", " ")
            ) from None
        names = [jax.tree_util.keystr(path) for path in self.paths]
        yield from zip(names, self.shapes, self.complex, leaves)


def _is_complex(leaf: object) -> bool:
    return bool(np.issubdtype(leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype, np.complexfloating))


def _numbers(name: str, leaf: object, pairs: bool) -> np.ndarray:
    """Return a leaf of the data as an array of the model's kind of numbers; None is missing."""
    try:
        given = np.asarray(leaf)
        number = given.astype(complex if pairs else float) if given.dtype.kind in "fiuO" else given
    except (TypeError, ValueError):
        number = np.asarray("")
    if number.dtype.kind != ("c" if pairs else "f") or (pairs and given.dtype.kind in "fiu"):
        raise ValueError(f"{name}: must hold {'complex' if pairs else 'real'} numbers, got {np.asarray(leaf).dtype}")
    return number
