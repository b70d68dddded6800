"""From tolerances to errors: which fields are active, their random numbers, and one unit at a time.

`tolerances` has the structure of the errors, with a `Tolerance` where an error varies and None (or a
number) where it does not. The z of a unit are one vector: the active fields in the order of
`jax.tree` (record fields as declared, dict keys sorted), each with its elements in C order.
"""

import dataclasses
import math
import operator
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.records import Record, axis_sizes, is_concrete
from rvjax.tolerances.distributions import Tolerance, deviate


def for_design(design: Any, **tolerances: Tolerance | None) -> Any:
    """Tolerances of a design: its error record with a `Tolerance` or None in each field, shapes filled in.

    Args:
        design: names its error record and the sizes of its axes (`error_record`, `counts`).
        **tolerances: a `Tolerance` or None per field of that record; absent fields are exactly nominal.

    Raises:
        ValueError: unknown field, not a tolerance, or a shape that does not fit the design.
    """
    cls, filled = design.error_record, {}
    declared = {f.name: f.metadata["shape"] for f in dataclasses.fields(cls)}
    for name in tolerances:
        if name not in declared:
            raise ValueError(f"{cls.__name__} has no field {name!r}; it has {', '.join(sorted(declared))}")
    for name, axes in declared.items():
        tolerance, sizes = tolerances.get(name), axis_sizes(axes, design.counts)
        if tolerance is not None:
            if not isinstance(tolerance, Tolerance):
                raise ValueError(f"{name} = {tolerance!r}: must be a Tolerance or None")
            if tolerance.shape not in ((), sizes):
                raise ValueError(
                    f"{name}: Tolerance.shape = {tolerance.shape} does not fit this design, expected {sizes}"
                )
            # An axis of two cranks is no vector; only a literal 2 in the record is [radial, tangential].
            vector = bool(axes) and axes[-1] == 2
            tolerance = tolerance.replace(shape=sizes, vector=vector)
        filled[name] = tolerance
    return cls(**filled)


@dataclasses.dataclass(frozen=True)
class Layout:
    """Tolerances taken apart: every leaf with its name; `active` are those with a `Tolerance`."""

    names: tuple[str, ...]
    leaves: tuple[Any, ...]
    treedef: Any

    @property
    def active(self) -> dict[str, Tolerance]:
        """Active fields by name, in the order of their random numbers."""
        return {n: leaf for n, leaf in zip(self.names, self.leaves) if isinstance(leaf, Tolerance)}

    @property
    def numbers(self) -> int:
        """Random numbers per unit."""
        return sum(_numbers(tolerance) for tolerance in self.active.values())

    def errors(self, values: dict[str, Any]) -> Any:
        """The error structure with `values` in the active fields; inactive ones stay plain 0.0 and cost nothing."""
        filled = [values.get(name, 0.0 if leaf is None else leaf) for name, leaf in zip(self.names, self.leaves)]
        return self.treedef.unflatten(filled)

    def replace(self, changes: dict[str, Any]) -> Any:
        """The tolerances with some fields changed."""
        return self.treedef.unflatten([changes.get(name, leaf) for name, leaf in zip(self.names, self.leaves)])


def layout(tolerances: Any) -> Layout:
    """Take tolerances apart and check what stands in each field.

    Raises:
        ValueError: a leaf that is neither a `Tolerance`, nor None, nor a number; or no structure at all.
    """
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
    return Layout(names, tuple(leaves), treedef)


def _is_leaf(item: Any) -> bool:
    return item is None or isinstance(item, Tolerance)


def _numbers(tolerance: Tolerance) -> int:
    own = math.prod(tolerance.shape)
    if tolerance.batch == 0:
        return own
    return own + (2 if tolerance.is_vector else 1)


def normals(parts: Layout, key: jax.Array, index: jax.Array) -> jax.Array:
    """The z of units `index` (n,): shape (numbers, n), units last so that every number is a vector of units.

    Unit i depends on the key and i alone, whatever stands beside it in the batch.
    """
    return jax.vmap(lambda i: jax.random.normal(jax.random.fold_in(key, i), (parts.numbers,)), out_axes=-1)(index)


def deviations(parts: Layout, z: jax.Array) -> dict[str, jax.Array]:
    """Errors of the active fields from z (numbers, *batch): each (*shape, *batch)."""
    errors, start = {}, 0
    for name, tolerance in parts.active.items():
        stop = start + math.prod(tolerance.shape)
        own = z[start:stop].reshape(tolerance.shape + z.shape[1:])
        start += _numbers(tolerance)
        if tolerance.batch:
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


def check_method(method: str) -> None:
    """Only plain random numbers are drawn."""
    if method != "random":
        raise ValueError(f"method = {method!r}: only 'random' is supported")


def sample(tolerances: Any, index: Any, *, seed: int, method: str = "random") -> Any:
    """The errors of unit number `index`; vmaps over `index`.

    The unit depends on seed, index and method, and on which fields are active (each draws its own
    numbers); not on the limits, which only scale the numbers, nor on chunks or devices.

    Args:
        tolerances: record or dict with a `Tolerance` or None in each field.
        index: number of the unit, 0 or more.
        seed: of the study.
        method: "random".

    Returns:
        The structure of `tolerances` with errors in place of tolerances; inactive fields are 0.0.
    """
    check_method(method)
    if is_concrete(index) and (int(index) != index or index < 0):
        raise ValueError(f"index = {index!r}: must be an integer of at least 0")
    parts = layout(tolerances)
    z = normals(parts, root_key(seed), jnp.asarray(index, jnp.uint32)[None])
    return parts.errors(deviations(parts, z[:, 0]))
