"""`@record`: frozen dataclasses that are JAX pytrees and declare unit, shape and meaning of every field.

Counts are static (part of the compiled program); everything else is traced. A constructor checks
concrete numbers and makes whole ones real; tracers, nested records and records rebuilt by `jax.tree` pass unchanged,
so that records can be stacked, vmapped and differentiated. So does a record of axes, flags and None (`in_axes`).
"""

import ast
import dataclasses
import inspect
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, TypeVar, dataclass_transform

import jax
import jax.export
import jax.numpy as jnp
import numpy as np

from rvjax.base import frames
from rvjax.base.fields import (
    IN_ERROR_UNIT as IN_ERROR_UNIT,
    Field,
    Scalar as Scalar,
    Shape as Shape,
    brief,
    check_axes,
    check_sign,
    concrete as concrete,
    field_table,
    fit,
    is_concrete as is_concrete,
    number,
    quantity as quantity,
)
from rvjax.base.words import unknown

if TYPE_CHECKING:
    from rvjax.base.frames import DataFrame, Dataset

Array = jax.Array
PyTree = Any  # numbers nested in a way that types cannot express
Class = TypeVar("Class", bound=type)
Metadata = Mapping[str, Any]  # of a field: unit, meaning, shape, sign, kind ..


class Design(Protocol):
    """Attributes of a design that statistics and error records need."""

    @property
    def counts(self) -> dict[str, int]:
        """Sizes of the named axes in the shapes of its errors."""

    @property
    def error_record(self) -> type:
        """Class of the record of its manufacturing errors."""

    def replace(self, **changes: object) -> Self:
        """A copy with some fields changed."""


def field(
    unit: str,
    meaning: str,
    *,
    shape: Shape = (),
    default: object = dataclasses.MISSING,
    sign: str = "any",
    kind: str = "real",
    of: str = "",
    part: str = "",
    **more: object,
) -> Any:
    """Declare a traced field of a record.

    Args:
        unit: SI unit as text, "-" for none.
        meaning: one line.
        shape: names or numbers of axes; () is a scalar. A scalar is always accepted.
        default: as in dataclasses; the default None makes the field optional.
        sign: "positive", "nonnegative" or "any"; checked on concrete numbers.
        kind: "real", "pair" (two numbers, given as a tuple or an array), "integer" (result fields),
            or "record" (a nested record).
        of: what a deviation deviates from, by its path in the design; "" where that is no number of it.
        part: of the reducer that an error belongs to.
        **more: further metadata, see `rvjax.errors.deviation`.
    """
    metadata = dict(unit=unit, meaning=meaning, shape=shape, sign=sign, kind=kind, of=of, part=part, **more)
    return dataclasses.field(default=default, metadata=metadata)


def count(meaning: str, *, minimum: int = 1, maximum: int = 1_000_000, default: object = dataclasses.MISSING) -> Any:
    """Declare a static count (teeth, pins, cranks ...), an integer of at least `minimum`.

    Args:
        meaning: one line.
        minimum: least.
        maximum: beyond which a program neither compiles in time nor fits into memory; study files raise an error.
        default: as in dataclasses.
    """
    metadata = dict(unit="-", meaning=meaning, minimum=minimum, maximum=maximum, kind="count")
    return dataclasses.field(default=default, metadata=metadata)


def text(meaning: str, *, default: object = dataclasses.MISSING, choices: tuple[str, ...] = ()) -> Any:
    """Declare a static text field, such as the names of a result's columns.

    Args:
        meaning: one line.
        default: as in dataclasses.
        choices: words, one of which a study file may give.
    """
    return dataclasses.field(default=default, metadata=dict(unit="-", meaning=meaning, kind="text", choices=choices))


class Record:
    """Base of all records; `@record` does the work."""

    __dataclass_fields__: ClassVar[dict[str, Field]]  # `@record` makes it a dataclass

    def replace(self, **changes: object) -> Self:
        """Return a copy with some fields changed, checked like a new record; axes and flags stay what they are."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        for name in changes:
            if name not in values:
                raise unknown(f"{type(self).__name__} has no field {name!r}", name, sorted(values), "; it has")
        if not (_without_numbers(self, values) and _without_numbers(self, values | changes)):
            return dataclasses.replace(self, **changes)
        made = object.__new__(type(self))
        for name, value in (values | changes).items():
            object.__setattr__(made, name, value)
        return made

    def to_pandas(self, batch: tuple[str, ...] = (), *, along: str | None = None) -> "DataFrame":
        """A `pandas.DataFrame`, SI: one row for each unit, one column for each number; units in `attrs["units"]`.

        Args:
            batch: names of the leading axes that `jax.vmap` made, such as ("unit",); they index the rows.
            along: an axis of fields, such as "angle": one row for each of its elements, with the fields that have it.

        Raises:
            ImportError: pandas is not installed.
            ValueError: axes that are not named, or `along` is none.
        """
        return frames.frame(self, batch, along)

    def to_xarray(self, batch: tuple[str, ...] = ()) -> "Dataset":
        """An `xarray.Dataset`, SI: axes such as unit, angle, disc, crank, pin; unit and meaning in the attributes.

        Args:
            batch: names of the leading axes that `jax.vmap` made, such as ("unit",).

        Raises:
            ImportError: xarray is not installed.
            ValueError: axes that are not named.
        """
        return frames.data_set(self, batch)

    def __repr__(self) -> str:
        return brief(self)

    def __post_init__(self) -> None:
        if _specifies(self):
            return
        for f in dataclasses.fields(self):
            object.__setattr__(self, f.name, _checked(type(self).__name__, f, getattr(self, f.name)))
        check_axes(self)
        self._check()

    def _check(self) -> None:
        """Checks that involve several fields; see `concrete`."""


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field, count, text))
def record(cls: Class) -> Class:
    """Turn a class whose fields are declared with `field`, `count` or `text` into a record.

    The table of fields (name, unit, shape, meaning) is appended to the class docstring.
    """
    made: Any = dataclasses.dataclass(frozen=True, eq=False, repr=False)(cls)
    fields = dataclasses.fields(made)
    static = tuple(f.name for f in fields if f.metadata["kind"] in ("count", "text"))
    traced = tuple(f.name for f in fields if f.name not in static)
    if fields:
        made.__doc__ = f"{inspect.cleandoc(cls.__doc__ or '')}\n\n{field_table(fields)}"

    numbers, others = _getter(traced), _getter(static)

    def flatten(item: object) -> tuple[tuple[PyTree, ...], tuple[object, ...]]:
        return numbers(item), others(item)

    def flatten_with_keys(item: object) -> tuple[tuple[PyTree, ...], tuple[object, ...]]:
        children, aux = flatten(item)
        return tuple((jax.tree_util.GetAttrKey(n), c) for n, c in zip(traced, children)), aux

    def unflatten(aux: tuple[object, ...], children: Iterable[object]) -> Record:
        item = object.__new__(made)  # no checks: jax.tree rebuilds records from tracers and stacks
        for name, value in (*zip(traced, children), *zip(static, aux)):
            object.__setattr__(item, name, value)
        return item

    jax.tree_util.register_pytree_with_keys(made, flatten_with_keys, unflatten, flatten)
    if "<locals>" not in made.__qualname__:  # another process finds those of modules only
        jax.export.register_pytree_node_serialization(
            made,
            serialized_name=f"{made.__module__}.{made.__qualname__}",
            serialize_auxdata=lambda aux: repr(aux).encode(),
            deserialize_auxdata=lambda blob: ast.literal_eval(blob.decode()),
        )
    return made


def _getter(names: tuple[str, ...]) -> Callable[[object], tuple[PyTree, ...]]:
    """Values of these attributes of an object, read in one call: JAX flattens records at every call of a program."""
    if not names:
        return lambda item: ()
    values: Any = operator.attrgetter(*names)
    return values if names[1:] else lambda item: (values(item),)


def signs_hold(item: Record) -> jax.Array:
    """Return whether every number of a record, and of those in it, has the sign its field declares; () bool.

    A constructor checks concrete numbers only; this function checks traced ones. NaN passes, as there.
    """
    sound = jnp.asarray(True)
    for f in dataclasses.fields(item):
        value, sign = getattr(item, f.name), f.metadata.get("sign", "any")
        if isinstance(value, Record):
            sound &= signs_hold(value)
        elif sign != "any" and value is not None:
            sound &= ~jnp.any(value <= 0 if sign == "positive" else value < 0)
    return sound


def check_shapes(parts: Iterable[Record], counts: Mapping[str, int]) -> None:
    """Raise ValueError for an array field that does not fit a design.

    Args:
        parts: records.
        counts: sizes of the named axes.

    Raises:
        ValueError: names the field, its shape and the one that fits.
    """
    for part in parts:
        for f in dataclasses.fields(part):
            if f.metadata["kind"] == "real":
                fit(f"{type(part).__name__}.{f.name}", getattr(part, f.name), f.metadata["shape"], counts)


def promote(*trees: object) -> PyTree:
    """Bring every number in `trees` to their common floating dtype.

    Python floats are weak: they take the dtype of the other arrays, or the default
    float where there are none. Returns one tree, or a tuple of trees.
    """
    leaves = jax.tree.leaves(trees)
    dtype = jnp.result_type(float, *leaves)
    cast = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), trees)
    return cast[0] if len(trees) == 1 else cast


def broadcast_fields(cls: type[Record], counts: Mapping[str, int], values: Mapping[str, object]) -> dict[str, PyTree]:
    """Fill every traced field of a record to its full shape: scalars are broadcast, absent fields take the default.

    Args:
        cls: class of the record.
        counts: sizes of the named axes.
        values: given fields, by name.

    Raises:
        ValueError: unknown field, or a shape that is neither a scalar nor the field's.
    """
    fields = {f.name: f for f in dataclasses.fields(cls)}
    for name in values:
        if name not in fields:
            raise unknown(f"{cls.__name__} has no field {name!r}", name, sorted(fields), "; it has")
    given = {np.dtype(value.dtype) for value in values.values() if hasattr(value, "dtype")}
    floats = [dtype for dtype in given if jnp.issubdtype(dtype, jnp.floating)]
    own = np.result_type(*floats) if floats else np.float64  # plain numbers take the dtype of the arrays
    filled = {}
    for name, f in fields.items():
        value = values.get(name, f.default)
        if not f.metadata["shape"]:
            filled[name] = value
            continue
        value = number(cls.__name__, f, value)
        sizes = fit(f"{cls.__name__}.{name}", value, f.metadata["shape"], counts)
        if sizes:  # a series that is not there stays 0.0
            value = np.asarray(value, own) if isinstance(value, float) else value
            library: Any = np if isinstance(value, np.ndarray) else jnp
            value = library.broadcast_to(value, sizes)
        filled[name] = value
    return filled


def _checked(owner: str, f: Field, value: PyTree) -> object:
    kind = f.metadata["kind"]
    if kind == "count":
        try:
            whole = operator.index(value)
        except TypeError:
            raise ValueError(f"{owner}.{f.name} = {value!r}: must be an integer") from None
        if isinstance(value, bool) or whole < f.metadata["minimum"]:
            raise ValueError(f"{owner}.{f.name} = {value!r}: must be an integer of at least {f.metadata['minimum']}")
        return whole
    if kind in ("text", "integer", "record") or value is None or isinstance(value, Record):
        return value  # a tolerance may replace a number, None a part
    value = number(owner, f, value)
    if is_concrete(value):
        check_sign(owner, f, value)
    return value


def _specifies(item: Record) -> bool:
    """Return true for axes in the place of numbers, as `in_axes` has them: a number that is required is None.

    Whole numbers without None are numbers of a part; `Record.replace` keeps those of a copy as they are.
    """
    values = {f.name: getattr(item, f.name) for f in dataclasses.fields(item)}
    return (
        _without_numbers(item, values)
        and any(values[f.name] is None and f.default is not None for f in _numeric(item))
        and all(isinstance(leaf, int) for leaf in jax.tree.leaves(item))
    )


def _numeric(item: Record) -> list[Field]:
    return [f for f in dataclasses.fields(item) if f.metadata["kind"] not in ("count", "text")]


def _without_numbers(item: Record, values: Mapping[str, object]) -> bool:
    fields = _numeric(item)
    return bool(fields) and all(_nonumber(values[f.name]) for f in fields)


def _nonumber(value: object) -> bool:
    if value is None or type(value) is float or isinstance(value, jax.Array):
        return value is None
    return not any(isinstance(leaf, float) or hasattr(leaf, "dtype") for leaf in jax.tree.leaves(value))
