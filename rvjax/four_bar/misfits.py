"""Largest misfit of phase-locked discs over a crank turn."""

import jax
import jax.numpy as jnp

from rvjax.four_bar.closures import Crank, stretch
from rvjax.four_bar.fit import apart, bore_excess, fit, misfit
from rvjax.four_bar.turn import Score, Wave, largest_and_smallest
from rvjax.four_bar.unit import Unit
from rvjax.records import PyTree


def most_misfit(unit: Unit, angles: int) -> jax.Array:
    """Largest size of a misfit over uniform crank angles and all discs."""

    def most(parts: PyTree, first: Crank) -> jax.Array:
        unit, fits = parts
        each = [jnp.abs(misfit(unit, own, unit.disc_crank(k, first))) for k, own in enumerate(fits)]
        return jnp.max(jnp.stack(each))

    discs = range(len(unit.parts.disc))
    if len(unit.axes) == 2 and unit.load is None:
        return jnp.max(jnp.stack([jnp.abs(end) for k in discs for end in _of_two(unit, k, angles)]))
    return largest_and_smallest(most, (unit, [fit(unit, k) for k in discs]), angles, together=4)[0]


def _of_two(unit: Unit, k: int, angles: int) -> tuple[jax.Array, jax.Array]:
    """Largest and smallest misfit of a disc on two cranks without load.

    The pins lie w = l + still + moving u apart, u the eccentric direction, and |w|^2 is a constant plus one harmonic,
    2 Re(conj(l + still) moving u): the misfit, which rises with |w|, is largest next to its crest.
    """
    turn = unit.disc_crank(k, Crank(1, 0))

    def value(parts: PyTree, first: Crank) -> jax.Array:
        radius, (still, moving), excess = parts
        crank = first.turned(turn.cosine, turn.sine)
        moved = crank.turned(jnp.real(moving), jnp.imag(moving))
        return stretch(2 * radius, jnp.real(still) + moved.cosine, jnp.imag(still) + moved.sine) - excess

    def wave(parts: PyTree) -> Wave:
        radius, (still, moving), _ = parts
        back = Crank(2 * radius + jnp.real(still), -jnp.imag(still))
        found = back.turned(jnp.real(moving), jnp.imag(moving)).turned(turn.cosine, turn.sine)
        return Wave(found.cosine, -found.sine, jnp.zeros_like(found.cosine))

    parts = (unit.radius, apart(unit, k), bore_excess(unit, k))
    score = Score(lambda parts: lambda first: value(parts, first), lambda value: value, wave)
    return largest_and_smallest(value, parts, angles, score=score, together=4)
