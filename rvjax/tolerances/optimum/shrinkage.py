"""Slopes of many fields from few units: a model of them that has little noise reduces theirs.

Each of many fields moves the response of a unit little, next to all others together. A sampled slope is then mostly
noise, which costs the optimum a part of about fields/units. For a linear response of normal errors the slope of a field
is proportional to the square of its derivative times its standard deviation. The units give that product almost without
noise. Other responses differ from it. The estimate of James and Stein (1961) weighs model and sample by what is seen:
the squared distances between them, in variances of the sample, sum up to the number of fields where the model is right.
"""

import numpy as np

MANY = 30  # fields; with fewer the noise costs less than 0.05 % of the optimum


def total_of_many(parts: np.ndarray, model: np.ndarray) -> np.ndarray:
    """Sums over units (j,), moved towards a model of them as far as their scatter allows.

    Args:
        parts: of independent units (n, j).
        model: (j,) proportional to what is expected; its factor is fitted.
    """
    total, variance = parts.sum(axis=0), len(parts) * parts.var(axis=0)
    known = variance > 0
    weights = np.where(known, 1 / np.where(known, variance, 1.0), 0.0)
    model = model * (weights @ (model * total)) / max(weights @ model**2, np.finfo(float).tiny)
    apart = weights @ (total - model) ** 2
    kept = max(0.0, 1 - (known.sum() - 3) / apart) if apart > 0 else 0.0
    return np.where(known, model + kept * (total - model), total)
