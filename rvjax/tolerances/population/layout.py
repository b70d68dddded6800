"""Which fields of the tolerances are active, and their errors from standard normal numbers.

`tolerances` has the structure of the errors, with a `Tolerance` where an error varies and None (or a
number) where it does not. The z of a unit are one vector: the active fields in the order of
`jax.tree` (record fields as declared, dict keys sorted), each with its elements in C order.
"""

import dataclasses
import functools
import math
import operator
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.records import Record, field, is_concrete, record
from rvjax.tolerances.distribution.tolerance import Tolerance, deviate


@record
class Correlated(Record):
    """Tolerances together with the correlation of their random numbers; wherever tolerances pass, this may."""

    tolerances: Any = field("-", "record or dict of tolerances", kind="record")
    mixing: Any = field("-", "Cholesky factor of the correlation of z, batches included", shape=("numbers", "numbers"))


@dataclasses.dataclass(frozen=True)
class Layout:
    """Tolerances taken apart: every leaf with its name; `active` are those with a `Tolerance`."""

    names: tuple[str, ...]
    leaves: tuple[Any, ...]
    treedef: Any
    mixing: Any = None

    @property
    def active(self) -> dict[str, Tolerance]:
        """Active fields by name, in the order of their random numbers."""
        return {n: leaf for n, leaf in zip(self.names, self.leaves) if isinstance(leaf, Tolerance)}

    @property
    def numbers(self) -> int:
        """Random numbers per unit."""
        if self.mixing is not None:
            return self.mixing.shape[0]
        return sum(numbers_of(tolerance) for tolerance in self.active.values())

    def errors(self, values: dict[str, Any]) -> Any:
        """The error structure with `values` in the active fields; inactive ones stay plain 0.0 and cost nothing."""
        filled = [values.get(name, 0.0 if leaf is None else leaf) for name, leaf in zip(self.names, self.leaves)]
        return self.treedef.unflatten(filled)

    def replace(self, changes: dict[str, Any]) -> Any:
        """The tolerances with some fields changed."""
        changed = self.treedef.unflatten([changes.get(name, leaf) for name, leaf in zip(self.names, self.leaves)])
        return changed if self.mixing is None else Correlated(changed, self.mixing)

    @staticmethod
    def bare(tolerances: Any) -> Any:
        """Tolerances without the correlation they may carry."""
        return tolerances.tolerances if isinstance(tolerances, Correlated) else tolerances


def layout(tolerances: Any) -> Layout:
    """Take tolerances apart and check what stands in each field.

    Raises:
        ValueError: a leaf that is neither a `Tolerance`, nor None, nor a number; or no structure at all.
    """
    mixing = None
    if isinstance(tolerances, Correlated):
        tolerances, mixing = tolerances.tolerances, tolerances.mixing
    if not isinstance(tolerances, (dict, Record)) or isinstance(tolerances, Tolerance):
        raise ValueError(f"tolerances: must be a record or a dict of tolerances, got {type(tolerances).__name__}")
    paths, treedef = jax.tree_util.tree_flatten_with_path(tolerances, is_leaf=_is_leaf)
    names = tuple(jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in paths)
    leaves = []
    for name, (_, leaf) in zip(names, paths):
        known = leaf is None or isinstance(leaf, (Tolerance, jax.core.Tracer)) or is_concrete(leaf)
        if not known:
            raise ValueError(f"tolerances: {name} = {leaf!r} must be a Tolerance or None")
        leaves.append(None if isinstance(leaf, float) and leaf == 0 else leaf)
    return Layout(names, tuple(leaves), treedef, mixing)


def _is_leaf(item: Any) -> bool:
    return item is None or isinstance(item, Tolerance)


def numbers_of(tolerance: Tolerance) -> int:
    """Random numbers of one field, shared factors included, where no correlation mixes the fields."""
    own = math.prod(tolerance.shape)
    if tolerance.batch == 0:
        return own
    return own + (2 if tolerance.is_vector else 1)


def normals(parts: Layout, key: jax.Array, index: jax.Array) -> jax.Array:
    """The z of units `index` (n,): shape (numbers, n), units last so that every number is a vector of units.

    Unit i depends on the key and i alone, whatever stands beside it in the batch.
    """
    return jax.vmap(lambda i: jax.random.normal(jax.random.fold_in(key, i), (parts.numbers,)), out_axes=-1)(index)


@functools.partial(jax.jit, static_argnames="count")
def drawn(tolerances: Any, key: jax.Array, start: jax.Array, *, count: int) -> jax.Array:
    """The z of units start .. start + count - 1 (numbers, count)."""
    return normals(layout(tolerances), key, start + jnp.arange(count, dtype=jnp.uint32))


def deviations(parts: Layout, z: jax.Array) -> dict[str, jax.Array]:
    """Errors of the active fields from z (numbers, *batch): each (*shape, *batch)."""
    errors, start = {}, 0
    if parts.mixing is not None:
        z = jnp.matmul(jnp.asarray(parts.mixing, z.dtype), z, precision="highest")
    for name, tolerance in parts.active.items():
        stop = start + math.prod(tolerance.shape)
        own = z[start:stop].reshape(tolerance.shape + z.shape[1:])
        start = stop if parts.mixing is not None else start + numbers_of(tolerance)
        if tolerance.batch and parts.mixing is None:
            shared = z[stop:start]  # (1, *batch), or (2, *batch) for vectors
            lead = (1,) * (len(tolerance.shape) - 1)
            shared = shared.reshape(lead + shared.shape) if tolerance.shape else shared[0]
            own = (
                math.sqrt(tolerance.batch) * jnp.broadcast_to(shared, own.shape) + math.sqrt(1 - tolerance.batch) * own
            )
        errors[name] = deviate(tolerance, own)
    return errors


def root_key(seed: int) -> jax.Array:
    """The key of a study."""
    try:
        return jax.random.key(operator.index(seed))
    except (TypeError, OverflowError):
        raise ValueError(f"seed = {seed!r}: must be an integer") from None
