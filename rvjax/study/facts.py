"""Derived values of a design: ratio, gaps, undercut, contact ratio."""

import math
from collections.abc import Iterator

from rvjax.compile_cache import ONCE, quick
from rvjax.designs import CamRollerReducer, InvoluteStage, RVReducer
from rvjax.geometry import contact_ratio, least_convex_radius
from rvjax.plausible import shown
from rvjax.records import Array, Design, Scalar


def facts_of(design: Design) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design; nothing for a kind that is not in the catalogue."""
    if isinstance(design, CamRollerReducer):
        yield "rollers", str(design.gear_teeth + 1)
    if not isinstance(design, RVReducer):
        return
    cycloid, stage = design.cycloid, design.involute
    gap = 2 * (cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count) - cycloid.pin_radius)
    k1 = cycloid.shortening_coefficient
    smallest, ratio = map(float, _geometry(k1, stage, cycloid.pin_count))
    least = smallest * cycloid.pin_circle_radius
    yield "ratio", f"{design.ratio:.6g}"
    yield "K1", f"{float(k1):.4g}"
    yield "gap between pins", shown(gap, "m")
    sharp = "undercut" if cycloid.pin_radius >= least else "no undercut"
    yield (
        "largest pin without undercut",
        f"{shown(least, 'm')} radius; the pins have {shown(cycloid.pin_radius, 'm')}: {sharp}",
    )
    yield "contact ratio of the gears", f"{ratio:.3g} (teeth without shift)"


@quick(2, options=ONCE)  # one program instead of one for each operation
def _geometry(k1: Scalar, stage: InvoluteStage, pins: int) -> tuple[Array, Array]:
    """Least radius without undercut over that of the pin circle, and contact ratio."""
    return least_convex_radius(k1, pins=pins), contact_ratio(stage)
