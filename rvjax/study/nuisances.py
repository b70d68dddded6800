"""Nuisances of a bench: contributions to a measurement that are not errors of parts."""

import math
from collections.abc import Iterable, Sequence

from rvjax.records import Design
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec

WIDE = 3000 * arcsec
NUISANCES: dict[str, str] = {
    "offset": "zero of the angle readings, one for all runs; with it the means of the runs count",
    "mounting": "eccentricity of the encoders, [cosine, sine] of order 1; with it order 1 counts",
    "phase": "angle of the index mark, where there is none",
    "reading": "motion of a head against the scale under load: oval ring, tilt, dent, each [cosine, sine] of the head",
    "drag": "friction torque at the output that opposes the motion, independent of speed",
    "viscous_drag": "friction torque at the output that opposes the motion, over the speed of the input",
}
DRAGS = {"drag": ("N m", 1000.0), "viscous_drag": ("N m s/rad", 10.0)}
"""Unit and half-width of the nuisances that are torques; the others are angles."""


def nuisance(name: str, orders: Sequence[int]) -> Tolerance:
    """The prior of a nuisance of the bench.

    Args:
        name: of `NUISANCES`.
        orders: of the output turn that are measured; a phase is seen up to their common turn.
    """
    if name == "phase":
        half = math.pi / math.gcd(*orders)
        return Tolerance(-half, half, distribution="uniform")
    if name in DRAGS:
        return Tolerance.symmetric(DRAGS[name][1])
    shape = {"mounting": (2,), "reading": (6,)}.get(name, ())
    return Tolerance.symmetric(WIDE, shape=shape, vector=False) if shape else Tolerance.symmetric(WIDE)


def part_orders(design: Design, orders: Iterable[int]) -> tuple[int, ...]:
    """The orders that only errors of parts or the mounting of the scale make: no harmonic of the housing has them.

    With the ring at rest: |zp P - m| with P = m + c s is zc P + c s but for its sign (`loaded.housing_orders`), with c
    equal places where discs and carrier meet. With the carrier at rest: multiples of the pins.

    Args:
        design: the reducer; its places are equal.
        orders: of the output turn.
    """
    counts = getattr(design, "counts", {})
    common = math.gcd(counts.get("teeth", 1), counts.get(getattr(design, "places", ""), 1))
    if getattr(design, "member", "carrier") == "ring":
        common = counts["pins"]
    return tuple(order for order in orders if order % common)
