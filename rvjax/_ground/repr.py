"""Records in one short line: numbers in the unit that suits them, arrays by shape and range, tracers as they are."""

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from rvjax._ground.axes import shape_text
from rvjax.units import KNOWN, suited

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

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
