"""Points of failure that like parts have in common: one found point, exchanged, turned and mirrored.

The response is evaluated at each image; no symmetry of the failing region is assumed.
"""

import math
from collections.abc import Iterator

import numpy as np

from rvjax.population import Population
from rvjax.roots import bisect
from rvjax.tolerances.failure.form import Found, LimitState

_SAME = 0.01  # failure begins at an image within this of where it begins at the point, relative: parts of one kind
_ALIKE = 0.25  # the same for parts that differ a little
_HALVINGS = 6
_MATTERS = 0.3  # of the largest number of a point
_FEW = 8  # numbers that matter; with more, a change of one sign is no separate failure mode


def orbit(state: LimitState, point: np.ndarray, converged: bool) -> Found:
    """Images of a point (numbers,) at which failure begins as well.

    Images: the largest number exchanged with each other one, few large numbers of the other sign one at a time, fields
    turned along axes of one length together (pins round a ring), and each of these through the origin. Where one
    number alone makes the point, the parts may differ a little: failure then begins elsewhere on the ray to the image.
    """
    matter = np.flatnonzero(np.abs(point) > _MATTERS * np.abs(point).max())
    images = np.stack(list(_images(state.units.population, point, matter)), axis=1)
    images = np.unique(np.concatenate([images, -images], axis=1), axis=1)
    exact = state.fails((1 - _SAME) * images) != state.fails((1 + _SAME) * images)
    edges = images[:, :0] if len(matter) > 1 else _begins(state, images[:, ~exact])
    points = np.concatenate([images[:, exact], edges], axis=1)
    return Found(points, np.arange(points.shape[1]) < (exact.sum() if converged else 0))


def _begins(state: LimitState, images: np.ndarray) -> np.ndarray:
    """Points where failure begins on the rays to images (numbers, n), where these are near the images."""
    near, far = np.full(images.shape[1], 1 - _ALIKE), np.full(images.shape[1], 1 + _ALIKE)
    inside = state.fails(near * images)
    begins = inside != state.fails(far * images)
    images, near, far, inside = images[:, begins], near[begins], far[begins], inside[begins]
    return images * bisect(lambda at: state.fails(at * images) == inside, near, far, steps=_HALVINGS)[1]


def _images(population: Population, point: np.ndarray, matter: np.ndarray) -> Iterator[np.ndarray]:
    largest = int(np.argmax(np.abs(point)))
    for other in range(len(point)):
        image = point.copy()
        image[[largest, other]] = image[[other, largest]]
        yield image
    for number in matter if len(matter) <= _FEW else []:
        image = point.copy()
        image[number] *= -1
        yield image
    lengths = {length for tolerance in population.active.values() for length in tolerance.shape}
    for length in sorted(lengths - {1}):
        for turn in range(1, length):
            yield _turned(population, point, length, turn)


def _turned(population: Population, point: np.ndarray, length: int, turn: int) -> np.ndarray:
    """Every field with an axis of this length, turned along it."""
    image, start = point.copy(), 0
    for name, tolerance in population.active.items():
        stop, size = start + math.prod(tolerance.shape), population.numbers_by_field[name]
        if length in tolerance.shape:
            own = point[start:stop].reshape(tolerance.shape)
            image[start:stop] = np.roll(own, turn, axis=tolerance.shape.index(length)).ravel()
        start += size
    return image
