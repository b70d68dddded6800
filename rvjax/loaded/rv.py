"""The RV reducer as bodies and contacts: discs on cranks, which planets turn and a carrier holds.

links       cranks, each with its planet: x, y, r_b rho
common      carrier: R alpha, then x, y if it floats; sun: x, y, r_s rotation if it floats
joints      flanks of sun and planets, driving and coasting flank of each
bearings    arm bearings, disc by disc, then seats of the cranks in the carrier
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import nonnegative
from rvjax.designs import Contact, RVReducer
from rvjax.errors import RVErrors
from rvjax.geometry import material as of_contact, squared_pressure
from rvjax.loaded import laws
from rvjax.loaded.balance import Forces
from rvjax.loaded.case import Case, NamedForces, Read, admitted, unchecked
from rvjax.loaded.geometry import Geometry, Turn, flank_rounding, flanks, geometry, no_orders, pin_depths, turn
from rvjax.loaded.system import Bearings, Group, Joints, Layout, Pins, System
from rvjax.records import Scalar, check_shapes

FLANKS = Group(discs=False, links=True, common=True, each=2)
ARMS = Group(discs=True, links=True, common=False)
SEATS = Group(discs=False, links=True, common=True)
fit = flanks  # clearance without load: cranks and first stage are ideal
passing = no_orders


def layout(design: RVReducer, errors: RVErrors, contact: str, carrier: str, sun: str) -> Layout:
    """Counts and methods.

    Args:
        design: with stiffness and contact.
        errors: of its parts.
        contact: contact law of the pins.
        carrier: "fixed" or "floating".
        sun: "fixed" or "floating".
    """
    assert design.stiffness is not None and design.contact is not None
    cycloid, cranks = design.cycloid, design.cranks
    check_shapes([design.involute, cycloid, cranks, design.stiffness, design.contact], design.counts)
    return Layout(
        discs=cycloid.disc_count,
        pins=cycloid.pin_count,
        law=contact,
        links=cranks.count,
        common=(3 if carrier == "floating" else 1, *([3] if sun == "floating" else [])),
        joints=(FLANKS,),
        bearings=(ARMS, SEATS),
    )


def admit(layout: Layout, design: RVReducer, errors: RVErrors, torque: Scalar, angle: Scalar) -> Read:
    """Check the numbers that are read.

    Args:
        layout: counts and methods.
        design: the reducer.
        errors: of its parts.
        torque: () N m.
        angle: () rad.
    """
    read = _only_read(layout, design)
    return admitted(read, errors, torque, angle, partial(_positive, layout), partial(_pushes_away, layout))


def _only_read(layout: Layout, design: RVReducer) -> RVReducer:
    """The design, with constants in place of what this model does not read."""
    springs, contact = design.stiffness, design.contact
    assert springs is not None and contact is not None
    unread = {"output_torsion"}
    if not layout.carrier_floats:
        unread |= {"output_support"}
    if not layout.input_moves:
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
        friction=None,
        damping=None,
        stiffness=springs.replace(**dict.fromkeys(unread, 1.0)),
        contact=contact,
    )


def _reads_support(layout: Layout, contact: Contact) -> bool:
    """True if the contact law reads the support of the pins; the linear mesh stiffness contains its mean."""
    if layout.law == "linear" and contact.pin_stiffness is None:
        return contact.pin_support is not None and np.ndim(contact.pin_support) > 0
    return layout.law != "palmgren"


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
    if layout.law == "palmgren":
        return 3.81 * laws.plane(contact) ** 0.9 / contact.face_width**0.8
    return laws.plane(contact) / contact.face_width


def mesh_stiffness(design: RVReducer) -> jax.Array:
    """Stiffness of gear, planet seat and its torsion in series at the line of action, () or (c,) N/m. Eq. 8."""
    springs, base = design.stiffness, jnp.asarray(design.involute.planet_base_radius)
    assert springs is not None
    torsion = base * base / springs.planet_crank_torsion
    return 1 / (torsion + 1 / springs.sun_planet_mesh + 1 / springs.planet_crank_bending)


def _pushes_away(layout: Layout, design: RVReducer) -> jax.Array:
    """True if a spring of negative stiffness holds a floating part; zero is allowed, because its neighbours hold it."""
    springs = design.stiffness
    assert springs is not None
    held: list[Scalar] = [jnp.zeros_like(springs.output_support)]
    if layout.carrier_floats:
        held.append(springs.output_support)
    if layout.input_moves:
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
        *of_contact(contact),
    ]
    if layout.law == "linear":
        positive.append(pin_compliance(layout, design))
    if contact.pin_support is not None:
        positive.append(contact.pin_support)
    return jnp.concatenate([jnp.ravel(value) for value in positive])


def prepare(layout: Layout, read: Read, input_angle: jax.Array) -> Case:
    """Geometry, springs and gaps of one input angle; `load` is that of 1 N m.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        input_angle: () rad.
    """
    design, errors, e = read.design, read.errors, read.eccentricity
    involute, cycloid, cranks = design.involute, design.cycloid, design.cranks
    contact, springs = design.contact, design.stiffness
    assert contact is not None and springs is not None
    th = input_angle / design.ratio
    at, sun = geometry(cycloid, e, th), turn(input_angle - th)
    dtype = at.size.dtype
    radial, tangential = (jnp.asarray(x, dtype)[:, None] for x in _directions(cranks.count))
    side = jnp.asarray([1.0, -1.0], dtype)[None, :, None]
    flank = jnp.sin(involute.pressure_angle) * radial + jnp.cos(involute.pressure_angle) * side * tangential
    swing = e / involute.planet_base_radius * jnp.stack([-at.eccentric.sine, at.eccentric.cosine], axis=-1)
    yielding = pin_compliance(layout, design)
    rounding = flank_rounding(cycloid, at)
    level = None
    if layout.law == "hertz":
        level = laws.level(contact, rounding)
        if contact.pin_support is not None:
            level = level + 1 / (yielding * jnp.atleast_1d(contact.pin_support)[None])
    arms = jnp.broadcast_to(springs.turning_arm_bearing, (layout.discs, layout.links))
    held: list[Scalar] = [0.0] * (layout.carried + 1)
    if layout.carrier_floats:
        held += [springs.output_support] * 2
    if layout.input_moves:
        held += [springs.sun_support] * 2 + [springs.sun_torsion / involute.sun_base_radius**2]
    play = [nonnegative(x) for x in (errors.bearing_clearance, errors.support_clearance)]
    # XLA copies cheap operations into every consumer, but computes a division once. Half of the program was copies.
    one, one_of_errors = jnp.where(e > 0, 1.0, 2.0).astype(dtype), jnp.where(read.gate.good, 1.0, 2.0).astype(dtype)
    seats = -_placed(jnp.broadcast_to(errors.carrier_bore, (cranks.count, 2)), cranks.count)
    system = System(
        pins=Pins(
            rows=jnp.stack([-at.normal[0], -at.normal[1], at.lever / cranks.circle_radius]) / one,
            gap=pin_depths(cycloid, errors, at) / one_of_errors,
            compliance=jnp.atleast_1d(yielding),
            level=None if level is None else level / one,
        ),
        joints=Joints(
            rows=_gear_rows(layout, flank).reshape(-1, layout.unknowns) / one,
            gap=_gear(cranks.count, errors, at, sun, flank).ravel() / one_of_errors,
            compliance=jnp.repeat(jnp.broadcast_to(mesh_stiffness(design), (layout.links,)), 2),
            level=None,
            lever=jnp.tile(jnp.asarray([-1.0, 1.0], dtype), layout.links),
        ),
        bearings=Bearings(
            rows=_bearing_rows(layout, swing) / one,
            gap=jnp.concatenate([_arm(design, errors, at, e).reshape(-1, 2), seats]) / one_of_errors,
            stiffness=jnp.append(arms, jnp.broadcast_to(springs.support_bearing, (layout.links,))),
            clearance=jnp.concatenate([jnp.full((n,), x) for n, x in zip((arms.size, layout.links), play)]),
        ),
        centring=1e-8 * jnp.mean(arms),
        support=jnp.stack([jnp.asarray(x, dtype) for x in held]),
        load=1 / cranks.circle_radius,
    )
    # rr^2 / R* is `rounding`, so that 1 / R* = rounding / rr^2.
    pressure = jnp.sqrt(squared_pressure(contact) * rounding) / cycloid.pin_radius
    return Case(system, at.lever / one, pressure, jnp.asarray(cranks.circle_radius), size=at.size / one)


def named_forces(layout: Layout, read: Read, case: Case, forces: Forces) -> NamedForces:
    """Forces of the cranks and of the first stage.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: of the angle.
        forces: of all contacts.
    """
    (_, arms), (_, seats) = layout.parts(layout.bearings)
    driving, coasting = forces.joints.reshape(-1, 2).T
    gear = driving - coasting
    return NamedForces(
        disc_bearing=-forces.bearings[arms].reshape(layout.discs, layout.links, 2),
        support_bearing=forces.bearings[seats],
        gear=gear,
        input_torque=jnp.sum(gear) * read.design.involute.sun_base_radius,
    )


def _directions(cranks: int) -> tuple[np.ndarray, np.ndarray]:
    """Radial and tangential unit vectors of the crank axes, (c, 2): crank i is at pi + 2 pi i / c. Eq. 3.

    Args:
        cranks: c.
    """
    angle = np.pi + 2 * np.pi * np.arange(cranks) / cranks
    radial = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return radial, np.stack([-radial[:, 1], radial[:, 0]], axis=1)


def _placed(bore: jax.Array, cranks: int) -> jax.Array:
    """[radial, tangential] at each crank (..., c, 2) as x, y."""
    radial, tangential = (
        jnp.asarray(x, bore.dtype).reshape((1,) * (bore.ndim - 2) + (cranks, 2)) for x in _directions(cranks)
    )
    return bore[..., :1] * radial + bore[..., 1:] * tangential


def _gear(cranks: int, errors: RVErrors, at: Geometry, sun: Turn, flank: jax.Array) -> jax.Array:
    """Eq. 14: half the backlash on either flank, and the runouts, which turn with their parts."""
    thinner = (errors.base_tangent_upper + errors.base_tangent_lower) / 4
    sun_x, sun_y = sun.of(*jnp.broadcast_to(errors.sun_runout, (2,)))
    planet = _placed(jnp.broadcast_to(errors.planet_runout, (cranks, 2)), cranks)
    planet_x, planet_y = at.crank.of(planet[:, 0], planet[:, 1])
    return jnp.asarray(
        thinner + flank[:, :, 0] * (sun_x - planet_x)[:, None] + flank[:, :, 1] * (sun_y - planet_y)[:, None]
    )


def _arm(design: RVReducer, errors: RVErrors, at: Geometry, eccentricity: Scalar) -> jax.Array:
    """Eq. 15: bore of the disc less the journal that the crank carries there, x, y."""
    discs, cranks = design.cycloid.disc_count, design.cranks.count
    bore = _placed(jnp.broadcast_to(errors.disc_bore, (discs, cranks, 2)), cranks)
    longer = jnp.broadcast_to(errors.crank_eccentricity, (discs, cranks))
    ahead = jnp.asarray(eccentricity * jnp.broadcast_to(errors.crank_phase, (cranks,))[None])
    bx, by = at.eccentric.cosine[:, None], at.eccentric.sine[:, None]
    return bore - jnp.stack([longer * bx - ahead * by, longer * by + ahead * bx], axis=-1)


def _bearing_rows(layout: Layout, swing: jax.Array) -> jax.Array:
    """Displacement of every bearing per unknown, (b, 2, n); Eqs. 11 and 12.

    Args:
        layout: counts and methods.
        swing: (d, 2) motion of a journal per r_b rho: e / r_b J u(b_k).
    """
    discs, cranks = layout.discs, layout.links
    arm = np.zeros((discs, cranks, 2, layout.unknowns))
    seat = np.zeros((cranks, 2, layout.unknowns))
    rotation = np.zeros((1, cranks, 1, layout.unknowns))
    tangential = _directions(cranks)[1]
    for i in range(cranks):
        crank = layout.link(i)
        rotation[0, i, 0, crank + 2] = 1
        seat[i, :, crank : crank + 2] = np.eye(2)
        seat[i, :, layout.carried] = -tangential[i]
        if layout.carrier_floats:
            seat[i, :, layout.carried + 1 : layout.carried + 3] = -np.eye(2)
        for k in range(discs):
            arm[k, i, :, 3 * k : 3 * k + 2] = np.eye(2)
            arm[k, i, :, 3 * k + 2] = tangential[i]
            arm[k, i, :, crank : crank + 2] = -np.eye(2)
    swung = jnp.asarray(arm, swing.dtype) - jnp.asarray(rotation, swing.dtype) * swing[:, None, :, None]
    return jnp.concatenate([swung.reshape(-1, 2, layout.unknowns), jnp.asarray(seat, swing.dtype)])


def _gear_rows(layout: Layout, flank: jax.Array) -> jax.Array:
    """Depth of both flanks of every planet per unknown, (c, 2, n); Eq. 10.

    Args:
        layout: counts and methods.
        flank: (c, 2, 2) [driving, coasting] flank, normal x, y.
    """
    spin = np.asarray([1.0, -1.0])
    along = np.zeros((2, layout.links, 1, layout.unknowns))  # per x and y of the normal
    turned = np.zeros((layout.links, 2, layout.unknowns))
    for i in range(layout.links):
        turned[i, :, layout.link(i) + 2] = spin
        for a in range(2):
            along[a, i, 0, layout.link(i) + a] = -1
            if layout.input_moves:
                along[a, i, 0, a - 3] = 1
    if layout.input_moves:
        turned[:, :, -1] = spin
    x, y = (jnp.asarray(part, flank.dtype) for part in along)
    return jnp.asarray(turned, flank.dtype) + flank[:, :, :1] * x + flank[:, :, 1:] * y
