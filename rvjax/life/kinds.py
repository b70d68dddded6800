"""Kinds of reducers whose bearings have a life: what differs besides the forces."""

from collections.abc import Callable
from typing import NamedTuple

import jax

from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.records import PyTree


class Kind(NamedTuple):
    """Of the cranks and their bearings. A crank makes pin_count turns against its disc in one of the output."""

    supports: bool  # whether the bearings besides those of the discs are rated
    sense: Callable[[PyTree], int]  # of the crank against disc and carrier for a positive turn of the output
    torque: Callable[
        [PyTree, jax.Array, jax.Array], jax.Array
    ]  # of the output by a disc, about, by (e, force of an arm)


def _of_cranks(design: RVReducer, eccentricity: jax.Array, force: jax.Array) -> jax.Array:
    return force * design.cranks.circle_radius * design.counts["cranks"]


def _of_shaft(design: CycloidalReducer, eccentricity: jax.Array, force: jax.Array) -> jax.Array:
    return force * eccentricity * abs(design.ratio)


def _sense_of_shaft(design: CycloidalReducer) -> int:
    return 1 if design.ratio > 0 else -1


KINDS: dict[type, Kind] = {
    RVReducer: Kind(True, lambda design: -1, _of_cranks),
    CycloidalReducer: Kind(False, _sense_of_shaft, _of_shaft),
}


def crank_order(design: PyTree) -> int:
    """Order of the output revolution, in the frame of the carrier, of a force that turns with the cranks.

    Args:
        design: one of `KINDS`.
    """
    return kind_of(design).sense(design) * int(design.counts["pins"])


def kind_of(design: PyTree) -> Kind:
    """Entry of `KINDS` for a design.

    Args:
        design: one of `KINDS`.
    """
    return next(kind for cls, kind in KINDS.items() if isinstance(design, cls))
