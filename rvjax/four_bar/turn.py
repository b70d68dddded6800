"""Largest and smallest value over a crank turn; its derivative is that at the place where they occur.

A forward pass searches values alone, of a score that rises with what is wanted but costs less. Its result is one
complex number: XLA evaluates for each result anew all that leads to it. A derivative searches the places and is
taken there, of what is wanted itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.elementary import sin_cos
from rvjax.four_bar.closures import Crank
from rvjax.records import PyTree, Scalar


class Score(NamedTuple):
    """A number that rises with the value sought and costs less."""

    of: Callable[[Any], Callable[[Crank], jax.Array]]  # parts -> (crank -> score)
    back: Callable[[jax.Array], jax.Array]  # score -> value


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
    index = np.arange(angles)
    turn = (np.cos(2 * np.pi * index / angles), np.sin(2 * np.pi * index / angles), index)

    def whole(arrays: list[jax.Array]) -> PyTree:
        rest = iter(arrays)
        return jax.tree.unflatten(tree, [next(rest) if varies else leaf for leaf, varies in zip(leaves, is_array)])

    def over_turn(
        arrays: list[jax.Array], start: PyTree, step: Callable[..., PyTree], pair: Callable[..., PyTree]
    ) -> PyTree:
        along = score.of(whole(arrays))
        first = along(Crank(1, 0))
        places = [jnp.asarray(x[1:], first.dtype) for x in turn]

        def one(found: PyTree, place: PyTree) -> PyTree:
            cosine, sine, index = place
            return step(found, along(Crank(cosine, sine)), index), None

        found, _ = jax.lax.scan(one, start(first), places, unroll=together)
        both = settle(jax.lax.complex(*pair(found)))
        return jnp.real(both), jnp.imag(both)

    @jax.custom_jvp
    def search(arrays: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
        def step(best: PyTree, now: jax.Array, index: Scalar) -> PyTree:
            return jnp.maximum(best[0], now), jnp.minimum(best[1], now)

        most, least = over_turn(arrays, lambda first: (first, first), step, lambda best: best)
        return score.back(most), score.back(least)

    @search.defjvp
    def _rule(primals: PyTree, tangents: PyTree) -> PyTree:
        (arrays,), (changes,) = primals, tangents

        def step(best: PyTree, now: jax.Array, index: Scalar) -> PyTree:
            most, least, where_most, where_least = best
            up, down = now > most, now < least
            return (
                jnp.where(up, now, most),
                jnp.where(down, now, least),
                jnp.where(up, index, where_most),
                jnp.where(down, index, where_least),
            )

        def start(first: jax.Array) -> PyTree:
            return first, first, jnp.zeros_like(first), jnp.zeros_like(first)

        places = []
        for index in over_turn(arrays, start, step, lambda best: best[2:]):
            sine, cosine = sin_cos(index * (2 * np.pi / angles))
            places.append(Crank(cosine, sine))
        return jax.jvp(lambda arrays: tuple(value(whole(arrays), at) for at in places), (arrays,), (changes,))

    return search([leaf for leaf, varies in zip(leaves, is_array) if varies])


def settle(x: jax.Array) -> jax.Array:
    """x, stored: what follows reads it instead of evaluating it anew. XLA looks through all but a loop."""
    return jax.lax.fori_loop(0, 2, lambda _, x: -x, x)
