"""Errors of one unit from measured parts: possible positions of a part, and its errors in each position.

Disc and carrier meet at c equal places: the cranks of an RV reducer, the output pins of a single-stage drive. A disc
may be turned by their spacing, and turned over about the x axis, if its teeth are then where the slot requires them.
Teeth: the tooth spaces of disc k are at (t - k/nd) 2 pi/zc at input angle 0, and tooth t is before its space
(docs/models/loaded.md, Eqs. 2 and 6). So a disc made for slot k0, turned by i spacings, fits slot k where

    i zc/c + (k -+ k0)/nd   is a whole number of teeth (- as it is, + turned over),

and its tooth t becomes t + i zc/c + (k - k0)/nd, or 1 - t + i zc/c + (k + k0)/nd turned over. A carrier has no teeth:
it may be turned by any number of spacings.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from rvjax.base.fields import axis_sizes
from rvjax.base.words import unknown
from rvjax.cycloidal import Reducer
from rvjax.errors import described
from rvjax.records import Array, Design, PyTree, Scalar

AXES = {"disc": "discs", "crank": "cranks"}
"""Parts that a reducer has several of, and their axis in the arrays of errors."""


class Mounting(NamedTuple):
    """A position of a disc in its slot."""

    turn: int  # spacings of the places, counter-clockwise
    over: bool  # turned over about the x axis first


def carried(design: Design, part: str) -> dict[str, tuple[int, ...]]:
    """Errors that one part carries from slot to slot, with their shapes: those of a disc as it lies in the slot it is
    made for, without the axis of discs; those of a crankshaft with its planet without the axis of cranks.

    Args:
        design: counts and error record are read.
        part: "disc", "crank" or "carrier".
    """
    axes = described(design.error_record, "shape")
    names = (name for name, by in described(design.error_record, "carried_by").items() if by == part)
    own = {name: tuple(axis for axis in axes[name] if axis != AXES.get(part)) for name in names}
    return {name: axis_sizes(left, design.counts) for name, left in own.items()}


def disc_mountings(design: PyTree, slot: int, *, made_for: int = 0) -> tuple[Mounting, ...]:
    """Positions in which a disc fits a slot, by index; empty where the slot needs another disc.

    Args:
        design: counts are read.
        slot: k, counted from 0.
        made_for: slot k0 of the drawing.
    """
    zc, discs, places = (design.counts[axis] for axis in ("teeth", "discs", design.places))
    found = []
    for over in (False, True):
        start = made_for if over else -made_for
        for turn in range(places):
            if (turn * zc * discs + (slot + start) * places) % (places * discs) == 0:
                found.append(Mounting(turn, over))
    return tuple(found)


def mounted_disc(
    design: Reducer,
    errors: Mapping[str, Scalar],
    slot: int,
    index: int | Array,
    *,
    made_for: int = 0,
) -> dict[str, Array]:
    """Errors of a disc in a slot.

    Args:
        design: counts are read.
        errors: of the disc, those of `carried`.
        slot: k, counted from 0.
        index: of `disc_mountings`; may be traced.
        made_for: slot k0 of the drawing.

    Raises:
        ValueError: the disc does not fit the slot, or an error that no disc has.
    """
    mountings = disc_mountings(design, slot, made_for=made_for)
    if not mountings:
        raise ValueError(f"disc_{slot}: a disc made for slot {made_for} does not fit there")
    shapes = carried(design, "disc")
    for name in errors:
        if name not in shapes:
            raise unknown(f"disc_{slot}: {name} is no error of one disc", name, shapes, "; there are")
    zc, discs, places = (design.counts[axis] for axis in ("teeth", "discs", design.places))
    hand = np.array([-1 if m.over else 1 for m in mountings])
    turn = np.array([m.turn for m in mountings])
    # The bore or hole, and the tooth, whose place number q has now.
    place = (hand[:, None] * (np.arange(places) - turn[:, None])) % places
    start = np.where(hand > 0, -made_for, made_for)
    moved = (turn * zc * discs + (slot + start) * places) // (places * discs) + (hand < 0)
    tooth = (hand[:, None] * (np.arange(zc) - moved[:, None])) % zc
    turned = _turns(2 * np.pi * turn / places, hand)
    found: dict[str, Array] = {}
    record = design.error_record
    axes, vectors, mirrored = (described(record, key) for key in ("shape", "vector", "mirrored"))
    for name, value in errors.items():
        given = jnp.asarray(value)
        moved = jnp.broadcast_to(given, shapes[name])
        for axis, around in ((design.places, place), ("teeth", tooth)):
            if axis in axes[name]:
                moved = jnp.take(moved, jnp.asarray(around)[index], axis=axes[name].index(axis) - 1)  # no axis of discs
        if vectors.get(name) == "xy":
            moved = jnp.asarray(turned, given.dtype)[index] @ moved
        else:
            sides = jnp.asarray([np.ones_like(mirrored[name]), mirrored[name]], given.dtype)  # as it is, turned over
            moved = moved * jnp.broadcast_to(sides[jnp.asarray(hand < 0, int)[index]], moved.shape)
        found[name] = moved
    return found


def unit_errors(design: Reducer, parts: Mapping[str, Mapping[str, Scalar]], index: Mapping[str, int | Array]) -> PyTree:
    """Errors of a unit from its parts, in the error record of the design.

    Slots: "disc_0", "disc_1" .. (made for slot 0 where such a disc fits, else for their own), "carrier", of an RV
    reducer "crank_0" .., and any other name for parts that hold whole errors (bearings, pins, ring, sun, shaft).

    Args:
        design: counts are read.
        parts: errors of the part in each slot.
        index: position of each part; of discs as in `disc_mountings`, of a carrier in spacings of the places.

    Raises:
        ValueError: an error that such a part does not have, an error in two slots, or a slot that the design
            lacks.
    """
    discs, cranks, places = (design.counts[axis] for axis in ("discs", "cranks", design.places))
    of_crank, of_carrier = carried(design, "crank"), carried(design, "carrier")
    axes, vectors = (described(design.error_record, key) for key in ("shape", "vector"))
    turns = _turns(2 * np.pi * np.arange(places) / places)
    fields: dict[str, Scalar] = {}
    by_disc: dict[str, dict[int, Array]] = {}
    by_crank: dict[str, dict[int, Array]] = {}
    for slot, errors in parts.items():
        kind, _, number = slot.rpartition("_")
        if kind == "disc" and number.isdigit():
            place = _place(slot, number, discs)
            own = mounted_disc(design, errors, place, index[slot], made_for=drawing(design, place))
            for name, moved in own.items():
                by_disc.setdefault(name, {})[place] = moved
        elif kind == "crank" and number.isdigit() and of_crank:
            place = _place(slot, number, cranks)
            for name, value in errors.items():
                if name not in of_crank:
                    raise unknown(f"{slot}: {name} is no error of one crank", name, of_crank, "; there are")
                by_crank.setdefault(name, {})[place] = jnp.broadcast_to(jnp.asarray(value), of_crank[name])
        else:
            for name, value in errors.items():
                if name in fields:
                    raise ValueError(f"{slot}: {name} is in another slot already")
                fields[name] = value
                if slot == "carrier" and name in of_carrier:
                    spread = jnp.broadcast_to(jnp.asarray(value), of_carrier[name])
                    if vectors.get(name) == "xy":
                        fields[name] = jnp.asarray(turns, spread.dtype)[index[slot]] @ spread
                    else:
                        around = (jnp.arange(places) - index[slot]) % places
                        fields[name] = jnp.take(spread, around, axis=axes[name].index(design.places))
    for groups, along in ((by_disc, "discs"), (by_crank, "cranks")):
        for name, values in groups.items():
            absent = jnp.zeros_like(next(iter(values.values())))
            whole = [values.get(place, absent) for place in range(design.counts[along])]
            fields[name] = jnp.stack(whole, axes[name].index(along))
    return design.error_record(**fields)


def _turns(angle: np.ndarray, hand: np.ndarray | int = 1) -> np.ndarray:
    """Matrices (n, 2, 2) that turn by angles (n,), after turning over about the x axis where `hand` is -1."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine, -hand * sine, sine, hand * cosine], 1).reshape(-1, 2, 2)


def drawing(design: object, slot: int) -> int:
    """Slot of the drawing of a disc: 0 if such a disc fits, else the slot itself.

    Args:
        design: counts are read.
        slot: k, counted from 0.
    """
    return 0 if disc_mountings(design, slot) else slot


def _place(slot: str, number: str, count: int) -> int:
    if int(number) >= count:
        raise ValueError(f"{slot}: this design has {count} of them, counted from 0")
    return int(number)
