"""Figures of a design without errors, from closed forms: RV reducers and single-stage drives; outputs of studies."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.catalogue import checked
from rvjax.cycloidal import CycloidalReducer, Reducer
from rvjax.designs import InvoluteStage, RVReducer, check_teeth, expect
from rvjax.errors import RVErrors
from rvjax.geometry.ring import Figures as Figures, harmless, material, of_ring, of_steel, root, squared_pressure
from rvjax.outputs import Description, Output, Reading, Solved, condition
from rvjax.records import Array, PyTree, Scalar, promote
from rvjax.status import Status, admit


def of_drive(design: CycloidalReducer, output_torque: Scalar) -> Figures:
    """Figures of a single-stage drive, as `figures` returns them.

    Args:
        design: cycloid stage, output pins and contact are read.
        output_torque: () N m.
    """
    return _drive_figures((design.cycloid, design.output, design.contact, design.carrier_factor * output_torque))


@functools.partial(jax.jit, inline=True)
def _drive_figures(read: PyTree) -> Figures:
    """Of the cycloid stage, output pins, contact and torque of the carrier."""
    cycloid, output, contact, torque = read
    unread: dict[str, None] = dict(pin_stiffness=None, pin_support=None)
    cycloid, output = cycloid.replace(shortening=None, force_angle=0.0, disc_phase=0.0), output.replace(**unread)
    read = promote((cycloid, output, contact and contact.replace(**unread), torque))
    cycloid, output, contact, torque = read
    k1 = cycloid.shortening_coefficient
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    positive = [cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.pin_radius, *material(contact)]
    positive += [output.circle_radius, output.pin_radius, cycloid.eccentricity + output.hole_clearance / 2]
    possible = (k1 > 0) & (k1 < 1) & jnp.all(jnp.stack(positive) > 0)
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (cycloid, output, contact, torque), gate = admit(read, _harmless_drive(read), *checks)

    each = jnp.abs(torque) / cycloid.disc_count  # of the carrier on one disc
    values, pressure, info = of_ring(cycloid, contact, each, gate)
    e, circle, pin = cycloid.eccentricity, output.circle_radius, output.pin_radius
    room = e + output.hole_clearance / 2  # hole radius less pin radius
    hole = pin + room
    across = each / (e * cycloid.disc_teeth)
    along = 2 / jnp.pi * across * _ring_share(cycloid.shortening_coefficient) - 4 * each / (jnp.pi * circle)  # Eq. 16
    own: dict[str, Any] = dict(
        hole_gap=2 * (circle * math.sin(math.pi / output.count) - hole),
        hole_wall=cycloid.pin_circle_radius - cycloid.pin_radius - e - circle - hole,
        eccentric_force=root(across**2 + along**2),
        hole_pressure=None,
    )
    if contact is not None:
        force = each / circle * largest_share(output.count)
        own["hole_pressure"] = root(force * squared_pressure(contact) * room / (pin * hole))  # 1/R* = 1/rw - 1/rh
    own, _ = gate.close(own)
    return Figures(**values, **own, pin_pressure=pressure, info=info, crank_room=None, contact_ratio=None, mass=None)


def _ring_share(k1: Array) -> Array:
    """I of Eq. 16: force of the ring along the eccentric, over 2 T/(pi e zc)."""
    return (1 - (1 - k1**2) / (2 * k1) * jnp.log((1 + k1) / (1 - k1))) / k1


@functools.cache
def largest_share(pins: int) -> float:
    """Largest force of an output pin over a turn, rigid discs, over T/Rw: 4/n for an even number. Eq. 17.

    Args:
        pins: output pins, n.
    """
    place, step = 0.0, 2 * math.pi / pins / 4096
    for grid in (step * np.arange(4096), step * np.linspace(-1, 1, 4097)):
        positive = np.maximum(np.sin(place + grid[:, None] + 2 * np.pi * np.arange(pins) / pins), 0)
        shares = positive.max(axis=1) / np.sum(positive**2, axis=1)
        place += grid[np.argmax(shares)]
    return float(shares.max())


def _harmless_drive(read: object) -> object:
    """A drive that exists, in the place of one that does not."""
    cycloid, output, contact, torque = jax.tree.map(jnp.ones_like, read)
    contact = contact and of_steel(contact)
    return harmless(cycloid), output.replace(circle_radius=0.5, pin_radius=0.1, hole_clearance=0.01), contact, torque


@checked
def figures(design: Reducer, output_torque: Scalar = 0.0) -> Figures:
    """Figures of a design without errors.

    Curvature is that of the flank as ground: an equidistant modification moves it along its normal, a shift
    modification grinds it on another pin circle, harmonics add their own. The pressure is that of rigid discs: the
    force of a pin in proportion to its lever about the disc centre, line contact of pin and flank, the largest value
    while the cranks pass a pitch. Output pins of a single-stage drive likewise.

    Args:
        design: involute stage, cycloid stage, cranks, output pins, contact and inertia are read.
        output_torque: () N m; its sign does not count.

    Returns:
        Figures. All are NaN with status NONFINITE (a number that is read is NaN or inf) or INVALID_GEOMETRY (K1 outside
        (0, 1), a length or modulus that must be positive is not, or holes not larger than their pins). With UNDERCUT
        only the pressure of the pins is NaN.

    Raises:
        ValueError: another kind of design, or other than one tooth of difference between ring and disc.
    """
    expect(design, "geometry.figures", *_KINDS)
    return _KINDS[type(design)](design, output_torque)


def _of_rv(design: RVReducer, output_torque: Scalar) -> Figures:
    cycloid = design.cycloid
    check_teeth(cycloid)
    contact = design.contact and design.contact.replace(pin_stiffness=None, pin_support=None)
    read = design.involute, cycloid, design.cranks.replace(bearing_stiffness=None), contact, _masses(design)
    return _rv_figures((*read, output_torque))


_KINDS: dict[type, Callable[[Any, Scalar], Figures]] = {RVReducer: _of_rv, CycloidalReducer: of_drive}
"""Figures by the class of the design."""


def _masses(design: RVReducer) -> list[object] | None:
    """Masses of all rotating parts."""
    inertia, cranks = design.inertia, (design.cranks.count,)
    if inertia is None:
        return None
    sizes = {"sun": (), "planet": cranks, "crank": cranks, "disc": (design.cycloid.disc_count,), "output": ()}
    return [jnp.broadcast_to(getattr(inertia, f"{part}_mass"), size) for part, size in sizes.items()]


@partial(jax.jit, inline=True)
def _rv_figures(read: PyTree) -> Figures:
    read = promote(read)
    gears, cycloid, cranks, contact, masses, torque = read
    k1, circle = cycloid.shortening_coefficient, cranks.circle_radius
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    positive = [cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.pin_radius, circle]
    positive += [gears.module, gears.centre_distance, gears.sun_base_radius, gears.planet_base_radius]
    positive += material(contact)
    possible = (k1 > 0) & (k1 < 1) & jnp.all(jnp.stack(positive) > 0) & (jnp.cos(gears.pressure_angle) > 0)
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (gears, cycloid, cranks, contact, masses, torque), gate = admit(read, _harmless_rv(read), *checks)

    pins, circle = cycloid.pin_count, cranks.circle_radius
    ring, pin = cycloid.pin_circle_radius, cycloid.pin_radius
    share = cycloid.disc_teeth / (cycloid.disc_count * (pins + gears.sun_teeth / gears.planet_teeth))
    values, pressure, info = of_ring(cycloid, contact, jnp.abs(torque) * share, gate)
    own, _ = gate.close(
        dict(
            crank_room=ring - pin - cycloid.eccentricity - circle,
            contact_ratio=contact_ratio(gears),
            mass=None if masses is None else sum(map(jnp.sum, masses)),
        )
    )
    return Figures(**values, **own, pin_pressure=pressure, info=info)


def _harmless_rv(read: object) -> object:
    """A reducer that exists, in the place of one that does not."""
    gears, cycloid, _, contact, *_ = ones = jax.tree.map(jnp.ones_like, read)
    gears = gears.replace(sun_base_radius=0.3, planet_base_radius=0.6, pressure_angle=0.35)
    return gears, harmless(cycloid), ones[2], contact and of_steel(contact), *ones[4:]


def contact_ratio(gears: InvoluteStage) -> Array:
    """Transverse contact ratio of sun and planet at their centre distance, tips of standard height."""
    bases = jnp.stack([jnp.asarray(gears.sun_base_radius), jnp.asarray(gears.planet_base_radius)])
    tips = gears.module * jnp.asarray(np.array([gears.sun_teeth, gears.planet_teeth]) / 2 + 1, bases.dtype)
    square = tips**2 - bases**2
    path = jnp.sum(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0))
    # a0 sin(alpha_w), with a0 cos(alpha_w) the sum of the base radii
    line = gears.centre_distance**2 - jnp.sum(bases) ** 2
    path -= jnp.where(line > 0, jnp.sqrt(jnp.where(line > 0, line, 1)), 0)
    return path / (gears.module * jnp.pi * jnp.cos(gears.pressure_angle))


@dataclass(frozen=True)
class GeometryConditions:
    """Load of the nominal contact pressure."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)


@dataclass(frozen=True)
class DriveGeometryConditions:
    """Load of the nominal contact pressures of a single-stage drive."""

    output_torque: float = condition(0.0, "torque of the discs on the output", unit="N m", torque=True)


def of_design(design: RVReducer, errors: RVErrors, conditions: Any) -> Figures:
    """Figures of the design; errors are not read."""
    return figures(design, conditions.output_torque)


def _taking(name: str) -> Callable[..., Solved]:
    def take(values: Figures, design: RVReducer, conditions: object) -> Solved:
        status = jnp.asarray(values.info.status)
        if name not in ("pin_pressure", "hole_pressure"):  # the other figures hold for an undercut flank too
            status = jnp.where(status == Status.UNDERCUT, Status.CONVERGED, status)
        return getattr(values, name), status

    return take


def _needing(part: str) -> Callable[[Any, Any], None]:
    def refuse(design: RVReducer, conditions: object) -> None:
        check_teeth(design.cycloid, "design.cycloid")
        if part and getattr(design, part) is None:
            raise ValueError(f"design.{part} is missing: the required response reads it")

    return refuse


def _figure(unit: str, meaning: str, name: str, read_in: str | None = None, part: str = "") -> Output:
    return Output(unit, meaning, Reading((of_design,), _taking(name)), read_in=read_in, refuse=_needing(part))


DESCRIPTION = Description(
    name="geometry",
    design=RVReducer,
    conditions=GeometryConditions,
    outputs={
        "shortening": _figure("-", "shortening coefficient K1", "shortening"),
        "convex_radius": _figure("m", "least radius of the convex flank, <= 0: undercut", "convex_radius", "mm"),
        "pin_gap": _figure("m", "gap between neighbouring pins", "pin_gap", "mm"),
        "crank_room": _figure("m", "from the crank axes to the roots of the disc teeth", "crank_room", "mm"),
        "flank_slope": _figure("-", "largest slope of the harmonics of the profile modification", "flank_slope"),
        "envelope_diameter": _figure("m", "diameter over the pins of the ring", "envelope_diameter", "mm"),
        "contact_ratio": _figure("-", "transverse contact ratio of sun and planet, no profile shift", "contact_ratio"),
        "envelope_volume": _figure("m3", "over the pins, along all discs", "envelope_volume", part="contact"),
        "nominal_pin_pressure": _figure(
            "Pa", "largest contact pressure of a pin, rigid discs, no errors", "pin_pressure", part="contact"
        ),
        "mass": _figure("kg", "of all parts that turn", "mass", part="inertia"),
    },
    unknown="housing, pins and bearings in the mass; elastic sharing of the nominal pin pressure",
)

_SHARED = ("shortening", "convex_radius", "pin_gap", "flank_slope", "envelope_diameter", "envelope_volume")
OTHERS = (
    Description(
        name="geometry",
        design=CycloidalReducer,
        conditions=DriveGeometryConditions,
        outputs={name: DESCRIPTION.outputs[name] for name in (*_SHARED, "nominal_pin_pressure")}
        | {
            "nominal_hole_pressure": _figure(
                "Pa",
                "largest contact pressure of an output pin, rigid discs, no errors",
                "hole_pressure",
                None,
                "contact",
            ),
            "hole_gap": _figure("m", "gap between neighbouring holes of a disc", "hole_gap", "mm"),
            "hole_wall": _figure("m", "from the holes to the roots of the disc teeth", "hole_wall", "mm"),
            "eccentric_force": _figure("N", "mean force of an eccentric bearing, rigid discs", "eccentric_force"),
        },
        unknown="elastic sharing and clearances in the nominal contact pressures and the force of an eccentric bearing",
    ),
)
"""Of single-stage drives."""
