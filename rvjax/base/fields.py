"""Fields of records: their named axes with the sizes of a design, and their values in one short line."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from rvjax.units import KNOWN, suited

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Shape = tuple[str | int, ...]


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


def field_table(fields: tuple[dataclasses.Field[Any], ...]) -> str:
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
        if not jax.numpy.issubdtype(value.dtype, jax.numpy.number) and value.dtype != bool:  # keys of random numbers
            return None
    elif isinstance(value, bool) or not isinstance(value, (int, float, complex, np.ndarray, np.generic)):
        return None
    array = np.asarray(value)
    if array.dtype.kind == "V":  # bfloat16 and its like, as NumPy sees them
        array = array.astype(float)
    return array if array.dtype.kind in "biufc" else None
