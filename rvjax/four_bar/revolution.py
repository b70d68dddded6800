"""A whole crank turn: transmission error curve and its statistics."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.choices import unknown
from rvjax.designs import RVReducer, expect
from rvjax.elementary import arctan2, divide
from rvjax.errors import RVErrors
from rvjax.four_bar.closures import Crank
from rvjax.four_bar.fit import Fit, Turning, direction, fit, still_and_turning, turning, vector
from rvjax.four_bar.linkage import check_methods
from rvjax.four_bar.misfits import most_misfit
from rvjax.four_bar.reducer import TransmissionError, error_at
from rvjax.four_bar.turn import Score, Wave, largest_and_smallest
from rvjax.four_bar.unit import Unit, Vector, is_loaded, take_apart
from rvjax.plausible import checked
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, at_once, worst_of


@record
class Figures(Record):
    """Statistics of the transmission error over one crank turn."""

    maximum: Array = field("rad", "largest error")
    minimum: Array = field("rad", "smallest error")
    peak_to_peak: Array = field("rad", "maximum less minimum")
    largest_misfit: Array = field("m", "largest |misfit| over angles and discs")
    info: SolveInfo = field("-", "of the worst angle", kind="record")


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
    ways = _ways(design, output_torque, cranks, gear_stiffness_ratio, closure, branch, angles)
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
    ways = _ways(design, output_torque, cranks, gear_stiffness_ratio, closure, branch, angles)
    if only not in (None, *PARTS):
        raise unknown(f"only = {only!r}", only, PARTS, ": must be None for both, or one of")
    return _figures((design, errors, output_torque, gear_stiffness_ratio), only=only, **ways)


@checked
def harmonics(
    design: RVReducer,
    errors: RVErrors,
    *,
    angles: int = 64,
    output_torque: Scalar = 0.0,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Scalar | None = None,
    closure: str | None = None,
) -> jax.Array:
    """The harmonics of `revolution` without its statistics, in a quarter of the tracing.

    Args:
        design: as in `revolution`.
        errors: likewise.
        angles: likewise.
        output_torque: likewise.
        cranks: likewise.
        gear_stiffness_ratio: likewise.
        closure: likewise.

    Raises:
        ValueError: as `revolution`.
    """
    ways = _ways(design, output_torque, cranks, gear_stiffness_ratio, closure, "open", angles)
    return _harmonics_alone((design, errors, output_torque, gear_stiffness_ratio), **ways)


def _ways(
    design: RVReducer,
    output_torque: Scalar,
    cranks: str,
    ratio: Scalar | None,
    closure: str | None,
    branch: str,
    angles: int,
) -> dict[str, PyTree]:
    """Static settings of the program."""
    expect(design, "four_bar.revolution", RVReducer)
    if closure is None:
        closure = "newton" if cranks == "geared" else "closed_form"
    methods = check_methods(cranks, ratio, closure, branch, count=design.cranks.count)
    return dict(methods, angles=angles, loaded=is_loaded(design, output_torque))


_SMALL = 1 / 64  # displacements over crank circle radius up to which the bound of `first_wave` holds

PARTS = ("error", "misfit")  # of a turn's statistics
STATIC = ("angles", "loaded", "cranks", "closure", "branch")
Numbers = tuple[RVReducer, RVErrors, Any, Any]  # design, errors, torque, ratio of the gears


@functools.partial(jax.jit, inline=True, static_argnames=STATIC)
def _revolution(numbers: Numbers, *, angles: int, loaded: bool, **methods: str) -> Revolution:
    unit, ratio = take_apart(*numbers, loaded=loaded)
    curve = _curve(unit, ratio, angles, methods)
    found = _on_the_way(unit, angles) if _is_direct(**methods) else _of_curve(curve)
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
        return _on_the_way(unit, angles, PARTS if only is None else (only,))
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


def _on_the_way(unit: Unit, angles: int, wanted: tuple[str, ...] = PARTS) -> Figures:
    """Statistics of phase-locked cranks from the extremes only; NaN where not required."""
    most = least = largest = unit.radius * jnp.nan
    if "error" in wanted:
        most, least = _without_load(unit, angles) if unit.load is None else _under_load(unit, angles)
    if "misfit" in wanted:
        largest = most_misfit(unit, angles)
    decides = most - least if "error" in wanted else largest
    (most, least, swing, largest), info = unit.gate.close(
        (most, least, most - least, largest), (~jnp.isfinite(decides), Status.NONFINITE), info=at_once(decides)
    )
    return Figures(most, least, swing, largest, info)


def _fits(unit: Unit) -> list[Fit]:
    return [fit(unit, k) for k in range(len(unit.parts.disc))]


def _under_load(unit: Unit, angles: int) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest error."""
    fits = _fits(unit)

    def vectors(parts: PyTree, first: Crank) -> list[Vector]:
        unit, fits = parts
        scale = 1 / (len(unit.axes) * unit.radius**2)  # vectors near 1, however many are multiplied
        found = [vector(unit, own, unit.disc_crank(k, first)) for k, own in enumerate(fits)]
        return [(scale * cosine, scale * sine) for cosine, sine in found]

    def error(parts: PyTree, first: Crank) -> jax.Array:
        return _mean_angle(vectors(parts, first))

    def of(parts: PyTree) -> Callable[[Crank], jax.Array]:
        return lambda first: monotone_angle(functools.reduce(_times, vectors(parts, first)))

    score = Score(of, back=lambda score: _angle(score) / len(fits))
    return largest_and_smallest(error, (unit, fits), angles, score=score, together=4)


def _without_load(unit: Unit, angles: int) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest error: every disc's vector is still + turning u with the crank's direction u."""
    axes, count = unit.axes, len(unit.parts.disc)

    def discs(parts: Turning) -> list[tuple[Vector, Vector]]:
        """1 + still and turning of each disc, in the direction of the first crank."""
        found = []
        for k in range(count):
            (x, y), moved = still_and_turning(axes, parts, k)
            turned = unit.disc_crank(k, Crank(*moved))
            found.append(((1 + x, y), (turned.cosine, turned.sine)))
        return found

    def error(parts: Turning, first: Crank) -> jax.Array:
        u = (first.cosine, first.sine)
        return _mean_angle([Polynomial([still, moved]).at(u) for still, moved in discs(parts)])

    def of(parts: Turning) -> Callable[[Crank], jax.Array]:
        together = _product(discs(parts))
        return lambda first: monotone_angle(together.at((first.cosine, first.sine)))

    score = Score(of, back=lambda score: _angle(score) / count, wave=lambda parts: first_wave(discs(parts)))
    return largest_and_smallest(error, turning(unit), angles, score=score, together=4)


def _mean_angle(vectors: list[Vector]) -> jax.Array:
    return -jnp.mean(jnp.stack([direction(cosine, sine) for cosine, sine in vectors]))


def monotone_angle(vector: Vector) -> jax.Array:
    """Return a number that falls as the discs turn: -1 to 1 up to a right angle of all together, to +-2 beyond.

    Their vectors C + i S were turned one after the other by multiplication, so no angle is needed.
    """
    cosine, sine = vector
    size = jnp.abs(cosine) + jnp.abs(sine)
    beyond = jnp.where(sine >= 0, 2, -2) * size - sine
    return -divide(jnp.where(cosine >= 0, sine, beyond), size)


def first_wave(discs: list[tuple[Vector, Vector]]) -> Wave:
    """First harmonic of minus the sum of the discs' angles without load, and a bound of the others.

    With disc k at still_k + turning_k u_k and w_k = turning_k / still_k the sum is constant plus the imaginary part
    of sum_k log(1 + w_k u_k): first harmonic sum_k w_k u_k = u a1 / a0 in the coefficients of the product, and
    sum_m m |m-th| <= sum_k |w_k|^2 / (1 - |w_k|). Both times |a0|^2 here, to avoid the division.
    """
    (x0, y0), (x1, y1) = _product(discs).coefficients[:2]
    small, squares = np.True_, 0
    for (x, y), (u, v) in discs:
        square = u**2 + v**2
        small &= (jnp.abs(x - 1) + jnp.abs(y) < _SMALL) & (square < _SMALL**2)
        squares += square
    of_squares = 1 / (1 - _SMALL) ** 2 / (1 - _SMALL / (1 - _SMALL))  # |still| >= 1 - _SMALL
    rest = jnp.where(small, of_squares * squares * (x0 * x0 + y0 * y0), jnp.inf)
    return Wave(y0 * x1 - x0 * y1, -(x0 * x1 + y0 * y1), rest)


def _product(discs: list[tuple[Vector, Vector]]) -> "Polynomial":
    """Product of the discs' vectors without load, in the direction of the first crank."""
    first, *others = discs
    together = Polynomial(list(first))
    for still, moved in others:
        together = together.times(still, moved)
    return together


class Polynomial(NamedTuple):
    """In a complex variable; numbers are pairs, real and imaginary, which run in vectors."""

    coefficients: list[Vector]  # of ascending powers

    def times(self, still: Vector, turning: Vector) -> "Polynomial":
        """Multiplied by still + turning u."""
        same = [*(_times(z, still) for z in self.coefficients), (0, 0)]
        risen = [(0, 0), *(_times(z, turning) for z in self.coefficients)]
        return Polynomial([(x + u, y + v) for (x, y), (u, v) in zip(same, risen)])

    def at(self, u: Vector) -> Vector:
        """Value by Horner's rule."""
        x, y = self.coefficients[-1]
        for real, imaginary in self.coefficients[-2::-1]:
            x, y = _times((x, y), u)
            x, y = real + x, imaginary + y
        return x, y


def _times(first: Vector, second: Vector) -> Vector:
    return first[0] * second[0] - first[1] * second[1], first[1] * second[0] + first[0] * second[1]


def _angle(score: jax.Array) -> jax.Array:
    """Angle of a value of `monotone_angle`."""
    beyond = jnp.abs(score) > 1
    half_turn = jnp.where(beyond, jnp.sign(score), 0)
    within = jnp.where(beyond, score - 2 * half_turn, score)  # beyond a right angle: of the opposite direction
    return arctan2(within, 1 - jnp.abs(within)) + np.pi * half_turn
