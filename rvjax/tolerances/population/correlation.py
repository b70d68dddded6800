"""Correlation of errors: a Gaussian copula, that is a correlation of the standard normal numbers z."""

import itertools
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from rvjax.tolerances.population.layout import Correlated, Layout, layout

Correlation = Mapping[tuple[str, str], float] | None


def correlated(tolerances: Any, correlation: Correlation) -> Any:
    """Tolerances that carry a correlation; unchanged where there is none.

    Raises:
        ValueError: an unknown field or element, a value outside -1 .. 1, or a matrix that is not
            positive definite (named by its smallest eigenvalue).
    """
    parts = layout(tolerances)
    if not correlation:
        return parts.replace({})
    matrix = _batches(parts)
    for pair, value in correlation.items():
        if not (isinstance(pair, tuple) and len(pair) == 2):
            raise ValueError(f"correlation: {pair!r} must be a pair of names")
        if not -1 < value < 1:
            raise ValueError(f"correlation[{pair!r}] = {value!r}: must lie between -1 and 1")
        first, second = (_elements(parts, name) for name in pair)
        if set(first) & set(second):
            raise ValueError(f"correlation[{pair!r}]: shares an element with itself; within a field use `batch`")
        for i, j in itertools.product(first, second):
            matrix[i, j] = matrix[j, i] = value
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 1e-12 * len(matrix):
        raise ValueError(f"correlation: not positive definite, its smallest eigenvalue is {smallest:.3g}")
    return Correlated(parts.replace({}), np.linalg.cholesky(matrix))


def z_correlation(parts: Layout) -> np.ndarray:
    """Correlation matrix of the elements' z, batches included."""
    return _batches(parts) if parts.mixing is None else np.asarray(parts.mixing @ parts.mixing.T)


def _batches(parts: Layout) -> np.ndarray:
    sizes = [math.prod(t.shape) for t in parts.active.values()]
    matrix, start = np.eye(sum(sizes)), 0
    for tolerance, size in zip(parts.active.values(), sizes):
        block = np.full((size, size), float(tolerance.batch))
        if tolerance.is_vector:  # each component has a shared factor of its own
            block *= np.tile(np.eye(2), (size // 2, size // 2))
        np.fill_diagonal(block, 1.0)
        matrix[start : start + size, start : start + size] = block
        start += size
    return matrix


def _elements(parts: Layout, name: Any) -> list[int]:
    """Places of a field "pin_radius" or of one of its elements "disc_bore[0,1,0]" in z."""
    match = re.fullmatch(r"([^\[\]]+)(?:\[([\d,\s]+)\])?", str(name))
    field, index = match.groups() if match else (name, None)
    if field not in parts.active:
        raise ValueError(f"correlation: {name!r} has no tolerance; these have: {', '.join(parts.active)}")
    start = 0
    for other, tolerance in parts.active.items():
        size = math.prod(tolerance.shape)
        if other == field:
            break
        start += size
    if index is None:
        return list(range(start, start + size))
    try:
        return [start + int(np.ravel_multi_index(tuple(int(i) for i in index.split(",")), tolerance.shape))]
    except ValueError:
        raise ValueError(f"correlation: {name!r} is no element of shape {tolerance.shape}") from None
