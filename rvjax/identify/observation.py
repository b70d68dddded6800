"""The observation of a model as a vector of real numbers, its `Noise`, and `orders`: the harmonics of a measured curve.

Leaves are in the order of `jax.tree`, complex ones as pairs.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import checked
from rvjax.records import Array, PyTree


@dataclasses.dataclass(frozen=True, eq=False)
class Noise:
    """Random error of every measured real number; a complex number holds two, independent of each other.

    Attributes:
        sd: standard deviation (the scale of Student noise), unit of the observation: one number, or the structure of
            the observation with a number or an array in each place.
        dof: degrees of freedom of Student noise, for data with outliers; inf is normal noise.
    """

    sd: PyTree
    dof: float = dataclasses.field(default=math.inf, kw_only=True)

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is no standard deviation."""
        leaves = jax.tree_util.tree_flatten_with_path(self.sd, is_leaf=lambda item: item is None)[0]
        if not leaves:
            raise ValueError(f"Noise.sd = {self.sd!r}: must hold a number, unit of the observation")
        for path, leaf in leaves:
            name = "Noise.sd" + jax.tree_util.keystr(path)
            try:
                sd = np.asarray(leaf, float)
            except (TypeError, ValueError):
                raise ValueError(f"{name} = {leaf!r}: must be a number, unit of the observation") from None
            bad = ~((sd > 0) & np.isfinite(sd))
            if bad.any():
                worst = float(sd[bad].flat[0])
                raise ValueError(f"{name} = {worst:.6g}: must be positive and finite, unit of the observation")
        if isinstance(self.dof, bool) or not isinstance(self.dof, (int, float)) or not self.dof > 0:
            raise ValueError(f"Noise.dof = {self.dof!r}: must be a positive number (inf: normal noise)")


ALL = "all"
"""Name of the only group of an observation that is no dict or record."""


def flatten(observation: object) -> jax.Array:
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
    def of(cls, observation: object) -> "Layout":
        """Return the layout of an observation, or of its shapes.

        Raises:
            ValueError: it holds no number.
        """
        leaves, treedef = jax.tree_util.tree_flatten_with_path(observation)
        shapes = tuple(tuple(np.shape(leaf)) for _, leaf in leaves)
        kinds = tuple(np.iscomplexobj(leaf) for _, leaf in leaves)
        made = cls(treedef, tuple(path for path, _ in leaves), shapes, kinds)
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
        names = []
        for path, shape, pairs in zip(self.paths, self.shapes, self.complex):
            name = jax.tree_util.keystr(path, simple=True, separator=".") or "data"
            for index in np.ndindex(shape):
                place = name + (f"[{','.join(map(str, index))}]" if shape else "")
                names += [f"{place}.real", f"{place}.imag"] if pairs else [place]
        return names

    @property
    def groups(self) -> dict[str, np.ndarray]:
        """Places of each group (a key of a dict or record observation, else "all")."""
        rows: dict[str, list[int]] = {}
        start = 0
        for path, size in zip(self.paths, self.sizes):
            named = path and isinstance(path[0], (jax.tree_util.DictKey, jax.tree_util.GetAttrKey))
            name = jax.tree_util.keystr(path[:1], simple=True) if named else ALL
            rows.setdefault(name, []).extend(range(start, start + size))
            start += size
        return {name: np.array(places) for name, places in rows.items()}

    def data(self, data: object, *, batched: bool = False) -> np.ndarray:
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
        leaves, parts = [], np.split(vector, np.cumsum(self.sizes)[:-1], axis=-1)
        for shape, pairs, part in zip(self.shapes, self.complex, parts):
            part = part.reshape((*vector.shape[:-1], *shape, *([2] if pairs else [])))
            leaves.append(part[..., 0] + 1j * part[..., 1] if pairs else part)
        return self.treedef.unflatten([leaf if leaf.ndim else leaf[()] for leaf in leaves])

    def _match(self, argument: str, tree: object) -> Iterator[tuple[str, tuple[int, ...], bool, object]]:
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


DEPENDENT = 1e-8
"""Least ratio of singular values at which the samples distinguish all orders."""


@dataclasses.dataclass(frozen=True, eq=False)
class Orders:
    """Harmonics of a curve, value(angle) = mean + Re sum_k value_k exp(i order_k angle).

    Attributes:
        order: as required (k,).
        value: complex amplitudes (k,), unit of the curve.
        sd: standard deviation of their real and imaginary part (k,), from the residual.
        mean: of the curve.
        residual_sd: standard deviation of what no order explains, unit of the curve.
    """

    order: np.ndarray
    value: np.ndarray
    sd: np.ndarray
    mean: float
    residual_sd: float


@checked
def orders(
    angle: Array | np.ndarray, value: Array | np.ndarray, orders: Sequence[float] | np.ndarray, *, drift: bool = False
) -> Orders:
    """Harmonics of a curve that may be sampled unevenly, over any number of turns.

    Args:
        angle: rad (n,).
        value: of the curve (n,), NaN where missing.
        orders: per turn, positive and distinct (k,).
        drift: whether the curve may also creep in proportion to the angle; that part is fitted and removed.

    Raises:
        ValueError: shapes that do not fit, numbers that are not finite, or more orders than the samples distinguish.
    """
    wanted = np.asarray(orders, float)
    if wanted.ndim != 1 or not (wanted > 0).all() or np.unique(wanted).size != wanted.size or np.isinf(wanted).any():
        raise ValueError(f"orders = {orders!r}: must be positive and distinct, per turn")
    x, y = np.asarray(angle, float), np.asarray(value, float)
    if x.ndim != 1 or x.shape != y.shape:
        raise ValueError(f"value: shape {y.shape}, angle has {x.shape} rad; both must be (n,)")
    seen = ~np.isnan(y)
    x, y = x[seen], y[seen]
    for name, item, unit in (("angle", x, "rad"), ("value", y, "unit of the curve")):
        if not np.isfinite(item).all():
            raise ValueError(f"{name} = {item[~np.isfinite(item)][0]}: must be finite, {unit}")
    # Columns of one length, about the mid-point of the angles: the scale of the angles does not change the condition.
    centred = (x - x.mean()) / max(float(np.ptp(x)), 1e-300) if x.size else x
    extra = [centred] if drift else []
    phase = x[:, None] * wanted
    matrix = np.concatenate([np.ones((x.size, 1)), *(c[:, None] for c in extra), np.cos(phase), -np.sin(phase)], axis=1)
    numbers = matrix.shape[1]
    left, singular, right = svd(matrix)
    if x.size <= numbers or singular[-1] < DEPENDENT * singular[0]:
        raise ValueError(f"orders = {wanted.tolist()}: {x.size} samples cannot determine {numbers} numbers per turn")
    coefficients = right.T @ ((left.T @ y) / singular)
    residual_sd = float(np.sqrt(((y - matrix @ coefficients) ** 2).sum() / (x.size - numbers)))
    variance = ((right.T / singular) ** 2).sum(axis=1)
    first = 1 + len(extra)
    real, imaginary = slice(first, first + wanted.size), slice(first + wanted.size, None)
    return Orders(
        order=wanted,
        value=coefficients[real] + 1j * coefficients[imaginary],
        sd=residual_sd * np.sqrt((variance[real] + variance[imaginary]) / 2),
        mean=float(coefficients[0]),
        residual_sd=residual_sd,
    )


def svd(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left vectors, singular values and right vectors of a matrix.

    The fast driver of LAPACK fails for some matrices whose singular values are equal, such as orders over whole turns;
    the other one is slower and always converges.

    Args:
        matrix: (n, p).
    """
    try:
        left, size, right = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        from scipy import linalg

        left, size, right = linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return left, size, right
