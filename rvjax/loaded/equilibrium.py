"""One equilibrium of a whole reducer: what is read, what is valid, what comes out."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.compile_cache import ONCE, quick
from rvjax._reducer.plausible import checked
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.balance import attach, balance, compliance, forces
from rvjax.loaded.gaps import flank_rounding, gaps
from rvjax.loaded.geometry import geometry
from rvjax.loaded.inputs import Read, admit, check_input, mesh_stiffness, pin_compliance
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout, System, bearing_rows, directions, gear_rows
from rvjax.records import Array, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, succeeded


@record
class Loaded(Record):
    """Equilibrium of a whole reducer. Bearing forces in the frame of the ideal carrier; for c = 2 its x axis runs from
    crank 0 to crank 1."""

    error: Array = field("rad", "rotation of the carrier against the ideal motion, > 0 ahead")
    pins: Array = field("N", "force of each pin on each disc, >= 0", shape=("discs", "pins"))
    pressure: Array = field("Pa", "largest Hertzian pressure of each pin", shape=("discs", "pins"))
    disc_bearing: Array = field("N", "crank on disc, x, y", shape=("discs", "cranks", 2))
    support_bearing: Array = field("N", "crank on carrier, x, y", shape=("cranks", 2))
    gear: Array = field("N", "sun on each planet, driving flank less coasting flank", shape=("cranks",))
    input_torque: Array = field("N m", "torque on the sun")
    disc_torque: Array = field("N m", "moment of the pins about the centre of each disc", shape=("discs",))
    stiffness: Array = field("N m/rad", "tangent stiffness at the carrier, input held")
    info: SolveInfo = field("-", "residual: largest unbalanced force over the largest force", kind="record")


@checked
def equilibrium(
    design: RVReducer,
    errors: RVErrors,
    *,
    input_angle: Scalar,
    output_torque: Scalar,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Loaded:
    """Quasi-static equilibrium of every part that carries torque, both stages in one.

    Contacts are elastic and unilateral, without friction; geometry is linear in the displacements, which are deviations
    from the ideal motion at `input_angle`. Derived in this project: docs/models/loaded.md, Eqs. 1-23.

    Args:
        design: with stiffness and contact; one pin more than disc teeth. `shortening` is not read.
        errors: of its parts; the bounds without a place (`pin_position`, `disc_runout`, `disc_cumulative_pitch`) are
            not read, negative clearances count as 0.
        input_angle: of the sun, () rad, ring fixed; forward is counter-clockwise, and so is the output.
        output_torque: that the discs exert on the carrier, () N m; the external load is its opposite.
        contact: contact law of the pins, "hertz", "linear" or "palmgren".
        carrier: "fixed" centre, or "floating" on `stiffness.output_support`.
        sun: "fixed", or "floating" on `stiffness.sun_support` and `sun_torsion`; below zero these are INVALID_GEOMETRY.

    Returns:
        Loaded. Status CONVERGED; UNLOADED: no pin pressed, with a torque of zero or one that the centring springs
        carry, or forces lost in the rounding of the gaps (residual above 1.5e-8, in float32 3.5e-4); or with NaN values
        NONFINITE, INVALID_GEOMETRY, UNDERCUT, CONTACT_OVERLOAD (hertz: pin depth at its limit), MAX_STEPS.

    Raises:
        ValueError: unknown methods, a design without stiffness or contact or with another tooth difference than one,
            or an array whose shape does not fit the design.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    return _equilibrium(layout, design, errors, input_angle, output_torque)


@quick(0, options=ONCE)
def _equilibrium(
    layout: Layout, design: RVReducer, errors: RVErrors, input_angle: Scalar, output_torque: Scalar
) -> Loaded:
    read = admit(layout, design, errors, output_torque, input_angle)
    case = prepare(layout, read, read.angle).loaded(read.torque)
    found, info = solve(layout, read, case, jnp.full((layout.unknowns,), jnp.nan, read.torque.dtype))
    return outcome(layout, read, case, found, info)


def error_alone(
    layout: Layout, design: RVReducer, errors: RVErrors, input_angle: Scalar, output_torque: Scalar
) -> jax.Array:
    """Error of an equilibrium and nothing else, NaN where it failed: half of the tracing of all.

    Args:
        layout: counts and methods.
        design: as in `equilibrium`.
        errors: likewise.
        input_angle: likewise.
        output_torque: likewise.
    """
    read = admit(layout, design, errors, output_torque, input_angle)
    case = prepare(layout, read, read.angle).loaded(read.torque)
    found, info = solve(layout, read, case, jnp.full((layout.unknowns,), jnp.nan, read.torque.dtype))
    error = placed(layout, case, found, info.status)[layout.carried] / read.design.cranks.circle_radius
    return jnp.where(succeeded(info.status), error, jnp.nan)


class Case(NamedTuple):
    """One system, and what its results are derived with."""

    system: System
    lever: jax.Array  # (d, p) m
    pressure: jax.Array  # (d, p) Pa / sqrt(N)

    def loaded(self, torque: jax.Array) -> "Case":
        """The same parts, whose load is that of 1 N m, under `torque`, () N m."""
        return self._replace(system=self.system._replace(load=torque * self.system.load))


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
    at = geometry(design, e, input_angle)
    dtype = at.size.dtype
    radial, tangential = (jnp.asarray(x, dtype)[:, None] for x in directions(cranks.count))
    side = jnp.asarray([1.0, -1.0], dtype)[None, :, None]
    flank = jnp.sin(involute.pressure_angle) * radial + jnp.cos(involute.pressure_angle) * side * tangential
    gap = gaps(design, errors, at, e, flank)
    swing = e / involute.planet_base_radius * jnp.stack([-at.eccentric.sine, at.eccentric.cosine], axis=-1)
    yielding = pin_compliance(layout, design)
    plane = contact.young_modulus * contact.face_width / (1 - contact.poisson_ratio**2)
    rounding = flank_rounding(cycloid, at)
    level = None
    if layout.law == "hertz":  # Eq. 17
        level = jnp.log(2 * jnp.pi * plane * rounding) - 1 / (2 * (1 - contact.poisson_ratio))
        if contact.pin_support is not None:
            level = level + 1 / (yielding * jnp.atleast_1d(contact.pin_support)[None])
    squeeze = plane / (2 * jnp.pi * contact.face_width**2)  # Eq. 24: p^2 = F E / (2 pi L (1 - nu^2) R*)
    arms = jnp.broadcast_to(springs.turning_arm_bearing, (layout.discs, layout.cranks))
    centring = 1e-8 * jnp.mean(arms)
    held: list[Scalar] = [0.0] * (layout.carried + 1)
    if layout.carrier == "floating":
        held += [springs.output_support] * 2
    if layout.sun == "floating":
        held += [springs.sun_support] * 2 + [springs.sun_torsion / involute.sun_base_radius**2]
    play = [jnp.maximum(x, 0) for x in (errors.bearing_clearance, errors.support_clearance)]
    system = System(
        rows=jnp.stack([-at.normal[0], -at.normal[1], at.lever / cranks.circle_radius]),
        level=level,
        compliance=jnp.atleast_1d(yielding),
        gear_rows=gear_rows(layout, flank),
        bearing_rows=bearing_rows(layout, swing),
        gear_stiffness=jnp.broadcast_to(mesh_stiffness(design), (layout.cranks,)),
        bearing_stiffness=jnp.append(arms, jnp.broadcast_to(springs.support_bearing, (layout.cranks,))),
        centring=centring,
        support=centring + jnp.stack([jnp.asarray(x, dtype) for x in held]),
        gap=gap.pins,
        gear_gap=gap.gear,
        bearing_gap=jnp.concatenate([gap.arm.reshape(-1, 2), gap.seat]),
        clearance=jnp.concatenate([jnp.full((n,), x) for n, x in zip((arms.size, layout.cranks), play)]),
        load=1 / cranks.circle_radius,
    )
    # rr^2 / R* is `rounding`, so that 1 / R* = rounding / rr^2.
    # XLA copies cheap operations into every consumer, but computes a division once. Half of the program was copies.
    one, one_of_errors = jnp.where(e > 0, 1.0, 2.0).astype(dtype), jnp.where(read.gate.good, 1.0, 2.0).astype(dtype)
    of_angle = {"rows", "level", "gear_rows", "bearing_rows"}
    kept = {
        name: None if value is None else value / (one if name in of_angle else one_of_errors)
        for name, value in system._asdict().items()
        if name in of_angle | {"gap", "gear_gap", "bearing_gap"}
    }
    return Case(system._replace(**kept), at.lever / one, jnp.sqrt(squeeze * rounding) / cycloid.pin_radius)


def solve(layout: Layout, read: Read, case: Case, start: jax.Array) -> tuple[Found, SolveInfo]:
    """Minimum of the energy of a case, without derivatives, and its status; input that failed a check costs no step.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: the case.
        start: (n,), or NaN: the linear step.
    """
    found = balance(layout, case.system, jnp.where(read.gate.good, start, jnp.inf))
    return found, _judge(read, case, found)


def _judge(read: Read, case: Case, found: Found) -> SolveInfo:
    """Status, steps and residual of the solve of a case.

    A torque so small that the centring springs carry it inside the clearances loads no contact. The forces are
    undetermined where the rounding of the gaps, times the stiffest spring, is not small compared with all forces.
    """
    faint = math.sqrt(float(jnp.finfo(found.residual.dtype).eps))
    idle = (case.system.load == 0) & (found.largest <= case.system.centring * read.design.cycloid.pin_radius)
    idle |= (found.largest <= faint * jnp.abs(case.system.load)) | (found.residual > faint)
    ended = SolveInfo(jnp.where(idle, jnp.int32(int(Status.UNLOADED)), 0), found.steps, found.residual)
    return read.gate.close(
        (),
        (~found.finite, Status.NONFINITE),
        (found.overload & ~found.converged, Status.CONTACT_OVERLOAD),
        (~found.converged, Status.MAX_STEPS),
        info=ended,
    )[1]


def placed(layout: Layout, case: Case, found: Found, status: jax.Array) -> jax.Array:
    """Displacements (n,) with the derivatives of the equilibrium; zero where it failed."""
    return attach(layout, case.system, jnp.where(succeeded(status), found.q, 0))


def pressures(case: Case, pins: jax.Array) -> jax.Array:
    """Largest Hertzian pressure of each pin under its force, (d, p) Pa. Eq. 24.

    Args:
        case: of the same angle.
        pins: forces (d, p) N.
    """
    pressed = pins > 0
    return jnp.where(pressed, case.pressure * jnp.sqrt(jnp.where(pressed, pins, 1)), 0)


def outcome(layout: Layout, read: Read, case: Case, found: Found, info: SolveInfo) -> Loaded:
    """Everything that follows from the displacements."""
    design, system = read.design, case.system
    q = placed(layout, case, found, info.status)
    pins, flanks, bearing = forces(layout, system, q)
    arm, seat = bearing[: -layout.cranks], bearing[-layout.cranks :]
    radius = design.cranks.circle_radius
    gear = flanks[:, 0] - flanks[:, 1]
    unit = jnp.asarray(np.eye(layout.unknowns)[layout.carried], q.dtype)
    values = Loaded(
        error=q[layout.carried] / radius,
        pins=pins,
        pressure=pressures(case, pins),
        disc_bearing=-arm.reshape(layout.discs, layout.cranks, 2),
        support_bearing=seat,
        gear=gear,
        input_torque=jnp.sum(gear) * design.involute.sun_base_radius,
        disc_torque=-jnp.sum(case.lever * pins, axis=1),
        stiffness=jnp.square(radius) / compliance(layout, system, q, unit)[layout.carried],
        info=None,  # type: ignore[arg-type]
    )
    fine = succeeded(info.status)
    return jax.tree.map(lambda value: jnp.where(fine, value, jnp.nan), values).replace(info=info)
