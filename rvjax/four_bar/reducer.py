"""Transmission error of a reducer, at one angle and over a revolution.

Every disc sits on all its cranks; the error is the mean over the discs.
"""

import functools
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import arctan2, sin_cos
from rvjax.base.words import unknown
from rvjax.catalogue import checked
from rvjax.designs import RVReducer, expect
from rvjax.errors import RVErrors
from rvjax.four_bar import closures, disc_fit
from rvjax.four_bar.closures import Crank, Resting, crank_direction
from rvjax.four_bar.extremes import PARTS, Figures, extremes
from rvjax.four_bar.linkage import LinkDeviations, check_methods, close
from rvjax.four_bar.unit import Unit, is_loaded, take_apart
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, admit, at_once, worst_of


@record
class TransmissionError(Record):
    """Deviation of the output from the ideal ratio at one crank angle."""

    error: Array = field("rad", "output angle, > 0: carrier ahead; mean over the discs")
    per_disc: Array = field("rad", "the same for each disc alone", shape=("discs",))
    misfit: Array = field("m", "what the bearings must stretch: signed for two cranks, else >= 0", shape=("discs",))
    info: SolveInfo = field("-", "of the worst disc", kind="record")


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


def _fitted_disc(unit: Unit, k: int, crank: Crank, *, closure: str) -> Resting:
    """Disc k on phase-locked cranks."""
    prepared = disc_fit.fit(unit, k)
    misfit = disc_fit.misfit(unit, prepared, crank)
    if closure == "first_order":
        angle = disc_fit.first_order_angle(unit, k, crank)
        return Resting(angle, misfit, at_once(angle))
    cosine, sine = disc_fit.vector(unit, prepared, crank)
    size = len(unit.axes) * unit.radius**2
    angle, info = closures.direction_angle(cosine, sine, size, closure=closure)
    return Resting(angle, misfit, info)


def _linked_disc(unit: Unit, k: int, crank: Crank, ratio: Array | None, **methods: str) -> Resting:
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
    return Resting(closed.coupler_angle - arctan2(bore_y, spacing + bore_x), closed.misfit, closed.info)


@record
class Revolution(Record):
    """Transmission error over one crank turn; the output makes `pin_count` of them in a carrier turn."""

    crank_angle: Array = field("rad", "uniform, from zero", shape=("angles",))
    error: Array = field("rad", "output angle, > 0: carrier ahead", shape=("angles",))
    misfit: Array = field("m", "of each disc", shape=("angles", "discs"))
    maximum: Array = field("rad", "largest error")
    minimum: Array = field("rad", "smallest error")
    peak_to_peak: Array = field("rad", "maximum less minimum")
    mean: Array = field("rad", "mean error")
    largest_misfit: Array = field("m", "largest |misfit| over angles and discs")
    harmonics: Array = field("rad", "X[h], complex: error = Re sum X[h] exp(i h crank_angle)", shape=("orders",))
    info: SolveInfo = field("-", "of the worst angle", kind="record")


@checked
def revolution(
    design: RVReducer,
    errors: RVErrors,
    *,
    angles: int = 64,
    output_torque: Scalar = 0.0,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Scalar | None = None,
    closure: str | None = None,
    branch: str = "open",
) -> Revolution:
    """Transmission error over one crank turn.

    Args:
        design: as in `transmission_error`.
        errors: as in `transmission_error`.
        angles: number of uniform crank angles, static; 48 or more for a smooth curve.
        output_torque: as in `transmission_error`.
        cranks: as in `transmission_error`.
        gear_stiffness_ratio: as in `transmission_error`.
        closure: as in `transmission_error`; by default "closed_form", "newton" where there is none.
        branch: as in `transmission_error`.

    Returns:
        Revolution. One failed angle makes the statistics NaN; `info` gives the reason. Unused statistics cost nothing
        under `jax.jit`. A large batch runs fastest with the units on the last axis of every error,
        `jax.vmap(..., in_axes=-1)`: its derivatives then are assembled from contiguous rows.

    Raises:
        ValueError: as in `transmission_error`.
    """
    ways = _ways(design, output_torque, cranks, gear_stiffness_ratio, closure, branch, angles=angles)
    return _revolution((design, errors, output_torque, gear_stiffness_ratio), **ways)


@checked
def figures(
    design: RVReducer,
    errors: RVErrors,
    *,
    angles: int = 64,
    output_torque: Scalar = 0.0,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Scalar | None = None,
    closure: str | None = None,
    branch: str = "open",
    only: str | None = None,
) -> Figures:
    """Compute the statistics of a crank turn without the curve: no spectrum, and by default no angle, is traced.

    Args:
        design: as in `revolution`.
        errors: as in `revolution`.
        angles: as in `revolution`.
        output_torque: as in `revolution`.
        cranks: as in `revolution`.
        gear_stiffness_ratio: as in `revolution`.
        closure: as in `revolution`.
        branch: as in `revolution`.
        only: "error" or "misfit" where only these are read: the other statistics are NaN, and cost no compilation.

    Raises:
        ValueError: as in `revolution`; another word for `only`.
    """
    ways = _ways(design, output_torque, cranks, gear_stiffness_ratio, closure, branch, angles=angles)
    if only not in (None, *PARTS):
        raise unknown(f"only = {only!r}", only, PARTS, ": must be None for both, or one of")
    return _figures((design, errors, output_torque, gear_stiffness_ratio), only=only, **ways)


@checked
def harmonics(
    design: RVReducer, errors: RVErrors, *, angles: int = 64, output_torque: Scalar = 0.0, **methods: Any
) -> jax.Array:
    """The harmonics of `revolution` without its statistics, in a quarter of the tracing.

    Args:
        design: as in `revolution`.
        errors: as in `revolution`.
        angles: as in `revolution`.
        output_torque: as in `revolution`.
        **methods: `cranks`, `gear_stiffness_ratio`, `closure` and `branch` of `revolution`.

    Raises:
        ValueError: as in `revolution`.
    """
    ways = _ways(design, output_torque, angles=angles, **methods)
    return _harmonics_alone((design, errors, output_torque, methods.get("gear_stiffness_ratio")), **ways)


def _ways(
    design: RVReducer,
    output_torque: Scalar,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Scalar | None = None,
    closure: str | None = None,
    branch: str = "open",
    *,
    angles: int,
) -> dict[str, PyTree]:
    """Static settings of the program."""
    expect(design, "four_bar.revolution", RVReducer)
    if closure is None:
        closure = "newton" if cranks == "geared" else "closed_form"
    methods = check_methods(cranks, gear_stiffness_ratio, closure, branch, count=design.cranks.count)
    return dict(methods, angles=angles, loaded=is_loaded(design, output_torque))


STATIC = ("angles", "loaded", "cranks", "closure", "branch")
Numbers = tuple[RVReducer, RVErrors, Any, Any]  # design, errors, torque, ratio of the gears


@functools.partial(jax.jit, inline=True, static_argnames=STATIC)
def _revolution(numbers: Numbers, *, angles: int, loaded: bool, **methods: str) -> Revolution:
    unit, ratio = take_apart(*numbers, loaded=loaded)
    curve = _curve(unit, ratio, angles, methods)
    statistics = extremes(unit, angles) if _is_direct(**methods) else _of_curve(curve)
    return Revolution(
        crank_angle=_crank_angles(unit, angles),
        error=curve.error,
        misfit=curve.misfit,
        mean=jnp.mean(curve.error),
        harmonics=_harmonics(curve.error),
        **vars(statistics),
    )


def _harmonics(error: Array) -> jax.Array:
    spectrum = jnp.fft.rfft(error)[: (len(error) + 1) // 2]  # orders below half the sampling rate
    return spectrum * np.where(np.arange(len(spectrum)) == 0, 1, 2).astype(spectrum.dtype) / len(error)


@functools.partial(jax.jit, inline=True, static_argnames=STATIC)
def _harmonics_alone(numbers: Numbers, *, angles: int, loaded: bool, **methods: str) -> jax.Array:
    unit, ratio = take_apart(*numbers, loaded=loaded)
    return _harmonics(_curve(unit, ratio, angles, methods).error)


@functools.partial(jax.jit, inline=True, static_argnames=(*STATIC, "only"))
def _figures(numbers: Numbers, *, angles: int, loaded: bool, only: str | None, **methods: str) -> Figures:
    unit, ratio = take_apart(*numbers, loaded=loaded)
    if _is_direct(**methods):
        return extremes(unit, angles, PARTS if only is None else (only,))
    statistics, missing = _of_curve(_curve(unit, ratio, angles, methods)), unit.radius * jnp.nan
    if only == "misfit":
        return statistics.replace(maximum=missing, minimum=missing, peak_to_peak=missing)
    return statistics.replace(largest_misfit=missing) if only == "error" else statistics


def _is_direct(*, cranks: str, closure: str, branch: str) -> bool:
    """Return whether the extremes can be had without the curve."""
    return cranks == "phase_locked" and closure == "closed_form"


def _crank_angles(unit: Unit, angles: int) -> jax.Array:
    return jnp.asarray(2 * np.pi / angles * np.arange(angles), unit.radius.dtype)


def _curve(unit: Unit, ratio: Array | None, angles: int, methods: dict[str, str]) -> TransmissionError:
    return jax.vmap(lambda angle: error_at(unit, angle, ratio, **methods))(_crank_angles(unit, angles))


def _of_curve(curve: TransmissionError) -> Figures:
    maximum, minimum = jnp.max(curve.error), jnp.min(curve.error)
    return Figures(maximum, minimum, maximum - minimum, jnp.max(jnp.abs(curve.misfit)), worst_of(curve.info))
