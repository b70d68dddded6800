"""A whole crank turn: transmission error curve and its statistics."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.plausible import checked
from rvjax.base.words import unknown
from rvjax.designs import RVReducer, expect
from rvjax.errors import RVErrors
from rvjax.four_bar.extremes import PARTS, Figures, extremes
from rvjax.four_bar.linkage import check_methods
from rvjax.four_bar.reducer import TransmissionError, error_at
from rvjax.four_bar.unit import Unit, is_loaded, take_apart
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, worst_of


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
    found = extremes(unit, angles) if _is_direct(**methods) else _of_curve(curve)
    return Revolution(
        crank_angle=_crank_angles(unit, angles),
        error=curve.error,
        misfit=curve.misfit,
        mean=jnp.mean(curve.error),
        harmonics=_harmonics(curve.error),
        **vars(found),
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
    found, missing = _of_curve(_curve(unit, ratio, angles, methods)), unit.radius * jnp.nan
    if only == "misfit":
        return found.replace(maximum=missing, minimum=missing, peak_to_peak=missing)
    return found.replace(largest_misfit=missing) if only == "error" else found


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
