"""Excitation of the reducer: mesh frequencies, mesh phases and the Fourier series of the mesh stiffness."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.words import choose
from rvjax.dynamics.assembly import Lumped, circle
from rvjax.records import PyTree, Scalar


class Stage(NamedTuple):
    """Excitation of a stage. A new stage is an entry of `_STAGES`, and its swing, duty and ramp in `MeshVariation`."""

    mesh: str  # its springs
    sector: str  # of the symmetry, in which its meshes work against each other
    count: Callable[[Lumped], int]
    teeth: Callable[[Lumped], int]  # that set the phases between the meshes
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
SECTOR = {name: stage.sector for name, stage in _STAGES.items()}


def check_stage(stage: str) -> None:
    """Raise ValueError for an unknown stage.

    Raises:
        ValueError: names the stages.
    """
    choose("stage", stage, STAGES)


def mesh_count(lumped: Lumped, stage: str) -> int:
    """Meshes of a stage: one for each planet, or one for each disc."""
    return _STAGES[stage].count(lumped)


def mesh_teeth(lumped: Lumped, stage: str) -> int:
    """Teeth that set the phases between the meshes: of the sun; pins of the ring, seen from the eccentric."""
    return _STAGES[stage].teeth(lumped)


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
    cosine, sine = circle(mesh_count(lumped, stage))
    steps = np.outer(harmonics, _phase_steps(lumped, stage)) % mesh_count(lumped, stage)
    return cosine[steps] + 1j * sine[steps]


def mesh_phases(lumped: Lumped, stage: str) -> np.ndarray:
    """ph_i = 2 pi teeth (i-1) / meshes, rad (meshes,)."""
    return 2 * np.pi * _phase_steps(lumped, stage) / mesh_count(lumped, stage)


def _phase_steps(lumped: Lumped, stage: str) -> np.ndarray:
    number = mesh_count(lumped, stage)
    return mesh_teeth(lumped, stage) * np.arange(number) % number
