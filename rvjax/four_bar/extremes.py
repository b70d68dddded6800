"""Extremes of the transmission error and of the misfit over a crank turn, of phase-locked cranks without the curve."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import arctan2, divide
from rvjax.four_bar.closures import Crank, stretch
from rvjax.four_bar.disc_fit import (
    Fit,
    Turning,
    apart,
    bore_excess,
    direction,
    fit,
    misfit,
    still_and_turning,
    turning,
    vector,
)
from rvjax.four_bar.turn import Score, Wave, largest_and_smallest
from rvjax.four_bar.unit import Unit, Vector
from rvjax.records import Array, Record, field, record
from rvjax.status import SolveInfo, Status, at_once

PARTS = ("error", "misfit")  # of a turn's statistics
_SMALL = 1 / 64  # displacements over crank circle radius up to which the bound of `first_wave` holds


@record
class Figures(Record):
    """Statistics of the transmission error over one crank turn."""

    maximum: Array = field("rad", "largest error")
    minimum: Array = field("rad", "smallest error")
    peak_to_peak: Array = field("rad", "maximum less minimum")
    largest_misfit: Array = field("m", "largest |misfit| over angles and discs")
    info: SolveInfo = field("-", "of the worst angle", kind="record")


def extremes(unit: Unit, angles: int, wanted: tuple[str, ...] = PARTS) -> Figures:
    """Statistics of phase-locked cranks from the extremes only; NaN where not required.

    Args:
        unit: scaled design and errors.
        angles: number of uniform crank angles.
        wanted: of `PARTS`.
    """
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


def _under_load(unit: Unit, angles: int) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest error."""
    fits = [fit(unit, k) for k in range(len(unit.parts.disc))]

    def vectors(parts: tuple[Unit, list[Fit]], first: Crank) -> list[Vector]:
        unit, fits = parts
        scale = 1 / (len(unit.axes) * unit.radius**2)  # vectors near 1, however many are multiplied
        sides = [vector(unit, own, unit.disc_crank(k, first)) for k, own in enumerate(fits)]
        return [(scale * cosine, scale * sine) for cosine, sine in sides]

    def error(parts: tuple[Unit, list[Fit]], first: Crank) -> jax.Array:
        return _mean_angle(vectors(parts, first))

    def of(parts: tuple[Unit, list[Fit]]) -> Callable[[Crank], jax.Array]:
        return lambda first: monotone_angle(functools.reduce(_times, vectors(parts, first)))

    score = Score(of, back=lambda score: _angle(score) / len(fits))
    return largest_and_smallest(error, (unit, fits), angles, score=score, together=4)


def _without_load(unit: Unit, angles: int) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest error: every disc's vector is still + turning u with the crank's direction u."""
    axes, count = unit.axes, len(unit.parts.disc)

    def discs(parts: Turning) -> list[tuple[Vector, Vector]]:
        """1 + still and turning of each disc, in the direction of the first crank."""
        vectors = []
        for k in range(count):
            (x, y), moved = still_and_turning(axes, parts, k)
            turned = unit.disc_crank(k, Crank(*moved))
            vectors.append(((1 + x, y), (turned.cosine, turned.sine)))
        return vectors

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


def most_misfit(unit: Unit, angles: int) -> jax.Array:
    """Largest size of a misfit over uniform crank angles and all discs."""

    def most(parts: tuple[Unit, list[Fit]], first: Crank) -> jax.Array:
        unit, fits = parts
        each = [jnp.abs(misfit(unit, own, unit.disc_crank(k, first))) for k, own in enumerate(fits)]
        return jnp.max(jnp.stack(each))

    discs = range(len(unit.parts.disc))
    if len(unit.axes) == 2 and unit.load is None:
        return jnp.max(jnp.stack([jnp.abs(end) for k in discs for end in _of_two(unit, k, angles)]))
    return largest_and_smallest(most, (unit, [fit(unit, k) for k in discs]), angles, together=4)[0]


_Apart = tuple[jax.Array, tuple[jax.Array, jax.Array], jax.Array]
"""Crank radius, fixed and moving part of the distance of the pins, excess of the bores."""


def _of_two(unit: Unit, k: int, angles: int) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest misfit of a disc on two cranks without load.

    The pins lie w = l + still + moving u apart, u the eccentric direction, and |w|^2 is a constant plus one harmonic,
    2 Re(conj(l + still) moving u): the misfit, which rises with |w|, is largest next to its crest.
    """
    turn = unit.disc_crank(k, Crank(1, 0))

    def value(parts: _Apart, first: Crank) -> jax.Array:
        radius, (still, moving), excess = parts
        crank = first.turned(turn.cosine, turn.sine)
        moved = crank.turned(jnp.real(moving), jnp.imag(moving))
        return stretch(2 * radius, jnp.real(still) + moved.cosine, jnp.imag(still) + moved.sine) - excess

    def wave(parts: _Apart) -> Wave:
        radius, (still, moving), _ = parts
        back = Crank(2 * radius + jnp.real(still), -jnp.imag(still))
        place = back.turned(jnp.real(moving), jnp.imag(moving)).turned(turn.cosine, turn.sine)
        return Wave(place.cosine, -place.sine, jnp.zeros_like(place.cosine))

    parts = (unit.radius, apart(unit, k), bore_excess(unit, k))
    score = Score(lambda parts: lambda first: value(parts, first), lambda value: value, wave)
    return largest_and_smallest(value, parts, angles, score=score, together=4)
