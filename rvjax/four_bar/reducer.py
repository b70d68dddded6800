"""Transmission error of a reducer: every disc on all its cranks, the mean over the discs."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax._jax.elementary import arctan2, sin_cos
from rvjax._reducer.plausible import checked
from rvjax.designs import RVReducer, expect
from rvjax.errors import RVErrors
from rvjax.four_bar import closures, fit
from rvjax.four_bar.closures import Crank, crank_direction
from rvjax.four_bar.linkage import LinkDeviations, check_methods, close
from rvjax.four_bar.unit import Unit, is_loaded, take_apart
from rvjax.records import Array, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, admit, at_once, worst_of


@record
class TransmissionError(Record):
    """Deviation of the output from the ideal ratio at one crank angle."""

    error: Array = field("rad", "output angle, > 0: carrier ahead; mean over the discs")
    per_disc: Array = field("rad", "the same for each disc alone", shape=("discs",))
    misfit: Array = field("m", "what the bearings must stretch: signed for two cranks, else >= 0", shape=("discs",))
    info: SolveInfo = field("-", "of the worst disc", kind="record")


class Placed(NamedTuple):
    """One disc in the carrier frame."""

    angle: Array
    misfit: Array
    info: SolveInfo


@checked
def transmission_error(
    design: RVReducer,
    errors: RVErrors,
    *,
    crank_angle: Scalar,
    output_torque: Scalar = 0.0,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Scalar | None = None,
    closure: str = "newton",
    branch: str = "open",
) -> TransmissionError:
    """Transmission error of the second stage at one crank angle.

    Args:
        design: the reducer; its `cranks.bearing_stiffness` is needed under load.
        errors: of its parts; crank eccentricity and phase, bores, bearing clearance and eccentricity are read.
        crank_angle: eccentric direction of the first disc, () rad; crank i of c lies at pi + 2 pi i / c.
        output_torque: torque the discs exert on the carrier, counter-clockwise, () N m.
        cranks: "phase_locked", "free" or "geared" as in `solve_closure`; the last two for two cranks only.
        gear_stiffness_ratio: as in `solve_closure`; for "geared" only.
        closure: "newton", "closed_form", "quadratic" or "first_order" as in `solve_closure`.
        branch: "open" or "crossed".

    Returns:
        TransmissionError; angles lie between the drawing frames of the parts. Statuses as in `solve_closure`.

    Raises:
        ValueError: a combination of methods that does not exist, errors whose shapes do not fit the design, or
            a load (non-zero or traced) without bearing stiffness.
    """
    expect(design, "four_bar.transmission_error", RVReducer)
    methods = check_methods(cranks, gear_stiffness_ratio, closure, branch, count=design.cranks.count)
    numbers = (design, errors, output_torque, crank_angle, gear_stiffness_ratio)
    return _transmission_error(*numbers, loaded=is_loaded(design, output_torque), **methods)


@partial(jax.jit, inline=True, static_argnames=("loaded", "cranks", "closure", "branch"))
def _transmission_error(
    design: RVReducer,
    errors: RVErrors,
    torque: Array,
    angle: Array,
    ratio: Array | None,
    *,
    loaded: bool,
    **methods: str,
) -> TransmissionError:
    unit, angle, ratio = take_apart(design, errors, torque, angle, ratio, loaded=loaded)
    return error_at(unit, angle, ratio, **methods)


def error_at(
    unit: Unit, angle: jax.Array, ratio: Array | None, *, cranks: str, closure: str, branch: str
) -> TransmissionError:
    """Transmission error of a unit at one crank angle; methods were checked."""
    first = crank_direction(angle)
    placed = []
    for k in range(len(unit.parts.disc)):
        crank = unit.disc_crank(k, first)
        if cranks == "phase_locked":
            placed.append(_fitted_disc(unit, k, crank, closure=closure))
        else:
            placed.append(_linked_disc(unit, k, crank, ratio, cranks=cranks, closure=closure, branch=branch))
    per_disc, misfits = [-disc.angle for disc in placed], [disc.misfit for disc in placed]
    error = sum(per_disc) / len(per_disc)
    info = worst_of(jax.tree.map(lambda *leaves: jnp.stack(leaves), *[disc.info for disc in placed]))
    overflow = (info.status == Status.CONVERGED) & ~jnp.isfinite(error)
    info = info.replace(status=jnp.where(overflow, int(Status.NONFINITE), info.status))
    _, gate = admit((), 0, (~first.finite, Status.NONFINITE), after=unit.gate)
    (error, each, misfit), info = gate.close((error, jnp.stack(per_disc), jnp.stack(misfits)), info=info)
    return TransmissionError(error, each, misfit, info)


def _fitted_disc(unit: Unit, k: int, crank: Crank, *, closure: str) -> Placed:
    """Disc k on phase-locked cranks."""
    prepared = fit.fit(unit, k)
    misfit = fit.misfit(unit, prepared, crank)
    if closure == "first_order":
        angle = fit.first_order_angle(unit, k, crank)
        return Placed(angle, misfit, at_once(angle))
    cosine, sine = fit.vector(unit, prepared, crank)
    size = len(unit.axes) * unit.radius**2
    angle, info = closures.direction_angle(cosine, sine, size, closure=closure)
    return Placed(angle, misfit, info)


def _linked_disc(unit: Unit, k: int, crank: Crank, ratio: Array | None, **methods: str) -> Placed:
    """Disc k on two cranks as a four-bar linkage."""
    spacing = 2 * unit.radius
    parts = unit.parts
    (radial_0, tangential_0), (radial_1, tangential_1) = parts.disc[k]
    bore_x, bore_y = radial_0 + radial_1, tangential_0 + tangential_1
    (shift_0x, shift_0y), (shift_1x, shift_1y) = unit.joint_shifts(crank)
    deviations = LinkDeviations(
        crank_1=parts.delta[k][0],
        crank_3=parts.delta[k][1],
        coupler=closures.stretch(spacing, bore_x, bore_y),
        frame=parts.carrier[0][0] + parts.carrier[1][0],
        crank_phase=parts.psi[1] - parts.psi[0],
        frame_angle=jnp.zeros_like(spacing),
        joint=jnp.stack(
            [
                jnp.zeros_like(spacing) + (shift_1x - shift_0x),
                parts.carrier[0][1] + parts.carrier[1][1] + (shift_1y - shift_0y),
            ]
        ),
    )
    sine, cosine = sin_cos(parts.psi[0])
    turned = crank.turned(cosine, sine)
    closed = close(unit.eccentricity, spacing, deviations, turned, ratio, **methods)
    return Placed(closed.coupler_angle - arctan2(bore_y, spacing + bore_x), closed.misfit, closed.info)
