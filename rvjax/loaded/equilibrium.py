"""Equilibria of a whole reducer: one, and several input angles with several torques each; the kinds of reducers.

One gives everything that is read, checked and derived. Several give chosen results, such as the forces of the crank
bearings. What differs between kinds is one table.
"""

from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import scan
from rvjax._jax.programs import ONCE, quick
from rvjax.base.words import choose
from rvjax.catalogue import checked
from rvjax.cycloidal import CycloidalReducer, Reducer, ReducerErrors
from rvjax.designs import RVReducer, check_teeth, expect
from rvjax.errors import Errors
from rvjax.loaded import cycloidal, laws, rv
from rvjax.loaded.balance import Forces, compliance, forces
from rvjax.loaded.case import SUPPORTS, Case, NamedForces, Read, at_output, output_rotation, solve, under
from rvjax.loaded.newton import Minimum
from rvjax.loaded.system import Layout
from rvjax.records import Array, Design, PyTree, Record, Scalar, check_shapes, field, record
from rvjax.roots import solved
from rvjax.status import SolveInfo, Status, succeeded

KINDS: dict[type, ModuleType] = {RVReducer: rv, CycloidalReducer: cycloidal}
"""Module of each kind of reducer, with six functions of these arguments:

    layout(design, errors, contact, carrier, sun)     bodies and contacts, with an error for shapes that do not fit
    admit(layout, design, errors, torque, angle)      numbers that are read, harmless where they are impossible
    prepare(layout, read, input_angle)                geometry, springs and gaps of an input angle under 1 N m: a `Case`
    named_forces(layout, read, case, forces)          forces by their names in the results
    fit(samples, turns, design, errors)               least clearance without load, of all angles () and of each (n,)
    passing(design)                                   orders of the output turn that few angles may not resolve
"""


def kind_of(design: Design) -> ModuleType:
    """The module of a design's kind."""
    return next(kind for cls, kind in KINDS.items() if isinstance(design, cls))


def check_kind(design: Design, errors: Errors) -> None:
    """Raise an error for errors of another kind of reducer or of other counts.

    Args:
        design: one of `KINDS`.
        errors: of its parts.
    """
    wanted = design.error_record
    if not isinstance(errors, wanted):
        kind = type(design).__name__
        raise ValueError(f"errors: a {kind} takes {wanted.__name__}, got {type(errors).__name__}")
    check_shapes([errors], design.counts)


def check_input(design: Reducer, errors: PyTree, contact: str, carrier: str, sun: str) -> Layout:
    """The layout of this call.

    Args:
        design: as in `equilibrium`.
        errors: likewise.
        contact: likewise.
        carrier: likewise.
        sun: likewise.

    Raises:
        ValueError: see `equilibrium`.
    """
    expect(design, "loaded", *KINDS)
    for name, value, known in (
        ("contact", contact, laws.CONTACTS),
        ("carrier", carrier, SUPPORTS),
        ("sun", sun, SUPPORTS),
    ):
        choose(name, value, known)
    for name in ("stiffness", "contact"):
        if getattr(design, name) is None:
            raise ValueError(f"{type(design).__name__}.{name} = None: the loaded equilibrium needs it")
    check_teeth(design.cycloid)
    check_kind(design, errors)
    return kind_of(design).layout(design, errors, contact, carrier, sun)


def admit(layout: Layout, design: Design, errors: Errors, torque: Scalar, angle: Scalar) -> Read:
    """Check the numbers that are read.

    Args:
        layout: counts and methods.
        design: the reducer.
        errors: of its parts.
        torque: () N m.
        angle: () rad.
    """
    return kind_of(design).admit(layout, design, errors, torque, angle)


def prepare(layout: Layout, read: Read, input_angle: jax.Array) -> Case:
    """Geometry, springs and gaps of one input angle; `load` is that of 1 N m.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        input_angle: () rad.
    """
    return kind_of(read.design).prepare(layout, read, input_angle)


def named_forces(layout: Layout, read: Read, case: Case, forces: Forces) -> NamedForces:
    """The forces by their names in the results.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: of the angle.
        forces: of all contacts.
    """
    return kind_of(read.design).named_forces(layout, read, case, forces)


@record
class Loaded(Record):
    """Equilibrium of a whole reducer. Bearing forces in the frame of the ideal carrier; for c = 2 its x axis runs from
    crank 0 to crank 1."""

    error: Array = field("rad", "rotation of the carrier against the ideal motion, > 0 ahead")
    pins: Array = field("N", "force of each pin on each disc, >= 0", shape=("discs", "pins"))
    pressure: Array = field("Pa", "largest Hertzian pressure of each pin", shape=("discs", "pins"))
    disc_bearing: Array = field("N", "crank on disc, x, y", shape=("discs", "cranks", 2))
    support_bearing: Array = field("N", "crank on carrier, x, y", shape=("cranks", 2))
    gear: Array | None = field(
        "N", "sun on each planet, driving flank less coasting flank; None: no such gear", shape=("cranks",)
    )
    input_torque: Array = field("N m", "torque on the sun or shaft")
    disc_torque: Array = field("N m", "moment of the pins about the centre of each disc", shape=("discs",))
    stiffness: Array = field("N m/rad", "tangent stiffness at the carrier, input held")
    info: SolveInfo = field("-", "residual: largest unbalanced force over the largest force", kind="record")
    output_pins: Array | None = field(
        "N", "force of each output pin in each disc, >= 0", shape=("discs", "output_pins"), default=None
    )
    output_pressure: Array | None = field(
        "Pa", "largest Hertzian pressure of each output pin", shape=("discs", "output_pins"), default=None
    )
    output_bearing: Array | None = field("N", "all discs on the carrier, x, y", shape=(2,), default=None)


@checked
def equilibrium(
    design: Reducer,
    errors: ReducerErrors,
    *,
    input_angle: Scalar,
    output_torque: Scalar,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Loaded:
    """Quasi-static equilibrium of every part that carries torque, both stages in one.

    Contacts are elastic and unilateral, without friction; geometry is linear in the displacements, which are deviations
    from the ideal motion at `input_angle`. Derived in this project: docs/models/loaded.md, Eqs. 1-23, and
    docs/models/single_stage.md. With clearances above e/25 the forces of a single-stage drive are too low.

    Args:
        design: an RV reducer or a single-stage drive, with stiffness and contact; one pin more than disc teeth.
            `shortening` is not read.
        errors: of its parts; the bounds without a place (`pin_position`, `disc_runout`, `disc_cumulative_pitch`) are
            not read. Negative clearances count as 0; the slope at 0 is that of a clearance.
        input_angle: of the sun, () rad, ring fixed; forward is counter-clockwise, and so is the output. Of a
            single-stage drive: of the shaft against the part at rest; the output turns by angle / design.ratio.
        output_torque: that the discs exert on the carrier, () N m; the external load is its opposite.
        contact: contact law of the pins, "hertz", "linear" or "palmgren".
        carrier: "fixed" centre, or "floating" on `stiffness.output_support`.
        sun: "fixed", or "floating" on `stiffness.sun_support` and `sun_torsion`; below zero these are INVALID_GEOMETRY.

    Returns:
        Loaded. Status CONVERGED; UNLOADED: nothing pressed without torque, no pin of the ring pressed by a torque that
        the centring springs carry, or forces lost in the rounding of the gaps (residual above 1.5e-8, in float32
        3.5e-4); or with NaN values NONFINITE, INVALID_GEOMETRY, UNDERCUT, CONTACT_OVERLOAD (hertz: pin depth at its
        limit, or an output pin whose contact is wider than 0.6 of its radius), MAX_STEPS.

    Raises:
        ValueError: unknown methods, a design without stiffness or contact or with another tooth difference than one,
            or an array whose shape does not fit the design.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    return _equilibrium(layout, design, errors, input_angle, output_torque)


@quick(0, options=ONCE)
def _equilibrium(layout: Layout, design: Design, errors: Errors, input_angle: Scalar, output_torque: Scalar) -> Loaded:
    read = admit(layout, design, errors, output_torque, input_angle)
    case = prepare(layout, read, read.angle).loaded(read.torque)
    minimum, info = solve(layout, read, case, jnp.full((layout.unknowns,), jnp.nan, read.torque.dtype))
    return outcome(layout, read, case, minimum, info)


def error_alone(
    layout: Layout, design: Design, errors: Errors, input_angle: Scalar, output_torque: Scalar
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
    minimum, info = solve(layout, read, case, jnp.full((layout.unknowns,), jnp.nan, read.torque.dtype))
    error = output_rotation(layout, case, at_output(layout, case, minimum, info.status))
    return jnp.where(succeeded(info.status), error, jnp.nan)


def outcome(layout: Layout, read: Read, case: Case, minimum: Minimum, info: SolveInfo) -> Loaded:
    """Everything that follows from the displacements."""
    q = at_output(layout, case, minimum, info.status)
    at = forces(layout, case.system, q)
    unit = jnp.asarray(np.eye(layout.unknowns)[layout.carried], q.dtype)
    values = Loaded(
        error=output_rotation(layout, case, q),
        pins=at.pins,
        pressure=under(case.pressure, at.pins),
        **named_forces(layout, read, case, at)._asdict(),
        disc_torque=-jnp.sum(case.lever * at.pins, axis=1),
        stiffness=jnp.square(case.length) / compliance(layout, case.system, q, unit)[layout.carried],
        info=None,  # type: ignore[arg-type]
    )
    fine = succeeded(info.status)
    return jax.tree.map(lambda value: jnp.where(fine, value, jnp.nan), values).replace(info=info)


Take = Callable[[Case, jax.Array, jax.Array], PyTree]
"""(case, displacements (unknowns,), whether it carries) -> what is wanted of an equilibrium. If it does not, forces are
to count as 0; where an equilibrium failed, its displacements are 0."""


_Row = tuple[jax.Array, jax.Array | None, jax.Array | None, jax.Array | None]
"""Angle, start, torques and whether to follow the row before, as far as rows have their own."""


class Equilibria(NamedTuple):
    """At n angles under t torques. The displacements carry no derivative; they are a start for torques near these."""

    taken: PyTree  # leaves (n, t, ...)
    info: SolveInfo  # (n, t)
    displacements: jax.Array  # (n, t, unknowns), NaN where an equilibrium failed


def equilibria(
    layout: Layout,
    read: Read,
    torques: jax.Array,
    input_angles: jax.Array,
    take: Take,
    start: jax.Array | None = None,
    *,
    near: bool | np.ndarray = False,
) -> Equilibria:
    """Equilibria at every angle under every torque, in one loop, because each loop compiles for seconds.

    Args:
        layout: counts and methods.
        read: finite and possible numbers; its torque and angle are not read.
        torques: of the discs on the carrier, (t,) N m, or (n, t) where every angle has its own.
        input_angles: of the sun, (n,) rad, constants.
        take: from each equilibrium, with its derivatives.
        start: displacements (n, t, unknowns) to start from; NaN or None: none, or those at the angle before.
        near: start from the angle before, because the crank angle differs little; or (n,) whether each does.
    """
    none = jnp.full((torques.shape[-1], layout.unknowns), jnp.nan, torques.dtype)
    rows = None if torques.ndim == 1 else torques
    some = None if isinstance(near, bool) else jnp.asarray(near)

    def onward(last: jax.Array, at: _Row) -> tuple[jax.Array, tuple[Minimum, SolveInfo]]:
        angle, given, rows, follows = at
        of_torques = jax.lax.stop_gradient(torques if rows is None else rows)
        last = last if follows is None else jnp.where(follows, last, none)
        case = jax.lax.stop_gradient(prepare(layout, read, angle))

        def under(torque: jax.Array, start: jax.Array) -> tuple[Minimum, SolveInfo]:
            return solve(layout, read, case.loaded(torque), start)

        begin = last if given is None else jnp.where(jnp.isfinite(given), given, last)
        minima, info = jax.vmap(under)(of_torques, begin)
        here = jnp.where(succeeded(info.status)[:, None], minima.q, jnp.nan) if near is not False else none
        return here, (minima, info)

    minima, info = solved(scan(onward, none, (input_angles, start, rows, some))[1])
    measure = jax.checkpoint(partial(_measure, layout, take))
    taken = jax.lax.map(
        lambda x: measure(read, torques if x[0] is None else x[0], *x[1:]), (rows, input_angles, minima, info.status)
    )
    q = jnp.where(succeeded(info.status)[..., None], minima.q, jnp.nan)
    return Equilibria(taken, info, jax.lax.stop_gradient(q))


def _measure(
    layout: Layout,
    take: Take,
    read: Read,
    torques: jax.Array,
    angle: jax.Array,
    minimum: Minimum,
    status: jax.Array,
) -> object:
    """Results at one angle under every torque, with their derivatives."""
    case = prepare(layout, read, angle)

    def of_one(torque: jax.Array, minimum: Minimum, status: jax.Array) -> object:
        loaded = case.loaded(torque)
        return take(loaded, at_output(layout, loaded, minimum, status), status == Status.CONVERGED)

    return jax.vmap(of_one)(torques, minimum, status)
