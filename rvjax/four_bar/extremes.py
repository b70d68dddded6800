"""Extremes of the transmission error and of the misfit over a crank turn, of phase-locked cranks without the curve.

A forward pass searches values alone, of a score that rises with what is wanted but costs less. Its result is one
complex number: XLA repeats for each result everything that leads to it. A derivative searches the places and is
taken there, of what is wanted itself.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax._jax.elementary import arctan2, sin_cos
from rvjax._jax.kernels import once_more, scan, settle
from rvjax.four_bar.closures import Crank, stretch
from rvjax.four_bar.disc_fit import (
    Fit,
    Polynomial,
    Turning,
    angle_of,
    apart,
    bore_excess,
    direction,
    fit,
    misfit,
    monotone_angle,
    product,
    still_and_turning,
    times,
    turning,
    vector,
)
from rvjax.four_bar.unit import Unit, Vector
from rvjax.records import Array, Record, field, record
from rvjax.status import SolveInfo, Status, at_once

Parts = TypeVar("Parts")
Arrays = tuple[list[jax.Array]]
Pair = tuple[jax.Array, jax.Array]

_TOGETHER = 4  # angles in one pass through memory; the program grows with them
_BESIDE = 2  # angles on either side of the crest of a first harmonic that are looked at


class Score(NamedTuple):
    """A number that rises with the value sought and costs less."""

    of: Callable[[Any], Callable[[Crank], jax.Array]]  # parts -> (crank -> score)
    back: Callable[[jax.Array], jax.Array]  # score -> value
    wave: Callable[[Any], "Wave"] | None = None  # parts -> first harmonic of a number that rises with the score


class Wave(NamedTuple):
    """First harmonic amplitude cos(angle - place) of a periodic number, and a bound of all the others.

    Of uniform angles with distance h the number is largest at one of the `2 k` nearest to the place, k on either side,
    if the m-th harmonics are of size r_m with sum m r_m < amplitude sin(k h / 2). For of two angles a and b from the
    place the first harmonic's difference is 2 amplitude sin((a + b) / 2) sin((b - a) / 2), and the others' is at most
    2 sum m r_m |sin((b - a) / 2)|; with a the nearest angle on one side and b beyond the k-th, |a + b| / 2 >= k h / 2.
    """

    cosine: jax.Array  # amplitude cos(place)
    sine: jax.Array
    rest: jax.Array  # at least sum m r_m


def largest_and_smallest(
    value: Callable[[Parts, Crank], jax.Array],
    parts: Parts,
    angles: int,
    *,
    score: Score | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest value over uniform angles from zero.

    Args:
        value: (parts, crank) -> number.
        parts: pytree; leaves that are not arrays stay constants, so that XLA can fold them.
        angles: how many.
        score: of the value; by default the value itself.
    """
    if score is None:
        score = Score(lambda parts: lambda crank: value(parts, crank), lambda value: value)
    leaves, tree = jax.tree.flatten(parts)
    is_array = [isinstance(leaf, jax.Array) for leaf in leaves]

    def whole(arrays: list[jax.Array]) -> Parts:
        rest = iter(arrays)
        return jax.tree.unflatten(tree, [next(rest) if varies else leaf for leaf, varies in zip(leaves, is_array)])

    def found(arrays: list[jax.Array], places: bool) -> tuple[jax.Array, jax.Array]:
        """Largest and smallest score, or the numbers of the angles where they occur."""
        if score.wave is None or angles < 2 * _BESIDE + 2:
            both = settle(_all(score.of(whole(arrays)), angles, places))
        else:
            parts = whole(arrays)
            both = settle(_near(score.of(parts), score.wave(parts), angles, places))
            todo = jnp.isnan(jnp.real(both))
            dtype = jnp.finfo(arrays[0].dtype).dtype  # of complex numbers too
            both = once_more(
                lambda arrays: _at_once(score.of(whole(arrays)), angles, places, dtype), arrays, both, todo
            )
        return jnp.real(both), jnp.imag(both)

    @jax.custom_jvp
    def search(arrays: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
        most, least = found(arrays, False)
        return score.back(most), score.back(least)

    @search.defjvp
    def _rule(primals: Arrays, tangents: Arrays) -> tuple[Pair, Pair]:
        (arrays,), (changes,) = primals, tangents
        places = []
        for index in found(arrays, True):
            sine, cosine = sin_cos(index * (2 * np.pi / angles))
            at = settle(jax.lax.complex(cosine, sine))
            places.append(Crank(jnp.real(at), jnp.imag(at)))

        def there(arrays: list[jax.Array]) -> tuple[jax.Array, ...]:
            # What the discs' vectors are made of is stored, and so are its derivatives on their way back.
            stored = whole([settle(x) if jnp.iscomplexobj(x) else x for x in arrays])
            return tuple(value(stored, at) for at in places)

        (most, least), moved = jax.jvp(there, (arrays,), (changes,))
        both = settle(jax.lax.complex(most, least))
        return (jnp.real(both), jnp.imag(both)), moved

    return search([leaf for leaf, varies in zip(leaves, is_array) if varies])


def _all(along: Callable[[Crank], jax.Array], angles: int, places: bool) -> jax.Array:
    """Largest and smallest score of all angles as one complex number, or where they occur."""
    index = np.arange(angles)
    turn = (np.cos(2 * np.pi * index / angles), np.sin(2 * np.pi * index / angles), index)
    first = along(Crank(1, 0))

    def step(best: tuple[jax.Array, ...], place: tuple[jax.Array, ...]) -> tuple[tuple[jax.Array, ...], None]:
        cosine, sine, index = place
        now = along(Crank(cosine, sine))
        if not places:
            return (jnp.maximum(best[0], now), jnp.minimum(best[1], now)), None
        most, least, where_most, where_least = best
        up, down = now > most, now < least
        where = jnp.where(up, index, where_most), jnp.where(down, index, where_least)
        return (jnp.where(up, now, most), jnp.where(down, now, least), *where), None

    start = (first, first, *([jnp.zeros_like(first)] * 2 if places else []))
    best, _ = scan(step, start, [jnp.asarray(x[1:], first.dtype) for x in turn], unroll=_TOGETHER)
    return jax.lax.complex(*best[-2:])


def _at_once(along: Callable[[Crank], jax.Array], angles: int, places: bool, dtype: DTypeLike) -> jax.Array:
    """`_all` with all angles together: for few batch elements, where starting a kernel costs more than its work."""
    index = np.arange(angles)
    turn = 2 * np.pi / angles * index
    every = settle(along(Crank(np.cos(turn).astype(dtype), np.sin(turn).astype(dtype))))
    most, least = jnp.max(every), jnp.min(every)
    if places:  # several times as fast as argmax
        first = [jnp.min(jnp.where(every == best, index, angles)).astype(every.dtype) for best in (most, least)]
        most, least = (jnp.where(jnp.isnan(best), best, at) for best, at in zip((most, least), first))
    return jax.lax.complex(most, least)


def _near(along: Callable[[Crank], jax.Array], wave: Wave, angles: int, places: bool) -> jax.Array:
    """`_all` of the angles next to the crest and the trough of the first harmonic; NaN unless these decide.

    One number, for XLA repeats for each result everything that leads to it.
    """
    step = 2 * np.pi / angles
    sure = wave.rest**2 < (wave.cosine**2 + wave.sine**2) * math.sin(_BESIDE * step / 2) ** 2  # false for NaN

    below = jnp.floor(arctan2(wave.sine, wave.cosine) / step)
    sine, cosine = sin_cos(below * step)

    def extreme(sign: int, below: jax.Array, cosine: jax.Array, sine: jax.Array) -> jax.Array:
        best, where = jnp.full_like(below, -sign * jnp.inf), below
        for j in range(1 - _BESIDE, 1 + _BESIDE):
            now = along(Crank(cosine, sine).turned(math.cos(j * step), math.sin(j * step)))
            better = now > best if sign > 0 else now < best
            best, where = jnp.where(better, now, best), jnp.where(better, below + j, where)
        return jnp.mod(where, angles) if places else best

    crest = jnp.where(sure, extreme(1, below, cosine, sine), jnp.nan)
    # An odd number of angles has none opposite to another: half a step off, which leaves the bound as it is.
    half, ahead = angles // 2, Crank(-cosine, -sine)
    if angles % 2:
        ahead = Crank(cosine, sine).turned(math.cos(half * step), math.sin(half * step))
    return jax.lax.complex(crest, extreme(-1, below + half, ahead.cosine, ahead.sine))


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
        return lambda first: monotone_angle(functools.reduce(times, vectors(parts, first)))

    score = Score(of, back=lambda score: angle_of(score) / len(fits))
    return largest_and_smallest(error, (unit, fits), angles, score=score)


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
        together = product(discs(parts))
        return lambda first: monotone_angle(together.at((first.cosine, first.sine)))

    score = Score(of, back=lambda score: angle_of(score) / count, wave=lambda parts: first_wave(discs(parts)))
    return largest_and_smallest(error, turning(unit), angles, score=score)


def _mean_angle(vectors: list[Vector]) -> jax.Array:
    return -jnp.mean(jnp.stack([direction(cosine, sine) for cosine, sine in vectors]))


def first_wave(discs: list[tuple[Vector, Vector]]) -> Wave:
    """First harmonic of minus the sum of the discs' angles without load, and a bound of the others.

    With disc k at still_k + turning_k u_k and w_k = turning_k / still_k the sum is constant plus the imaginary part
    of sum_k log(1 + w_k u_k): first harmonic sum_k w_k u_k = u a1 / a0 in the coefficients of the product, and
    sum_m m |m-th| <= sum_k |w_k|^2 / (1 - |w_k|). Both times |a0|^2 here, to avoid the division.
    """
    (x0, y0), (x1, y1) = product(discs).coefficients[:2]
    small, squares = np.True_, 0
    for (x, y), (u, v) in discs:
        square = u**2 + v**2
        small &= (jnp.abs(x - 1) + jnp.abs(y) < _SMALL) & (square < _SMALL**2)
        squares += square
    of_squares = 1 / (1 - _SMALL) ** 2 / (1 - _SMALL / (1 - _SMALL))  # |still| >= 1 - _SMALL
    rest = jnp.where(small, of_squares * squares * (x0 * x0 + y0 * y0), jnp.inf)
    return Wave(y0 * x1 - x0 * y1, -(x0 * x1 + y0 * y1), rest)


def most_misfit(unit: Unit, angles: int) -> jax.Array:
    """Largest size of a misfit over uniform crank angles and all discs."""

    def most(parts: tuple[Unit, list[Fit]], first: Crank) -> jax.Array:
        unit, fits = parts
        each = [jnp.abs(misfit(unit, own, unit.disc_crank(k, first))) for k, own in enumerate(fits)]
        return jnp.max(jnp.stack(each))

    discs = range(len(unit.parts.disc))
    if len(unit.axes) == 2 and unit.load is None:
        return jnp.max(jnp.stack([jnp.abs(end) for k in discs for end in _of_two(unit, k, angles)]))
    return largest_and_smallest(most, (unit, [fit(unit, k) for k in discs]), angles)[0]


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
    return largest_and_smallest(value, parts, angles, score=score)
