"""One equilibrium of a whole reducer: what is read, what is valid, what comes out."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import ONCE, quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.balance import compliance, forces
from rvjax.loaded.case import Case, placed, pressures, solve, turned
from rvjax.loaded.inputs import Read
from rvjax.loaded.kinds import admit, check_input, named, prepare
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, succeeded


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
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
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
def _equilibrium(layout: Layout, design: PyTree, errors: PyTree, input_angle: Scalar, output_torque: Scalar) -> Loaded:
    read = admit(layout, design, errors, output_torque, input_angle)
    case = prepare(layout, read, read.angle).loaded(read.torque)
    found, info = solve(layout, read, case, jnp.full((layout.unknowns,), jnp.nan, read.torque.dtype))
    return outcome(layout, read, case, found, info)


def error_alone(
    layout: Layout, design: PyTree, errors: PyTree, input_angle: Scalar, output_torque: Scalar
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
    error = turned(layout, case, placed(layout, case, found, info.status))
    return jnp.where(succeeded(info.status), error, jnp.nan)


def outcome(layout: Layout, read: Read, case: Case, found: Found, info: SolveInfo) -> Loaded:
    """Everything that follows from the displacements."""
    q = placed(layout, case, found, info.status)
    at = forces(layout, case.system, q)
    unit = jnp.asarray(np.eye(layout.unknowns)[layout.carried], q.dtype)
    values = Loaded(
        error=turned(layout, case, q),
        pins=at.pins,
        pressure=pressures(case, at.pins),
        **named(layout, read, case, at)._asdict(),
        disc_torque=-jnp.sum(case.lever * at.pins, axis=1),
        stiffness=jnp.square(case.length) / compliance(layout, case.system, q, unit)[layout.carried],
        info=None,  # type: ignore[arg-type]
    )
    fine = succeeded(info.status)
    return jax.tree.map(lambda value: jnp.where(fine, value, jnp.nan), values).replace(info=info)
