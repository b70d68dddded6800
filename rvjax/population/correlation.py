"""Correlation of errors: a Gaussian copula, that is a correlation of the standard normal numbers z."""

import itertools
import math
import re
from collections.abc import Mapping

import numpy as np

from rvjax.population.tolerance import Tolerance

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
    """Correlation matrix of the elements' z that comes from batches alone."""
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
