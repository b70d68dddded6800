"""Excitation by the mesh stiffness: frequencies, phases, Fourier series, and the sector that each harmonic excites."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import unknown
from rvjax.dynamics.assembly import Lumped, roots_of_one, spring_table
from rvjax.dynamics.modes import Key, ModalSector
from rvjax.dynamics.symmetry import is_split, is_symmetric
from rvjax.records import PyTree, Scalar


class Stage(NamedTuple):
    """Excitation of a stage. A new stage is an entry of `_STAGES`, and its swing, duty and ramp in `MeshVariation`."""

    mesh: str  # its springs
    sector: str  # of the symmetry, in which its meshes work against each other
    count: Callable[[Lumped], int]
    teeth: Callable[[Lumped], int]  # that set the phases between the meshes: of the sun; pins seen from the eccentric
    frequency: Callable[[Lumped, PyTree], PyTree]  # meshes in a turn of the sun, from sun speed over output speed


_STAGES = {
    "planetary": Stage(
        "sun_planet_mesh", "planetary", lambda lumped: lumped.cranks, lambda lumped: lumped.sun_teeth,
        lambda lumped, ratio: lumped.sun_teeth * (1 - 1 / ratio),  # zs |n_s - n_o|
    ),
    "cycloid": Stage(  # pins of the ring, seen from the eccentric
        "disc_pin_mesh", "disc", lambda lumped: lumped.discs, lambda lumped: lumped.disc_teeth + 1,
        lambda lumped, ratio: (lumped.disc_teeth + 1) * lumped.disc_teeth / ratio,  # Zp |n_H|, n_H = -Zc n_o
    ),
}  # fmt: skip
STAGES = tuple(_STAGES)
MESH = {name: stage.mesh for name, stage in _STAGES.items()}


def mesh_count(lumped: Lumped, stage: str) -> int:
    """Meshes of a stage: one for each planet, or one for each disc."""
    return _STAGES[stage].count(lumped)


def mesh_frequency(lumped: Lumped, sun_speed: Scalar, stage: str) -> PyTree:
    """Angular mesh frequency with the sign of the speed, rad/s: pin ring fixed, carrier out, sun at `sun_speed`."""
    return sun_speed * _STAGES[stage].frequency(lumped, lumped.ratio)


def wave_coefficients(lumped: Lumped, stage: str, harmonics: int) -> jax.Array:
    """Cosine coefficients a_l, l = 1 .. harmonics, of one mesh stiffness over its mean (harmonics,).

    A trapezoid: swing peak to peak, duty the share of the period at the high level, ramp the width of each flank.
    """
    variation = lumped.mesh_variation
    swing, duty, ramp = (getattr(variation, f"{stage}_{name}") for name in ("swing", "duty", "ramp"))
    order = jnp.arange(1, harmonics + 1, dtype=swing.dtype)
    return 2 * swing / (order * jnp.pi) * jnp.sin(order * jnp.pi * duty) * _sinc(order * ramp)


def _sinc(x: jax.Array) -> jax.Array:
    """sin(pi x) / (pi x), smooth at 0; JAX 0.12 cannot compute its own within `jax.shard_map`."""
    square = jnp.square(jnp.pi * x)
    near = square < 1e-4
    angle = jnp.sqrt(jnp.where(near, 1, square))
    return jnp.where(near, 1 - square / 6 * (1 - square / 20), jnp.sin(angle) / angle)


def phases(lumped: Lumped, stage: str, harmonics: np.ndarray) -> np.ndarray:
    """e^{i l ph_i} of every mesh (harmonics, meshes), from integer steps: no rounding at high harmonics."""
    return roots_of_one(mesh_count(lumped, stage), np.outer(harmonics, _phase_steps(lumped, stage)))


def mesh_phases(lumped: Lumped, stage: str) -> np.ndarray:
    """ph_i = 2 pi teeth (i-1) / meshes, rad (meshes,)."""
    return 2 * np.pi * _phase_steps(lumped, stage) / mesh_count(lumped, stage)


def _phase_steps(lumped: Lumped, stage: str) -> np.ndarray:
    number = mesh_count(lumped, stage)
    return _STAGES[stage].teeth(lumped) * np.arange(number) % number


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
    of_stage, symmetric, split = _STAGES[stage], is_symmetric(lumped), is_split(lumped.cranks, lumped.discs)
    return _shares(of_stage.count(lumped), of_stage.sector, symmetric, split, of_stage.teeth(lumped), harmonics)


@lru_cache
def _shares(number: int, own: str, symmetric: bool, split: bool, teeth: int, harmonics: int) -> tuple[Share, ...]:
    by_sector: dict[Key, list[int]] = {}
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
        by_sector.setdefault(key, []).append(signed)
    return tuple(Share(key, np.array(orders)) for key, orders in by_sector.items())


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


def constants(values: object, like: jax.Array) -> jax.Array:
    """Return a constant array as complex numbers of the precision of `like`."""
    return jnp.asarray(values, np.result_type(like.dtype, np.complex64))


def in_phase(highest: int, members: int) -> list[int]:
    """Harmonics 1 .. highest that all members meet at the same time: multiples of their number."""
    return list(range(members, highest + 1, members))
