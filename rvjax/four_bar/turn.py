"""Largest and smallest value over a crank turn; its derivative is that at the place where they occur.

A forward pass searches values alone, of a score that rises with what is wanted but costs less. Its result is one
complex number: XLA repeats for each result everything that leads to it. A derivative searches the places and is
taken there, of what is wanted itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import arctan2, sin_cos
from rvjax._jax.kernels import once_more, scan, settle
from rvjax.four_bar.closures import Crank
from rvjax.records import PyTree

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
    value: Callable[[PyTree, Crank], jax.Array],
    parts: PyTree,
    angles: int,
    *,
    score: Score | None = None,
    together: int,
) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest value over uniform angles from zero.

    Args:
        value: (parts, crank) -> number.
        parts: pytree; leaves that are not arrays stay constants, so that XLA can fold them.
        angles: how many.
        score: of the value; by default the value itself.
        together: angles in one pass through memory; the program grows with them.
    """
    if score is None:
        score = Score(lambda parts: lambda crank: value(parts, crank), lambda value: value)
    leaves, tree = jax.tree.flatten(parts)
    is_array = [isinstance(leaf, jax.Array) for leaf in leaves]

    def whole(arrays: list[jax.Array]) -> PyTree:
        rest = iter(arrays)
        return jax.tree.unflatten(tree, [next(rest) if varies else leaf for leaf, varies in zip(leaves, is_array)])

    def found(arrays: list[jax.Array], places: bool) -> tuple[jax.Array, jax.Array]:
        """Largest and smallest score, or the numbers of the angles where they occur."""
        if score.wave is None or angles < 2 * _BESIDE + 2:
            both = settle(_all(score.of(whole(arrays)), angles, places, together))
        else:
            parts = whole(arrays)
            both = settle(_near(score.of(parts), score.wave(parts), angles, places))
            todo = jnp.isnan(jnp.real(both))
            both = once_more(lambda arrays: _at_once(score.of(whole(arrays)), angles, places), arrays, both, todo)
        return jnp.real(both), jnp.imag(both)

    @jax.custom_jvp
    def search(arrays: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
        most, least = found(arrays, False)
        return score.back(most), score.back(least)

    @search.defjvp
    def _rule(primals: PyTree, tangents: PyTree) -> PyTree:
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


def _all(along: Callable[[Crank], jax.Array], angles: int, places: bool, together: int) -> jax.Array:
    """Largest and smallest score of all angles as one complex number, or where they occur."""
    index = np.arange(angles)
    turn = (np.cos(2 * np.pi * index / angles), np.sin(2 * np.pi * index / angles), index)
    first = along(Crank(1, 0))

    def step(best: PyTree, place: PyTree) -> PyTree:
        cosine, sine, index = place
        now = along(Crank(cosine, sine))
        if not places:
            return (jnp.maximum(best[0], now), jnp.minimum(best[1], now)), None
        most, least, where_most, where_least = best
        up, down = now > most, now < least
        where = jnp.where(up, index, where_most), jnp.where(down, index, where_least)
        return (jnp.where(up, now, most), jnp.where(down, now, least), *where), None

    start = (first, first, *([jnp.zeros_like(first)] * 2 if places else []))
    best, _ = scan(step, start, [jnp.asarray(x[1:], first.dtype) for x in turn], unroll=together)
    return jax.lax.complex(*best[-2:])


def _at_once(along: Callable[[Crank], jax.Array], angles: int, places: bool) -> jax.Array:
    """`_all` with all angles together: for few batch elements, where starting a kernel costs more than its work."""
    index = np.arange(angles)
    every = settle(along(Crank(np.cos(2 * np.pi / angles * index), np.sin(2 * np.pi / angles * index))))
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
    sure = wave.rest**2 < (wave.cosine**2 + wave.sine**2) * np.sin(_BESIDE * step / 2) ** 2  # false for NaN

    below = jnp.floor(arctan2(wave.sine, wave.cosine) / step)
    sine, cosine = sin_cos(below * step)

    def extreme(sign: int, below: jax.Array, cosine: jax.Array, sine: jax.Array) -> jax.Array:
        best, where = jnp.full_like(below, -sign * jnp.inf), below
        for j in range(1 - _BESIDE, 1 + _BESIDE):
            now = along(Crank(cosine, sine).turned(np.cos(j * step), np.sin(j * step)))
            better = now > best if sign > 0 else now < best
            best, where = jnp.where(better, now, best), jnp.where(better, below + j, where)
        return jnp.mod(where, angles) if places else best

    crest = jnp.where(sure, extreme(1, below, cosine, sine), jnp.nan)
    # An odd number of angles has none opposite to another: half a step off, which leaves the bound as it is.
    half, ahead = angles // 2, Crank(-cosine, -sine)
    if angles % 2:
        ahead = Crank(cosine, sine).turned(np.cos(half * step), np.sin(half * step))
    return jax.lax.complex(crest, extreme(-1, below + half, ahead.cosine, ahead.sine))
