"""Inputs of the model from a design and its errors, and the check that such a reducer can exist."""

import dataclasses
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import status
from rvjax._ground.axes import fit
from rvjax._ground.choices import choose
from rvjax._jax.elementary import LARGEST_ANGLE
from rvjax.designs import Contact, CycloidStage, RVReducer, expect
from rvjax.errors import RVErrors, read_by
from rvjax.geometry import least_convex_radius
from rvjax.loaded import laws
from rvjax.loaded.system import Layout
from rvjax.records import PyTree, Record, Scalar, promote
from rvjax.status import Gate, Status

Part = TypeVar("Part", bound=Record)
SUPPORTS = ("fixed", "floating")


class Read(NamedTuple):
    """Numbers that the model reads; harmless ones where they were not finite or not possible."""

    design: RVReducer
    errors: RVErrors
    eccentricity: Any  # nominal and error
    torque: Any
    angle: Any
    gate: Gate


def check_input(design: RVReducer, errors: RVErrors, contact: str, carrier: str, sun: str) -> Layout:
    """The layout of this call.

    Raises:
        ValueError: see `equilibrium`.
    """
    expect(design, "loaded", RVReducer)
    for name, value, known in (
        ("contact", contact, laws.CONTACTS),
        ("carrier", carrier, SUPPORTS),
        ("sun", sun, SUPPORTS),
    ):
        choose(name, value, known)
    for name in ("stiffness", "contact"):
        if getattr(design, name) is None:
            raise ValueError(f"RVReducer.{name} = None: the loaded equilibrium needs it")
    cycloid = design.cycloid
    check_teeth(cycloid)
    assert design.stiffness is not None and design.contact is not None
    parts: list[Record] = [design.involute, cycloid, design.cranks, design.stiffness, design.contact, errors]
    for part in parts:
        for f in dataclasses.fields(part):
            if f.metadata["kind"] == "real":
                fit(f"{type(part).__name__}.{f.name}", getattr(part, f.name), f.metadata["shape"], design.counts)
    return Layout(cycloid.disc_count, design.cranks.count, cycloid.pin_count, contact, carrier, sun)


def check_teeth(cycloid: CycloidStage) -> None:
    """Raise an error for another tooth difference than one.

    Args:
        cycloid: its counts.
    """
    if cycloid.pin_count != cycloid.disc_teeth + 1:
        raise ValueError(
            f"CycloidStage.pin_count = {cycloid.pin_count}: must be disc_teeth + 1 = {cycloid.disc_teeth + 1}"
        )


def admit(layout: Layout, design: RVReducer, errors: RVErrors, torque: Scalar, angle: Scalar) -> Read:
    """Check the numbers that are read.

    Design, eccentricity, errors, torque and angle are checked and replaced separately, so that all units of a batch
    over errors keep one geometry.

    Args:
        layout: counts and methods.
        design: the reducer.
        errors: of its parts.
        torque: () N m.
        angle: () rad.
    """
    own = read_by(errors, "loaded")
    unread = {f.name: 0.0 for f in dataclasses.fields(errors) if f.name not in own}
    used, parts, torque, angle = promote(_only_read(layout, design), errors.replace(**unread), torque, angle)
    e, added = used.cycloid.eccentricity, parts.eccentricity
    parts = parts.replace(eccentricity=jnp.zeros_like(added))

    positive = _positive(layout, used)
    spare = jax.tree_util.tree_map_with_path(lambda path, _: _HARMLESS.get(path[-1].name, 1.0), used)
    used, of_design = status.admit(
        used,
        spare,
        (~_finite(used) | jnp.any((positive > 0) & (positive < 1 / _top(positive))), Status.NONFINITE),
        (jnp.any(~(positive > 0)) | _pushes_away(layout, used), Status.INVALID_GEOMETRY),
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
    "pin_radius": 1e-6,
    "equidistant_modification": 0.0,
    "shift_modification": 0.0,
    "profile_modification": 0.0,
}
"""Replacements of numbers of a design that the computation cannot use; any other becomes 1."""


def _only_read(layout: Layout, design: RVReducer) -> RVReducer:
    """The design, with constants in place of what this model does not read."""
    springs, contact = design.stiffness, design.contact
    assert springs is not None and contact is not None
    unread = {"output_torsion"}
    if layout.carrier == "fixed":
        unread |= {"output_support"}
    if layout.sun == "fixed":
        unread |= {"sun_support", "sun_torsion"}
    if layout.law != "linear" or contact.pin_stiffness is not None:
        unread |= {"disc_pin_mesh"}
    contact = contact.replace(
        pin_stiffness=contact.pin_stiffness if layout.law == "linear" else None,
        pin_support=contact.pin_support if _reads_support(layout, contact) else None,
    )
    return design.replace(
        involute=design.involute.replace(module=1.0, centre_distance=1.0, sun_radius=1.0),
        cycloid=unchecked(design.cycloid, disc_phase=0.0, shortening=None),
        cranks=design.cranks.replace(bearing_stiffness=None),
        inertia=None,
        mesh_variation=None,
        bearings=None,
        damping=None,
        stiffness=springs.replace(**dict.fromkeys(unread, 1.0)),
        contact=contact,
    )


def _reads_support(layout: Layout, contact: Contact) -> bool:
    """True if the contact law reads the support of the pins; the linear mesh stiffness contains its mean."""
    if layout.law == "linear" and contact.pin_stiffness is None:
        return contact.pin_support is not None and np.ndim(contact.pin_support) > 0
    return layout.law != "palmgren"


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


def pin_compliance(layout: Layout, design: RVReducer) -> jax.Array:
    """Coefficient of the contact law (Eqs. 17-19): c of hertz (), k of linear () or (pins,), C of Palmgren ().

    Args:
        layout: counts and methods.
        design: the reducer.
    """
    contact, springs = design.contact, design.stiffness
    assert contact is not None and springs is not None
    if layout.law == "linear":
        soft = None if contact.pin_support is None else 1 / contact.pin_support
        if contact.pin_stiffness is not None:
            return jnp.asarray(contact.pin_stiffness if soft is None else 1 / (1 / contact.pin_stiffness + soft))
        cosine = jnp.cos(design.cycloid.force_angle)
        whole = 4 * cosine * cosine * jnp.mean(springs.disc_pin_mesh) / layout.pins
        return whole if soft is None else 1 / (1 / whole + (soft - jnp.mean(soft)))
    plane = jnp.asarray(2 * (1 - contact.poisson_ratio**2) / (jnp.pi * contact.young_modulus))
    if layout.law == "palmgren":
        return 3.81 * plane**0.9 / contact.face_width**0.8
    return plane / contact.face_width


def mesh_stiffness(design: RVReducer) -> jax.Array:
    """Stiffness of gear, planet seat and its torsion in series at the line of action, () or (c,) N/m. Eq. 8."""
    springs, base = design.stiffness, jnp.asarray(design.involute.planet_base_radius)
    assert springs is not None
    torsion = base * base / springs.planet_crank_torsion
    return 1 / (torsion + 1 / springs.sun_planet_mesh + 1 / springs.planet_crank_bending)


def _top(number: jax.Array) -> float:
    """Beyond it, or nearer to zero than one over it, squares and products leave the arithmetic."""
    return float(jnp.finfo(number.dtype).max) ** (1 / 3)


def _finite(tree: PyTree) -> jax.Array:
    finite = jnp.asarray(True)
    for leaf in jax.tree.leaves(tree):
        finite &= jnp.all(jnp.abs(leaf) < _top(leaf))  # false for NaN
    return finite


def _pushes_away(layout: Layout, design: RVReducer) -> jax.Array:
    """True if a spring of negative stiffness holds a floating part; zero is allowed, because its neighbours hold it."""
    springs = design.stiffness
    assert springs is not None
    held: list[Scalar] = [jnp.zeros_like(springs.output_support)]
    if layout.carrier == "floating":
        held.append(springs.output_support)
    if layout.sun == "floating":
        held += [springs.sun_support, springs.sun_torsion]
    return jnp.any(jnp.stack([jnp.asarray(spring) for spring in held]) < 0)


def _positive(layout: Layout, design: RVReducer) -> jax.Array:
    """Lengths and stiffnesses that must be positive; the eccentricity is checked separately."""
    involute, cycloid, springs, contact = design.involute, design.cycloid, design.stiffness, design.contact
    assert springs is not None and contact is not None
    positive = [
        *(cycloid.pin_circle_radius, cycloid.pin_radius, design.cranks.circle_radius),
        *(involute.sun_base_radius, involute.planet_base_radius, jnp.cos(involute.pressure_angle)),
        *(springs.turning_arm_bearing, springs.support_bearing, springs.sun_planet_mesh),
        *(springs.planet_crank_bending, springs.planet_crank_torsion),
        *(contact.young_modulus, contact.face_width, 1 - contact.poisson_ratio**2),
    ]
    if layout.law == "linear":
        positive.append(pin_compliance(layout, design))
    if contact.pin_support is not None:
        positive.append(contact.pin_support)
    return jnp.concatenate([jnp.ravel(value) for value in positive])
