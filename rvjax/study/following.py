"""Numbers of a design that follow from others.

Where a study changes what a number follows from, the number follows; where it gives both, they must agree. A published
design that contradicts itself keeps its numbers as long as nothing of that part is changed.
"""

import numpy as np

from rvjax.designs import InvoluteStage, RVReducer
from rvjax.records import Design, Scalar
from rvjax.study.values import Toml, subtable

GEARS = ("sun_teeth", "planet_teeth", "module", "pressure_angle")
PROFILE = ("eccentricity", "pin_count", "pin_circle_radius")
# Share by which a given number may differ from what it follows from: rounding of drawings; profile shift of the gears
# (one module at ten and thirty teeth); cranks off the planets' axes by a rounded shift (0.8 % in the RV-320E).
AGREE = {"sun_radius": 2e-3, "sun_base_radius": 2e-3, "planet_base_radius": 2e-3, "centre_distance": 0.05}
AGREE_CIRCLE = 0.02


def followed(design: Design, given: Toml) -> Design:
    """The design, with what follows from the numbers that a study gives.

    Raises:
        ValueError: a given number contradicts those it follows from; names both.
    """
    if not isinstance(design, RVReducer):
        return design
    gears, profile, cranks = (set(subtable(given, part)) for part in ("involute", "cycloid", "cranks"))
    involute = design.involute
    standard = InvoluteStage.from_teeth(**{name: getattr(involute, name) for name in GEARS})
    if gears & set(GEARS):
        involute = involute.replace(**{name: getattr(standard, name) for name in AGREE if name not in gears})
    for name in sorted(gears & set(AGREE)):
        _agree(f"involute.{name}", getattr(involute, name), "teeth and module", getattr(standard, name), AGREE[name])
    circle = design.cranks
    if involute.centre_distance != design.involute.centre_distance or "centre_distance" in gears:
        circle = circle if "circle_radius" in cranks else circle.replace(circle_radius=involute.centre_distance)
    if "circle_radius" in cranks:
        _agree(
            "cranks.circle_radius", circle.circle_radius, "centre_distance", involute.centre_distance, AGREE_CIRCLE,
            "each planet sits on its crank",
        )  # fmt: skip
    cycloid = design.cycloid
    if profile & set(PROFILE) and "shortening" not in profile:
        cycloid = cycloid.replace(shortening=None)
    return design.replace(involute=involute, cranks=circle, cycloid=cycloid)


def _agree(name: str, value: Scalar, source: str, due: Scalar, share: float, why: str = "") -> None:
    if np.any(np.abs(value - due) > share * np.abs(due)):
        reason = f"; {why}" if why else ""
        raise ValueError(
            f"design.{name} = {1e3 * value:.6g} mm: {source} make it {1e3 * due:.6g} mm, more than {share:.3g} of it "
            f"apart{reason}"
        )
