"""Contribution of each field to the explained observation, along the straight path from zero error.

c_F = integral_0^1 (df/de_F)(t e) e_F dt, so that the contributions sum to f(e) - f(0); in a group of the observation
the share of F is <c_F, sum c>/<sum c, sum c>, weighed by 1/sd^2.
"""

import numpy as np

from rvjax.identify.problem import Problem

NODES = 8


def contributions(problem: Problem, values: np.ndarray) -> np.ndarray:
    """Contribution of each field (m, fields) to the observation of element values (p,)."""
    points, weights = np.polynomial.legendre.leggauss(NODES)
    slopes = problem.evaluate((points[:, None] + 1) / 2 * values, plain=True)[1]
    each = np.tensordot(weights / 2, slopes, axes=1) * values
    fields = np.array(problem.elements.fields)
    return np.stack([each[:, fields == name].sum(axis=1) for name in problem.elements.population.active], axis=1)


def shares(problem: Problem, values: np.ndarray) -> dict[str, dict[str, float]]:
    """{group: {field: share}} of element values (p,); NaN where nothing is explained or the model fails on the way."""
    fields = problem.elements.population.active
    found = contributions(problem, values)
    whitened = found / problem.sd[:, None]
    made = {}
    for group, places in problem.layout.groups.items():
        part = whitened[places]
        total = part.sum(axis=1)
        square = total @ total
        share = (part.T @ total) / square if square > 0 else np.full(len(fields), np.nan)
        made[group] = {name: float(number) for name, number in zip(fields, share)}
    return made
