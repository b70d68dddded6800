"""Pins of the ring, of RV reducers and single-stage drives: what follows from their numbers, and what cannot be."""

import math
from collections.abc import Iterator

from rvjax.catalogue import sharp_from, shown
from rvjax.designs import CycloidStage


def half_pitch(cycloid: CycloidStage) -> float:
    """Half of the distance of neighbouring pins of the ring, m: pins of this radius touch."""
    return float(cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count))


def pin_facts(cycloid: CycloidStage) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a cycloid stage.

    Args:
        cycloid: numbers, not traced.
    """
    least = sharp_from(cycloid)
    sharp = "undercut" if cycloid.pin_radius >= least else "no undercut"
    yield "K1", f"{float(cycloid.shortening_coefficient):.4g}"
    yield "gap between pins", shown(2 * (half_pitch(cycloid) - cycloid.pin_radius), "m")
    yield (
        "largest pin without undercut",
        f"{shown(least, 'm')} radius; the pins have {shown(cycloid.pin_radius, 'm')}: {sharp}",
    )


def refuse_overlap(cycloid: CycloidStage) -> None:
    """Raise an error for pins of the ring that overlap.

    Raises:
        ValueError: names the key and its value.
    """
    if cycloid.pin_radius >= (pitch := half_pitch(cycloid)):
        raise ValueError(
            f"design.cycloid.pin_radius = {shown(cycloid.pin_radius, 'm')}: the pins overlap from {shown(pitch, 'm')} "
            f"on ({cycloid.pin_count} pins on a circle of radius {shown(cycloid.pin_circle_radius, 'm')})"
        )
