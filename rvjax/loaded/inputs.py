"""Numbers of a design and of its errors that the model reads, and the check that such a reducer can exist."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from rvjax import status
from rvjax._jax.elementary import LARGEST_ANGLE
from rvjax.base.fields import fit
from rvjax.designs import CycloidStage
from rvjax.errors import Errors, read_by
from rvjax.geometry import least_convex_radius
from rvjax.records import Record, Scalar, promote
from rvjax.status import Gate, Status

Part = TypeVar("Part", bound=Record)
SUPPORTS = ("fixed", "floating")


class Read(NamedTuple):
    """Numbers that the model reads; harmless ones where they were not finite or not possible."""

    design: Any
    errors: Any
    eccentricity: Any  # nominal and error
    torque: Any
    angle: Any
    gate: Gate


def check_teeth(cycloid: CycloidStage) -> None:
    """Raise an error for another tooth difference than one.

    Args:
        cycloid: its counts.
    """
    if cycloid.pin_count != cycloid.disc_teeth + 1:
        raise ValueError(
            f"CycloidStage.pin_count = {cycloid.pin_count}: must be disc_teeth + 1 = {cycloid.disc_teeth + 1}"
        )


def check_shapes(parts: Sequence[Record], counts: Mapping[str, int]) -> None:
    """Raise an error for an array field that does not fit.

    Args:
        parts: records.
        counts: sizes of the named axes.
    """
    for part in parts:
        for f in dataclasses.fields(part):
            if f.metadata["kind"] == "real":
                fit(f"{type(part).__name__}.{f.name}", getattr(part, f.name), f.metadata["shape"], counts)


def admitted(
    design: Record,
    errors: Errors,
    torque: Scalar,
    angle: Scalar,
    positive: Callable[[object], jax.Array],
    negative: Callable[[object], jax.Array],
) -> Read:
    """Check the numbers that are read.

    Design, eccentricity, errors, torque and angle are checked and replaced separately, so that all units of a batch
    over errors keep one geometry.

    Args:
        design: the reducer, with a cycloid stage and constants in place of what the model does not read.
        errors: of its parts.
        torque: () N m.
        angle: () rad.
        positive: (k,) numbers of the design that must be positive, without the eccentricity.
        negative: () true where a spring that may be zero is negative.
    """
    read = read_by(errors, "loaded")
    unread = {f.name: 0.0 for f in dataclasses.fields(errors) if f.name not in read}
    used, parts, torque, angle = promote(design, errors.replace(**unread), torque, angle)
    e, added = used.cycloid.eccentricity, parts.eccentricity
    parts = parts.replace(eccentricity=jnp.zeros_like(added))

    sizes = positive(used)
    spare = jax.tree_util.tree_map_with_path(lambda path, _: _HARMLESS.get(path[-1].name, 1.0), used)
    used, of_design = status.admit(
        used,
        spare,
        (~_finite(used) | jnp.any((sizes > 0) & (sizes < 1 / _top(sizes))), Status.NONFINITE),
        (jnp.any(~(sizes > 0)) | negative(used), Status.INVALID_GEOMETRY),
    )
    refused = [*of_design.refused]
    admitted = []
    turns = jnp.where(jnp.abs(angle) < LARGEST_ANGLE, angle, jnp.nan)
    for number in (parts, torque, turns, (e, added)):
        number, gate = status.admit(number, 0, (~_finite(number), Status.NONFINITE))
        admitted.append(number)
        refused += gate.refused
    parts, torque, angle, (e, added) = admitted

    cycloid = used.cycloid
    e = e + added
    largest = cycloid.pin_circle_radius / cycloid.pin_count  # K1 = 1
    proper = (e > 0) & (e < largest)
    e = jnp.where(of_design.good & proper, e, 0.6 * largest)
    convex = cycloid.pin_circle_radius * least_convex_radius(e / largest, pins=cycloid.pin_count)
    convex = jax.lax.stop_gradient(convex)  # for a check only, no part of the result
    undercut = of_design.good & (cycloid.pin_radius >= convex)
    cycloid = cycloid.replace(pin_radius=jnp.where(undercut, 0.1 * convex, cycloid.pin_radius))
    gate = Gate((*refused, (~proper, Status.INVALID_GEOMETRY), (undercut, Status.UNDERCUT)))
    return Read(used.replace(cycloid=cycloid), parts, e, torque, angle, gate)


_HARMLESS = {
    "pressure_angle": 0.35,
    "poisson_ratio": 0.3,
    "pin_poisson_ratio": 0.3,
    "pin_radius": 1e-6,
    "equidistant_modification": 0.0,
    "shift_modification": 0.0,
    "profile_modification": 0.0,
}
"""Replacements of numbers of a design that the computation cannot use; any other becomes 1."""


def unchecked(part: Part, **changes: object) -> Part:
    """Copy of a record without its checks: inconsistent numbers give a status here, no error.

    Args:
        part: a record.
        **changes: fields by name.
    """
    copy = jax.tree.map(lambda leaf: leaf, part)
    for name, value in changes.items():
        object.__setattr__(copy, name, value)
    return copy


def _top(number: jax.Array) -> float:
    """Beyond it, or nearer to zero than one over it, squares and products leave the arithmetic."""
    return float(jnp.finfo(number.dtype).max) ** (1 / 3)


def _finite(tree: object) -> jax.Array:
    finite = jnp.asarray(True)
    for leaf in jax.tree.leaves(tree):
        finite &= jnp.all(jnp.abs(leaf) < _top(leaf))  # false for NaN
    return finite
