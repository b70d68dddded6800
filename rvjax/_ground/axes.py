"""Named axes of fields, and the sizes that they have in a design."""

from collections.abc import Mapping

import jax
import numpy as np

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
