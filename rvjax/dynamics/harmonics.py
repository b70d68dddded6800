"""Sector that each mesh harmonic excites, and the rows of several sectors put back in order."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import unknown
from rvjax.dynamics.assembly import Lumped, spring_table
from rvjax.dynamics.excitation import SECTOR, mesh_count, mesh_teeth
from rvjax.dynamics.modal import Key, ModalSector
from rvjax.dynamics.symmetry import is_split, is_symmetric
from rvjax.records import PyTree

OUTPUTS = ("output.x", "output.y", "output.rotation")


def output_indices(lumped: Lumped, outputs: Sequence[str]) -> np.ndarray:
    """Positions of coordinates given by name.

    Raises:
        ValueError: a name that does not exist.
    """
    labels = spring_table(lumped.cranks, lumped.discs).labels
    for name in outputs:
        if name not in labels:
            raise unknown(f"unknown output {name!r}", name, labels, "; there are")
    return np.array([labels.index(name) for name in outputs], int)


class Share(NamedTuple):
    """Harmonics that excite one sector; negative: the conjugate sector, solved as harmonic -l."""

    key: Key
    harmonics: np.ndarray


def shares(lumped: Lumped, stage: str, harmonics: int) -> tuple[Share, ...]:
    """Sector that each mesh harmonic excites: label k = l teeth mod members of the stage; else the whole model."""
    symmetric = is_symmetric(lumped)
    split = is_split(lumped.cranks, lumped.discs)
    return _shares(mesh_count(lumped, stage), SECTOR[stage], symmetric, split, mesh_teeth(lumped, stage), harmonics)


@lru_cache
def _shares(number: int, own: str, symmetric: bool, split: bool, teeth: int, harmonics: int) -> tuple[Share, ...]:
    found: dict[Key, list[int]] = {}
    for order in range(1, harmonics + 1):
        k = order * teeth % number
        if not symmetric:
            key, signed = ("coupled", 0), order
        elif k == 0:
            key, signed = ("rotational", 0), order
        elif k in (1, number - 1):
            key, signed = ("translational", 0), order if k == 1 or not split else -order
        else:
            key, signed = (own, min(k, number - k)), order if 2 * k <= number else -order
        found.setdefault(key, []).append(signed)
    return tuple(Share(key, np.array(orders)) for key, orders in found.items())


class Solved(NamedTuple):
    """Result of a method of solution."""

    amplitude: jax.Array  # (H, k) complex
    mean: jax.Array  # (k,)
    distance: jax.Array  # (H,)
    singular: jax.Array  # () bool
    residual: jax.Array  # ()


def unfold(orders: np.ndarray, rows: jax.Array) -> jax.Array:
    """Rows of harmonic -l turned into those of l."""
    negative = (orders < 0).reshape(-1, *(1,) * (rows.ndim - 1))
    return jnp.where(negative, rows.conj(), rows)


def in_order(orders: Sequence[np.ndarray], rows: Sequence[jax.Array], harmonics: int, absent: jax.Array) -> jax.Array:
    """Rows of harmonics 1 .. H from those of several shares; `absent` fills what no share delivers."""
    present = [int(order) for part in orders for order in np.abs(part)]
    missing = [order for order in range(1, harmonics + 1) if order not in present]
    rows = [*rows, jnp.broadcast_to(absent, (len(missing), *absent.shape))]
    return jnp.concatenate(rows)[np.argsort(np.array(present + missing, int))]


def resonance_distance(modal: ModalSector, frequency: jax.Array) -> jax.Array:
    """min |w / w_r - 1| over the modes of a sector, for angular frequencies (L,)."""
    square = jnp.diag(modal.stiffness).real  # on fixed eigenvectors its derivative is that of the eigenvalue
    moving = (square > 0)[None, :]
    ratio = jnp.abs(frequency)[:, None] * jax.lax.rsqrt(jnp.where(moving, square[None, :], 1))
    return jnp.min(jnp.where(moving, jnp.abs(ratio - 1), jnp.inf), axis=1)


def constants(values: PyTree, like: jax.Array) -> jax.Array:
    """Return a constant array as complex numbers of the precision of `like`."""
    return jnp.asarray(values, np.result_type(like.dtype, np.complex64))
