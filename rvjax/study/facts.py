"""Derived values of a design: ratio, gaps, undercut, contact ratio."""

import math
from collections.abc import Iterator

import numpy as np

from rvjax.designs import CamRollerReducer, InvoluteStage, RVReducer
from rvjax.records import Design
from rvjax.study.plausible import shown


def facts_of(design: Design) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design; nothing for a kind that is not in the catalogue."""
    if isinstance(design, CamRollerReducer):
        yield "rollers", str(design.gear_teeth + 1)
    if not isinstance(design, RVReducer):
        return
    cycloid, stage = design.cycloid, design.involute
    gap = 2 * (cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count) - cycloid.pin_radius)
    least = least_curvature_radius(float(cycloid.shortening_coefficient), cycloid.pin_count) * cycloid.pin_circle_radius
    yield "ratio", f"{design.ratio:.6g}"
    yield "K1", f"{float(cycloid.shortening_coefficient):.4g}"
    yield "gap between pins", shown(gap, "m")
    sharp = "undercut" if cycloid.pin_radius >= least else "no undercut"
    yield (
        "largest pin without undercut",
        f"{shown(least, 'm')} radius; the pins have {shown(cycloid.pin_radius, 'm')}: {sharp}",
    )
    yield "contact ratio of the gears", f"{contact_ratio(stage):.3g} (teeth without shift)"


def least_curvature_radius(shortening: float, pins: int) -> float:
    """Least radius of convex curvature of the pins' path around a disc, in pin circle radii.

    The path is an epitrochoid of curvature (K1 (zp + 1) c - 1 - zp K1^2)/(1 + K1^2 - 2 K1 c)^(3/2), c the cosine of the
    pin's angle from the eccentric; a disc is the path offset by the pin radius, so that its flank has a cusp where the
    pin is larger than the radius of the path on the side of the disc.

    Args:
        shortening: K1.
        pins: zp.
    """
    c = np.linspace(-1.0, 1.0, 4001)
    bend = 1 + pins * shortening**2 - shortening * (pins + 1) * c  # > 0: convex, seen from the disc
    radius = (1 + shortening**2 - 2 * shortening * c) ** 1.5 / np.where(bend > 0, bend, np.nan)
    return float(np.nanmin(radius))


def contact_ratio(stage: InvoluteStage) -> float:
    """Transverse contact ratio of sun and planet at their centre distance, with tips of standard height."""
    bases = float(stage.sun_base_radius), float(stage.planet_base_radius)
    working = math.acos(min(1.0, sum(bases) / float(stage.centre_distance)))
    tips = (float(stage.module) * (teeth + 2) / 2 for teeth in (stage.sun_teeth, stage.planet_teeth))
    path = sum(math.sqrt(max(0.0, tip**2 - base**2)) for tip, base in zip(tips, bases))
    pitch = float(stage.module) * math.pi * math.cos(float(stage.pressure_angle))
    return (path - float(stage.centre_distance) * math.sin(working)) / pitch
