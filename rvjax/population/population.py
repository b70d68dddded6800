"""`Population`: tolerances and correlation as one pytree, which draws the errors of units.

The z of a unit are one vector of standard normal numbers: the active fields in the order of `jax.tree`
(record fields as declared, dict keys sorted), each with its elements in C order and, where no
correlation mixes the fields, the shared factors of its batch behind them.

Correlation of errors: a Gaussian copula, that is a correlation of the standard normal numbers z.
"""

import functools
import itertools
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population.tolerance import Tolerance
from rvjax.records import PyTree, Record, Scalar, field, is_concrete, record

Correlation = Mapping[tuple[str, str], float] | None
Active = Mapping[str, Tolerance]


def mixing_matrix(active: Active, correlation: Mapping[tuple[str, str], float]) -> np.ndarray:
    """Cholesky factor of the correlation of all elements' z, batches included; a ValueError names the input error."""
    matrix = batch_correlation(active)
    for pair, value in correlation.items():
        if not (isinstance(pair, tuple) and len(pair) == 2):
            raise ValueError(f"correlation: {pair!r} must be a pair of names")
        if not -1 < value < 1:
            raise ValueError(f"correlation[{pair!r}] = {value!r}: must lie between -1 and 1")
        first, second = (_elements(active, name) for name in pair)
        if set(first) & set(second):
            raise ValueError(f"correlation[{pair!r}]: shares an element with itself; within a field use `batch`")
        for i, j in itertools.product(first, second):
            matrix[i, j] = matrix[j, i] = value
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 1e-12 * len(matrix):
        raise ValueError(f"correlation: not positive definite, its smallest eigenvalue is {smallest:.3g}")
    return np.linalg.cholesky(matrix)


def batch_correlation(active: Active) -> np.ndarray:
    """Correlation matrix of the elements' z that follows from batches."""
    matrix, stop = np.eye(sum(math.prod(t.shape) for t in active.values())), 0
    for tolerance in active.values():
        size = math.prod(tolerance.shape)
        start, stop = stop, stop + size
        block = np.full((size, size), float(tolerance.batch))
        if tolerance.is_vector:  # each component has a separate shared factor
            block *= np.tile(np.eye(2), (size // 2, size // 2))
        np.fill_diagonal(block, 1.0)
        matrix[start:stop, start:stop] = block
    return matrix


def _elements(active: Active, name: object) -> list[int]:
    """Places of a field "pin_radius" or of one of its elements "disc_bore[0,1,0]" in z."""
    match = re.fullmatch(r"([^\[\]]+)(?:\[([\d,\s]+)\])?", str(name))
    field, index = match.groups() if match else (str(name), None)
    if field not in active:
        raise ValueError(f"correlation: {name!r} has no tolerance; these have: {', '.join(active)}")
    before = itertools.takewhile(lambda other: other != field, active)
    start, shape = sum(math.prod(active[other].shape) for other in before), active[field].shape
    if index is None:
        return list(range(start, start + math.prod(shape)))
    try:
        return [start + int(np.ravel_multi_index(tuple(int(i) for i in index.split(",")), shape))]
    except ValueError:
        raise ValueError(f"correlation: {name!r} is no element of shape {shape}") from None


Numbers = TypeVar("Numbers", jax.Array, np.ndarray)


class Given(NamedTuple):
    """Arguments of the response of a design with free numbers: errors of a unit, and {name: number of the design}."""

    errors: PyTree
    values: dict[str, Scalar]


@record
class Population(Record):
    """Units whose errors follow tolerances; wherever tolerances pass, a population may."""

    tolerances: PyTree = field(
        "-", "record or dict with a `Tolerance`, a constant or None in each field", kind="record"
    )
    mixing: Any = field(
        "-", "Cholesky factor of the correlation of z, batches included", shape=("numbers", "numbers"), default=None
    )
    values: Any = field("-", "numbers of the design by name, None where it has none free", kind="record", default=None)

    @classmethod
    def of(cls, tolerances: object, correlation: Correlation = None) -> Self:
        """Return a population from what users give: checked, and a constant 0 as None, which costs nothing.

        Args:
            tolerances: record or dict of tolerances, or a population.
            correlation: of pairs of fields by their names.

        Raises:
            ValueError: a leaf that is neither a `Tolerance`, nor None, nor a number; no structure at all; a
                distribution that does not fit its field; or a bad correlation.
        """
        if isinstance(tolerances, cls):
            return tolerances if not correlation else cls.of(tolerances.tolerances, correlation)
        if not isinstance(tolerances, (dict, Record)) or isinstance(tolerances, Tolerance):
            raise ValueError(f"tolerances: must be a record or a dict of tolerances, got {type(tolerances).__name__}")
        given = cls(tolerances)
        for name, leaf in given._leaves.items():
            if isinstance(leaf, Tolerance):
                leaf.law.check_field(name, leaf)
            elif not (leaf is None or isinstance(leaf, jax.core.Tracer) or is_concrete(leaf)):
                raise ValueError(f"tolerances: {name} = {leaf!r} must be a Tolerance or None")
        zeros = [n for n, leaf in given._leaves.items() if isinstance(leaf, float) and leaf == 0]
        made = cls(given._with(dict.fromkeys(zeros), absent=None))
        return made.replace(mixing=mixing_matrix(made.active, correlation)) if correlation else made

    @functools.cached_property
    def _flat(self) -> tuple[list[tuple[PyTree, PyTree]], PyTree]:
        is_leaf = lambda item: item is None or isinstance(item, Tolerance)  # noqa: E731
        return jax.tree_util.tree_flatten_with_path(self.tolerances, is_leaf=is_leaf)

    @functools.cached_property
    def _leaves(self) -> dict[str, PyTree]:
        return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in self._flat[0]}

    @functools.cached_property
    def active(self) -> dict[str, Tolerance]:
        """Fields with a tolerance by name, in the order of their random numbers."""
        return {name: leaf for name, leaf in self._leaves.items() if isinstance(leaf, Tolerance)}

    @property
    def constants(self) -> dict[str, Scalar]:
        """Fields with a constant error other than 0."""
        return {n: leaf for n, leaf in self._leaves.items() if leaf is not None and n not in self.active}

    @functools.cached_property
    def numbers_by_field(self) -> dict[str, int]:
        """Random numbers of each active field, shared factors included where no correlation mixes the fields."""
        shared: Callable[[Tolerance], int] = lambda t: 1 + t.is_vector if t.batch and self.mixing is None else 0  # noqa: E731
        return {name: math.prod(t.shape) + shared(t) for name, t in self.active.items()}

    @property
    def numbers(self) -> int:
        """Random numbers per unit."""
        return sum(self.numbers_by_field.values())

    def draw(self, key: jax.Array, index: jax.Array) -> jax.Array:
        """Return the z of units `index` (n,): (numbers, n), units last so that every number is a vector of units.

        Unit i depends on the key and i only, independent of the rest of the batch.

        Args:
            key: by `key_of`.
            index: of the units (n,).
        """
        return _normal(key, index, self.numbers)

    def deviations(self, z: jax.Array) -> dict[str, jax.Array]:
        """Errors of the active fields from z (numbers, *batch): each (*shape, *batch)."""
        errors, start = {}, 0
        if self.mixing is not None:
            z = jnp.matmul(jnp.asarray(self.mixing, z.dtype), z, precision="highest")
        for name, tolerance in self.active.items():
            stop, size = start + math.prod(tolerance.shape), self.numbers_by_field[name]
            own, shared = z[start:stop].reshape(tolerance.shape + z.shape[1:]), z[stop : start + size]
            start += size
            if len(shared):  # (1, *batch), or (2, *batch) for vectors
                lead = (1,) * (len(tolerance.shape) - 1)
                shared = shared.reshape(lead + shared.shape) if tolerance.shape else shared[0]
                shared = math.sqrt(tolerance.batch) * jnp.broadcast_to(shared, own.shape)
                own = shared + math.sqrt(1 - tolerance.batch) * own
            errors[name] = tolerance.deviate(own)
        return errors

    def errors(self, z: jax.Array) -> PyTree:
        """The error structure of units from z (numbers, *batch); inactive fields are plain 0.0 and cost nothing."""
        return self.fill(self.deviations(z))

    def fill(self, values: Mapping[str, object]) -> PyTree:
        """Return the error structure with `values` in the active fields, and with it the numbers of the design."""
        errors = self._with(values, absent=0.0)
        return errors if self.values is None else Given(errors, self.values)

    def with_half_widths(self, half_widths: Mapping[str, Scalar]) -> Self:
        """Return the same population with some half-widths changed, by name of the field."""
        return self.with_tolerances({name: self.active[name].with_half_width(t) for name, t in half_widths.items()})

    def with_tolerances(self, changed: Mapping[str, Tolerance]) -> Self:
        """Return the same population with other tolerances in some of its active fields."""
        return self.replace(tolerances=self._with(changed, absent=None))

    def _with(self, values: Mapping[str, object], *, absent: float | None) -> PyTree:
        return self._flat[1].unflatten(
            [values.get(name, absent if leaf is None else leaf) for name, leaf in self._leaves.items()]
        )

    def exchanged(self, one: Numbers, other: Numbers) -> Iterator[tuple[str, Numbers]]:
        """Units with the random numbers of one field from other units, field by field: name and z (numbers, n).

        Differences to the first units give total effects (Jansen, Comput. Phys. Commun. 117, 1999).

        Args:
            one: z of the units (numbers, n).
            other: z of the others, likewise.
        """
        library: Any = np if isinstance(one, np.ndarray) else jnp
        stop = 0
        for name, size in self.numbers_by_field.items():
            start, stop = stop, stop + size
            yield name, library.concatenate([one[:start], other[start:stop], one[stop:]])

    def by_field(self, values: Numbers) -> dict[str, Numbers]:
        """Return a vector over all active elements (n,) as arrays by field."""
        # Split, not sliced: its transpose is one concatenation, which compiles for hundreds of fields too.
        ends = np.cumsum([math.prod(t.shape) for t in self.active.values()])
        library: Any = np if isinstance(values, np.ndarray) else jnp
        pieces = library.split(values, ends[:-1]) if self.active else []
        return {name: piece.reshape(t.shape) for piece, (name, t) in zip(pieces, self.active.items())}


def drawn(population: Population, key: jax.Array, start: jax.Array | np.uint32 | int, *, count: int) -> jax.Array:
    """Return the z of units start .. start + count - 1 (numbers, count); one program for all of so many numbers.

    Args:
        population: that has these numbers.
        key: by `key_of`.
        start: number of the first unit.
        count: of the units.
    """
    return _drawn(key, start, numbers=population.numbers, count=count)


@functools.partial(jax.jit, static_argnames=("numbers", "count"))
def _drawn(key: jax.Array, start: jax.Array, *, numbers: int, count: int) -> jax.Array:
    return _normal(key, start + jnp.arange(count, dtype=jnp.uint32), numbers)


def _normal(key: jax.Array, index: jax.Array, numbers: int) -> jax.Array:
    return jax.vmap(lambda i: jax.random.normal(jax.random.fold_in(key, i), (numbers,)), out_axes=-1)(index)


def root_key(seed: int) -> jax.Array:
    """Return the key of a study."""
    try:
        return jax.random.key(operator.index(seed))
    except TypeError:
        raise ValueError(f"seed = {seed!r}: must be an integer") from None
    except OverflowError:
        raise ValueError(f"seed = {seed!r}: must be an integer of at most 64 bits, from -2**63 to 2**63 - 1") from None


TURN = 2**32
"""Units numbered with 32 bits under one key."""


def key_of(key: jax.Array, turn: int) -> jax.Array:
    """Key of the units from `turn` times 2^32 on.

    Args:
        key: of the study, by `root_key`.
        turn: 0 or more.
    """
    return jax.random.fold_in(jax.random.fold_in(key, TURN - 1), turn) if turn else key
