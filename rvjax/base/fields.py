"""Fields of records: checks of their numbers, their named axes with the sizes of a design, their values in one line."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.units import KNOWN, suited

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Shape = tuple[str | int, ...]
Field = dataclasses.Field[Any]
# One number; under `jax.vmap` and in a stack of records one for each case. An ndarray of any type doubled mypy's time.
Scalar = float | jax.Array | np.ndarray[tuple[int, ...], np.dtype[np.floating]]
IN_ERROR_UNIT = "error"  # unit of a field that is measured like the error that it belongs to


def axis_sizes(shape: Shape, counts: Mapping[str, int], given: tuple[int, ...] = ()) -> tuple[int, ...]:
    """Sizes of a declared shape.

    Args:
        shape: names or numbers of axes.
        counts: sizes of the named axes; one that is not named here, the length of a series, is as long as `given` is.
        given: shape of the value; () for a scalar, which has no series.
    """
    if len(given) != len(shape):
        if not all(isinstance(axis, int) or axis in counts for axis in shape):
            return ()
        given = (0,) * len(shape)
    return tuple(axis if isinstance(axis, int) else counts.get(axis, own) for axis, own in zip(shape, given))


def shape_text(shape: Shape) -> str:
    """A declared shape as Python writes a tuple, without quotation marks."""
    return "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"


def fit(name: str, value: float | jax.Array | np.ndarray, shape: Shape, counts: Mapping[str, int]) -> tuple[int, ...]:
    """Sizes of a value that is a scalar or has the declared shape.

    Args:
        name: of the record and its field.
        value: number or array.
        shape: as declared.
        counts: of the design.

    Raises:
        ValueError: an array of another shape.
    """
    given = np.shape(value)
    sizes = axis_sizes(shape, counts, given)
    if given and given != sizes:
        expected = f"{shape_text(shape)} = {sizes} or a scalar" if sizes else "a scalar; sweep with jax.vmap"
        raise ValueError(f"{name}: shape {given} does not fit this design, expected {expected}")
    return sizes


_LONGEST = 60  # characters of a text or a tuple, beyond which its middle is left out


def field_table(fields: tuple[Field, ...]) -> str:
    """Name, unit, shape and meaning of every field, for the docstring of a record.

    Args:
        fields: of a record.
    """
    rows = [(f.name, f.metadata["unit"], shape_text(f.metadata.get("shape", ()))) for f in fields]
    widths = [max(map(len, column)) for column in zip(*rows)]
    cells = [[cell.ljust(width) for cell, width in zip(row, widths)] for row in rows]
    lines = ["  ".join([*row, f.metadata["meaning"]]) for row, f in zip(cells, fields)]
    return "Fields (name, unit, shape, meaning)::\n\n" + "\n".join("    " + line for line in lines)


def brief(record: "DataclassInstance") -> str:
    """`Name(field=value unit, ...)` of a record, without fields that are None or have their default number.

    Args:
        record: a dataclass whose fields have a `unit` in their metadata.
    """
    fields = []
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if value is not None and not (isinstance(value, float) and value == f.default):
            fields.append(f"{f.name}={value_text(value, f.metadata.get('unit', '-'))}")
    return f"{type(record).__name__}({', '.join(fields)})"


def value_text(value: object, unit: str) -> str:
    """A number with its unit, an array as its shape and range; anything else as Python writes it.

    Args:
        value: SI.
        unit: its SI unit.
    """
    array = numbers_of(value)
    if array is None:
        if isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer) and value.is_deleted():
            return f"deleted {value.shape}"
        text = repr(value)
        return text if len(text) <= _LONGEST or dataclasses.is_dataclass(value) else f"{text[:40]}...{text[-15:]}"
    if array.size == 0:
        return f"{array.shape} empty"
    if array.dtype.kind == "b":
        return str(array.item()) if array.ndim == 0 else f"{array.shape} {int(array.sum())} of {array.size} true"
    known = np.abs(array[np.isfinite(array)])
    name, size = suited(float(known.max()) if known.size else 0.0, unit) if unit in KNOWN else ("", 1.0)
    unit = f" {name}" if name else ""
    if array.ndim == 0:
        return f"{array.item() / size:.4g}{unit}" if array.dtype.kind in "fc" else str(array.item())
    lost = int(np.isnan(array).sum())
    nan = f", {lost} nan" if lost else ""
    if lost == array.size:
        return f"{array.shape} nan"
    if array.dtype.kind == "c":
        return f"{array.shape} complex, up to {np.nanmax(np.abs(array)) / size:.4g}{unit}{nan}"
    low, high = np.nanmin(array) / size, np.nanmax(array) / size
    return f"{array.shape} {low:.4g}{f' .. {high:.4g}' if high != low else ''}{unit}{nan}"


def numbers_of(value: object) -> np.ndarray | None:
    """The numbers, or None for what has none to look at: tracers, arrays elsewhere or given away, other things."""
    if isinstance(value, jax.Array):
        if isinstance(value, jax.core.Tracer) or value.is_deleted() or not value.is_fully_addressable:
            return None
        if not jnp.issubdtype(value.dtype, jnp.number) and value.dtype != bool:  # keys of random numbers
            return None
    elif isinstance(value, bool) or not isinstance(value, (int, float, complex, np.ndarray, np.generic)):
        return None
    array = np.asarray(value)
    if array.dtype.kind == "V":  # bfloat16 and its like, as NumPy sees them
        array = array.astype(float)
    return array if array.dtype.kind in "biufc" else None


def is_concrete(value: object) -> bool:
    """Return true for a number or an array whose value can be looked at now."""
    return isinstance(value, (float, int, np.ndarray, np.generic)) or (
        isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer)
    )


def concrete(*values: object) -> bool:
    """Return true if every value is a concrete number, so that a constructor may check it."""
    return all(is_concrete(v) for v in values)


def quantity(value: Scalar, unit: str) -> str:
    """Return a value with its unit, for messages.

    Args:
        value: number or array.
        unit: as text, "-" for none.
    """
    number = f"{float(value):.6g}" if np.ndim(value) == 0 else np.array2string(np.asarray(value), precision=6)
    return number if unit in ("-", IN_ERROR_UNIT) else f"{number} {unit}"


def number(owner: str, f: Field, value: object) -> Any:
    """The value of a field: Python numbers become floats (NumPy scalars would promote float32), sequences arrays.

    Args:
        owner: name of the record.
        f: its field.
        value: as given.

    Raises:
        ValueError: it is no number and no array of numbers.
    """
    if isinstance(value, (bool, str, bytes)):
        raise ValueError(f"{owner}.{f.name} = {value!r}: must be a number in {f.metadata['unit']}")
    if isinstance(value, (list, tuple)):
        if f.metadata["kind"] == "pair" and len(value) == 2:
            return tuple(number(owner, f, v) for v in value)  # stays weakly typed, unlike an array
        traced = any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(value))
        try:
            value = jnp.asarray(value) if traced else np.asarray(value)
        except (TypeError, ValueError):
            raise ValueError(f"{owner}.{f.name} = {value!r}: must be an array of numbers") from None
    given: Any = value
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    if kind == "b" or (isinstance(value, np.ndarray) and kind not in "fiu"):
        raise ValueError(f"{owner}.{f.name}: must hold numbers in {f.metadata['unit']}, got dtype {given.dtype}")
    if isinstance(value, (int, float, np.generic)) or (isinstance(value, np.ndarray) and value.ndim == 0):
        return float(given)
    if kind in ("i", "u"):  # `jax.grad` accepts no whole numbers
        return given.astype(float)
    if not hasattr(value, "dtype") or (is_concrete(value) and np.ndim(given) == 0 and np.iscomplexobj(given)):
        raise ValueError(f"{owner}.{f.name} = {value!r}: must be a number in {f.metadata['unit']}")
    return value


def check_sign(owner: str, f: Field, value: Scalar) -> None:
    """Raise an error for a concrete number without the sign that its field declares; NaN passes: a status names it.

    Args:
        owner: name of the record.
        f: its field.
        value: number or array.
    """
    sign, values = f.metadata["sign"], np.asarray(value)
    if sign != "any" and np.any(values <= 0 if sign == "positive" else values < 0):
        rule = "positive" if sign == "positive" else "zero or positive"
        raise ValueError(f"{owner}.{f.name} = {quantity(value, f.metadata['unit'])}: must be {rule}")


def check_axes(item: "DataclassInstance") -> None:
    """Check ranks, literal axes, and one size for each named axis across the fields of a record."""
    sizes: dict[str, tuple[int, str]] = {}
    owner = type(item).__name__
    for f in dataclasses.fields(item):
        value, declared = getattr(item, f.name), f.metadata.get("shape", ())
        if f.metadata["kind"] not in ("real", "pair") or not is_concrete(value) or np.ndim(value) == 0:
            continue
        shape = np.shape(value)
        if len(shape) != len(declared) or any(isinstance(axis, int) and axis != n for axis, n in zip(declared, shape)):
            also = " or a scalar" if declared else ", a scalar; sweep with jax.vmap"
            raise ValueError(f"{owner}.{f.name}: shape {shape}, expected {shape_text(declared)}{also}")
        for axis, size in zip(declared, shape):
            if isinstance(axis, str) and sizes.setdefault(axis, (size, f.name))[0] != size:
                raise ValueError(
                    f"{owner}.{f.name}: shape {shape} has {size} {axis}, {sizes[axis][1]} has {sizes[axis][0]}"
                )


def element(field: str, place: Sequence[int]) -> str:
    """Return the name of an element of an error, such as "disc_bore[0,1]"; the field itself without a place.

    Args:
        field: name.
        place: index along each axis.
    """
    return f"{field}[{','.join(map(str, place))}]" if len(place) else field


def elements(field: str, shape: tuple[int, ...]) -> list[str]:
    """Names of all elements of an error in C order.

    Args:
        field: name.
        shape: of the error.
    """
    return [element(field, place) for place in np.ndindex(shape)]


def place_of(name: str) -> tuple[str, tuple[int, ...]]:
    """Field and place of the name of an element; "disc_bore[0][1]" is read as "disc_bore[0,1]".

    Raises:
        ValueError: the name is no such name.
    """
    match = re.fullmatch(r"([\w.]+)((?:\[\d+(?:, ?\d+)*\])*)", name)
    if match is None:
        raise ValueError(f"{name!r}: must be the name of an error or of an element, such as disc_bore[0,1]")
    return match[1], tuple(map(int, re.findall(r"\d+", match[2])))
