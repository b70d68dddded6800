"""Extremes over a crank turn whose derivative is that at the place where they occur.

The values alone are searched, which is all that a forward pass needs. A derivative searches the places and is
then taken at one angle instead of at all of them.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.four_bar.closures import Crank

_UNROLL = 4  # angles per step: so many evaluations share one pass through memory


def largest_over_turn(
    scores: Callable[[Any, Crank], tuple[Any, ...]], parts: Any, crank_angle: jax.Array
) -> tuple[jax.Array, ...]:
    """Largest value of each score over the angles.

    Args:
        scores: (parts, crank) -> one score or two.
        parts: pytree; leaves that are not arrays stay constants, so that XLA can fold them.
        crank_angle: angles (angles,), without derivative.
    """
    leaves, tree = jax.tree.flatten(parts)
    is_array = [isinstance(leaf, jax.Array) for leaf in leaves]

    def whole(arrays: list[jax.Array]) -> Any:
        rest = iter(arrays)
        return jax.tree.unflatten(tree, [next(rest) if varies else leaf for leaf, varies in zip(leaves, is_array)])

    @jax.custom_jvp
    def largest(arrays: list[jax.Array]) -> tuple[jax.Array, ...]:
        return _values(lambda crank: scores(whole(arrays), crank), crank_angle)

    @largest.defjvp
    def _rule(primals: Any, tangents: Any) -> Any:
        (arrays,), (changes,) = primals, tangents
        places = _places(lambda crank: scores(whole(arrays), crank), crank_angle)

        def at_places(arrays: list[jax.Array]) -> tuple[Any, ...]:
            return tuple(scores(whole(arrays), place)[number] for number, place in enumerate(places))

        return jax.jvp(at_places, (arrays,), (changes,))

    return largest([leaf for leaf, varies in zip(leaves, is_array) if varies])


def _values(scores: Callable[[Crank], tuple[Any, ...]], crank_angle: jax.Array) -> tuple[jax.Array, ...]:
    """Two scores travel as one complex number: with a single result XLA evaluates what they share once."""
    turn = (jnp.cos(crank_angle), jnp.sin(crank_angle))
    first = _pair(scores(Crank(turn[0][0], turn[1][0])))

    def step(best: jax.Array, place: Any) -> Any:
        now = _pair(scores(Crank(*place)))
        if not jnp.iscomplexobj(now):
            return jnp.maximum(best, now), None
        return jax.lax.complex(
            jnp.maximum(jnp.real(best), jnp.real(now)), jnp.maximum(jnp.imag(best), jnp.imag(now))
        ), None

    best, _ = jax.lax.scan(step, first, jax.tree.map(lambda x: x[1:], turn), unroll=_UNROLL)
    return (jnp.real(best), jnp.imag(best)) if jnp.iscomplexobj(best) else (best,)


def _pair(values: tuple[Any, ...]) -> jax.Array:
    return values[0] if len(values) == 1 else jax.lax.complex(*values)


def _places(scores: Callable[[Crank], tuple[Any, ...]], crank_angle: jax.Array) -> list[Crank]:
    """Where each score is largest. Score and index travel as one complex number, see `_values`."""
    turn = (jnp.cos(crank_angle), jnp.sin(crank_angle))
    first = scores(Crank(turn[0][0], turn[1][0]))

    def step(best: list[jax.Array], place: Any) -> Any:
        cosine, sine, index = place
        after = []
        for old, now in zip(best, scores(Crank(cosine, sine))):
            up = now > jnp.real(old)
            after.append(jax.lax.complex(jnp.where(up, now, jnp.real(old)), jnp.where(up, index, jnp.imag(old))))
        return after, None

    rest = (turn[0][1:], turn[1][1:], jnp.arange(1, len(crank_angle), dtype=crank_angle.dtype))
    start = [jax.lax.complex(score, jnp.zeros_like(score)) for score in first]
    best, _ = jax.lax.scan(step, start, rest, unroll=_UNROLL)
    index = [jnp.imag(pair).astype(jnp.int32) for pair in best]
    return [Crank(turn[0][i], turn[1][i]) for i in index]
