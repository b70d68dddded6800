"""The single-stage cycloidal drive as bodies and contacts: discs on the eccentrics of one shaft, pins of the carrier.

common      carrier: Rw alpha, then x, y if it floats; shaft: x, y where `shaft_support` holds it, else it is fixed
joints      output pins in the holes of the discs; a hole is a contact along the eccentricity, linear like a flank
bearings    eccentric bearings, then the supports of the shaft

Contact laws: an output pin lies in a hollow, the hole, 1/R* = 1/rw - 1/(rw + e + clearance/2), nominal. Near conformity
the theory of line contact ends.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.elementary import nonnegative
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import Contact
from rvjax.geometry import material as of_contact, squared_pressure
from rvjax.loaded import laws
from rvjax.loaded.balance import Forces
from rvjax.loaded.case import Case, NamedForces, Read, admitted, unchecked, under
from rvjax.loaded.cycloidal_gaps import Drive, drive_at, drive_gaps, drive_rows, gaps_of_turn
from rvjax.loaded.geometry import flank_rounding
from rvjax.loaded.system import Bearings, Group, Joints, Layout, Pins, System
from rvjax.records import Scalar, check_shapes


class Law(NamedTuple):
    """Numbers of the contact law of one group of contacts, one for each or one for all."""

    compliance: jax.Array  # c of hertz, k of linear, C of palmgren
    level: jax.Array | None  # A of hertz
    radius: jax.Array  # R*, m


def drive_laws(law: str, design: CycloidalReducer, at: Drive) -> tuple[Law, Law]:
    """Numbers of the contact laws of pins, (d, p), and holes, (d, n) or shorter, at an angle.

    Args:
        law: "hertz", "linear" or "palmgren".
        design: radii and contact are read.
        at: directions of the angle.
    """
    contact, output, cycloid = design.contact, design.output, design.cycloid
    assert contact is not None
    pin, sleeve = jnp.asarray(cycloid.pin_radius), jnp.asarray(output.pin_radius)
    room = jnp.asarray(cycloid.eccentricity + output.hole_clearance / 2)  # hole radius less pin radius
    hole = sleeve * room / (sleeve + room)
    return (
        _law(law, contact, flank_rounding(cycloid, at.ring), pin, contact.pin_stiffness, contact.pin_support),
        _law(law, contact, hole, sleeve, output.pin_stiffness, output.pin_support),
    )


def _law(
    law: str, contact: Contact, rounding: jax.Array, pin: jax.Array, stiffness: Scalar | None, support: Scalar | None
) -> Law:
    """Eqs. 8 to 10; `rounding` is r^2/R* of a pin of radius r."""
    plane = laws.plane(contact)
    radius = pin * pin / rounding
    soft = None if support is None else jnp.atleast_2d(1 / jnp.asarray(support))  # a row for every disc
    if law == "linear":
        assert stiffness is not None
        free = jnp.asarray(1 / jnp.asarray(stiffness))
        return Law(1 / (free if soft is None else free + soft), None, radius)
    if law == "palmgren":
        return Law(3.81 * plane**0.9 / contact.face_width**0.8, None, radius)
    c = plane / contact.face_width
    level = laws.level(contact, rounding)
    return Law(c, level if soft is None else level + soft / c, radius)


NEAR = 0.3
"""Half width of a contact over the radius of its output pin from which on the theory of line contact fails."""
fit = gaps_of_turn  # clearance without load
PASSINGS = 6
"""Highest multiple of the passing of the holes whose amplitude is above 1 % of the first."""


def layout(design: CycloidalReducer, errors: CycloidalErrors, contact: str, carrier: str, sun: str) -> Layout:
    """Counts and methods.

    Args:
        design: with stiffness and contact.
        errors: of its parts.
        contact: contact law of pins and holes.
        carrier: "fixed" or "floating".
        sun: "fixed".
    """
    springs = design.stiffness
    assert springs is not None and design.contact is not None
    if sun != "fixed":
        raise ValueError(
            f"sun = {sun!r}: a single-stage drive has none; a floating shaft is CycloidalStiffness.shaft_support"
        )
    for part in (design.contact, design.output):
        if contact == "linear" and part.pin_stiffness is None:
            raise ValueError(f"{type(part).__name__}.pin_stiffness = None: contact = 'linear' needs it")
    check_shapes([design.cycloid, design.output, springs, design.contact], design.counts)
    held = springs.shaft_support is not None
    holes = Group(discs=True, links=False, common=True, each=design.output.count, law=contact)
    eccentrics = Group(discs=True, links=False, common=held)
    supports = Group(discs=False, links=False, common=True)
    return Layout(
        discs=design.cycloid.disc_count,
        pins=design.cycloid.pin_count,
        law=contact,
        links=0,
        common=(3 if carrier == "floating" else 1, *([2] if held else [])),
        joints=(holes,),
        bearings=(eccentrics, *([supports] if held else [])),
    )


def passing(design: CycloidalReducer) -> tuple[int, ...]:
    """Orders of the holes that the eccentrics pass, and of the pins of the ring: zp and zc turns in one of the output.

    Args:
        design: counts are read.
    """
    pins, several = design.cycloid.pin_count, range(1, PASSINGS + 1)
    each = (design.output.count * pins, design.cycloid.disc_teeth * pins)
    return tuple(n * order for order in each for n in several)


def admit(layout: Layout, design: CycloidalReducer, errors: CycloidalErrors, torque: Scalar, angle: Scalar) -> Read:
    """Check the numbers that are read.

    Args:
        layout: counts and methods.
        design: the drive.
        errors: of its parts.
        torque: of the discs on the output, () N m.
        angle: of the shaft, () rad.
    """
    read = _only_read(layout, design)
    if not layout.input_moves:
        errors = errors.replace(support_clearance=0.0)
    return admitted(read, errors, torque, angle, partial(_positive, layout), partial(_pushes_away, layout))


def _only_read(layout: Layout, design: CycloidalReducer) -> CycloidalReducer:
    """The design, with constants in place of what the model does not read."""
    springs, contact, output = design.stiffness, design.contact, design.output
    assert springs is not None and contact is not None
    of_pins = {
        "pin_stiffness": layout.law == "linear",
        "pin_support": layout.law != "palmgren",
    }
    unread = dict.fromkeys(name for name, read in of_pins.items() if not read)
    return design.replace(
        cycloid=unchecked(design.cycloid, disc_phase=0.0, force_angle=0.0, shortening=None),
        output=output.replace(**unread),
        contact=contact.replace(**unread),
        stiffness=springs if layout.carrier_floats else springs.replace(output_support=0.0),
        bearings=None,
        friction=None,
    )


def _positive(layout: Layout, design: CycloidalReducer) -> jax.Array:
    """Lengths and stiffnesses that must be positive; the eccentricity is checked separately."""
    cycloid, output, springs, contact = design.cycloid, design.output, design.stiffness, design.contact
    assert springs is not None and contact is not None
    positive = [
        *(cycloid.pin_circle_radius, cycloid.pin_radius, output.circle_radius, output.pin_radius),
        *(cycloid.eccentricity + output.hole_clearance / 2, springs.eccentric_bearing),
        *of_contact(contact),
    ]
    maybe = (springs.shaft_support, *(n for part in (contact, output) for n in (part.pin_stiffness, part.pin_support)))
    positive += [number for number in maybe if number is not None]
    return jnp.concatenate([jnp.ravel(jnp.asarray(value)) for value in positive])


def _pushes_away(layout: Layout, design: CycloidalReducer) -> jax.Array:
    """True if a spring of negative stiffness holds a floating carrier."""
    assert design.stiffness is not None
    return jnp.any(jnp.asarray(design.stiffness.output_support) < 0)


def _most(design: CycloidalReducer, radius: jax.Array) -> jax.Array:
    """Force of an output pin beyond which the surfaces nearly conform, N."""
    contact = design.contact
    assert contact is not None
    plane = laws.plane(contact) / contact.face_width  # a^2 = 4 F R* plane
    return jnp.asarray((NEAR * design.output.pin_radius) ** 2 / (4 * radius * plane))


def _pressure(design: CycloidalReducer, radius: jax.Array) -> jax.Array:
    """Largest Hertzian pressure over the square root of a force; Eq. 11."""
    contact = design.contact
    assert contact is not None
    return jnp.sqrt(squared_pressure(contact) / radius)


def prepare(layout: Layout, read: Read, input_angle: jax.Array) -> Case:
    """Geometry, springs and gaps of one input angle; `load` is that of 1 N m on the output.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        input_angle: of the shaft, () rad.
    """
    design, errors = read.design, read.errors
    springs, radius = design.stiffness, jnp.asarray(design.output.circle_radius)
    at = drive_at(design, read.eccentricity, input_angle)
    dtype = at.ring.size.dtype
    one = jnp.where(read.eccentricity > 0, 1.0, 2.0).astype(dtype)  # see `rv.prepare`
    gaps, rows = drive_gaps(design, errors, at, read.eccentricity), drive_rows(design, layout, at)
    pins, law = drive_laws(layout.law, design, at)
    every = (layout.discs, design.output.count)
    holes = Law(*(None if x is None else jnp.broadcast_to(x, every).ravel() for x in law))  # type: ignore[arg-type]
    eccentrics = jnp.broadcast_to(springs.eccentric_bearing, (layout.discs,)).astype(dtype)
    held = jnp.zeros((layout.unknowns,), dtype)
    if layout.carrier_floats:
        held = held.at[layout.carried + 1 : layout.carried + 3].set(springs.output_support)
    stiffness, centres = [eccentrics], [gaps.centres]
    play = [jnp.full((layout.discs,), nonnegative(errors.bearing_clearance), dtype)]
    if layout.input_moves:
        stiffness.append(jnp.asarray(springs.shaft_support, dtype).reshape(1))
        centres.append(jnp.zeros((1, 2), dtype))
        play.append(jnp.asarray(nonnegative(errors.support_clearance), dtype).reshape(1))
    level = pins.level
    system = System(
        pins=Pins(
            rows=rows.pins / one,
            gap=gaps.pins / one,
            compliance=jnp.ravel(pins.compliance),
            level=None if level is None else jnp.broadcast_to(level, gaps.pins.shape) / one,
        ),
        joints=Joints(
            rows=rows.holes.reshape(-1, layout.unknowns) / one,
            gap=gaps.holes.ravel() / one,
            compliance=holes.compliance.astype(dtype),
            level=holes.level,
            lever=-at.swing.sine.ravel(),  # sin(b - a) > 0: a positive torque on the carrier presses
        ),
        bearings=Bearings(
            rows=rows.bearings / one,
            gap=jnp.concatenate(centres) / one,
            stiffness=jnp.concatenate(stiffness),
            clearance=jnp.concatenate(play),
        ),
        centring=1e-8 * jnp.mean(eccentrics),
        support=held,
        load=design.carrier_factor / radius,
    )
    pressure = jnp.broadcast_to(_pressure(design, pins.radius), gaps.pins.shape)
    b = at.ring.eccentric
    return Case(
        system=system,
        lever=at.ring.lever / one,
        pressure=pressure,
        length=radius / design.carrier_factor,
        hole_pressure=_pressure(design, holes.radius).reshape(layout.discs, -1),
        eccentric=jnp.stack([b.cosine, b.sine], axis=-1),
        size=at.ring.size / one,
        most=_most(design, holes.radius) if layout.law == "hertz" else None,
    )


def named_forces(layout: Layout, read: Read, case: Case, forces: Forces) -> NamedForces:
    """Forces of shaft, output pins and carrier.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: of the angle.
        forces: of all contacts.
    """
    assert case.eccentric is not None and case.hole_pressure is not None
    x, y = case.eccentric.T
    disc_bearing = -forces.bearings[: layout.discs, None]
    holes = forces.joints.reshape(layout.discs, -1)
    along = jnp.sum(holes, axis=1)
    return NamedForces(
        disc_bearing=disc_bearing,
        support_bearing=-jnp.sum(disc_bearing, axis=0),
        gear=None,
        input_torque=read.eccentricity * jnp.sum(x * disc_bearing[:, 0, 1] - y * disc_bearing[:, 0, 0]),
        output_pins=holes,
        output_pressure=under(case.hole_pressure, holes),
        output_bearing=jnp.stack([jnp.sum(along * x), jnp.sum(along * y)]),
    )
