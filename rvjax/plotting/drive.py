"""Single-stage drives seen along the axis, to scale."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path

from rvjax.cycloidal import CycloidalReducer
from rvjax.plotting import drawings
from rvjax.plotting.drawings import GREY, circles, flank, turned, unit_vector
from rvjax.plotting.style import AFTER, BEFORE, PALETTE, new_axes
from rvjax.units import mm

DISCS = (AFTER, BEFORE, PALETTE[2], PALETTE[3])
SEAT = 0.6  # bore of a disc over the radius inside its holes, where no bearing gives it
SHAFT = 0.5  # shaft over what all eccentrics cover; no record has it


def reducer(design: CycloidalReducer, *, axes: Axes | None = None) -> Axes:
    """All discs at input angle 0 between the pins of the ring, with output pins in their holes, eccentrics and shaft.

    Args:
        design: of the drive.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes, (7, 7.4))
    section(design, axes)
    outside = float(design.cycloid.pin_circle_radius + design.cycloid.pin_radius) / mm
    member, still = ("carrier", "ring") if design.member == "carrier" else ("ring", "carrier")
    sign = 1 if design.ratio > 0 else -1
    gap = 360 / design.output.count
    below = gap * (np.floor(270 / gap) + 0.5)  # degrees, between two holes
    bore, inside = _bore(design), _inside(design)
    around = 0.4 * bore + 0.6 * inside if bore < 0.8 * inside else 0.75 * _eccentric(design)
    for middle, radius, half in ((90, 1.06 * outside, 16 * sign), (below, around / mm, 55)):
        turn = np.radians(np.linspace(middle - half, middle + half, 40))
        drawings.sense(axes, radius * np.array([unit_vector(a) for a in turn]), 1.4)
    said = f"{member} (output): 1/{abs(design.ratio)} turn"
    axes.annotate(said, (0, 1.08 * outside), ha="center", va="bottom")
    axes.plot([], [], color="black", lw=1.4, label=f"shaft (input): 1 turn; the {still} is at rest")
    size = "shaft" if design.bearings is not None else "shaft; bore and eccentric too"
    axes.plot([], [], color=GREY, ls=":", label=f"assumed size: {size}")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="Single-stage drive along its axis at input angle 0")
    axes.set(xlim=(-1.1 * outside, 1.1 * outside), ylim=(-1.06 * outside, 1.18 * outside))
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize=9)
    return axes


PLACES = (
    ("pin circle", "right", ("pin_circle_radius", "ring_centre")),
    ("pin", "right", ("pin_offset", "pin_radii", "pin_radius", "pin_hole_clearance")),
    ("output pin", "right", ("output_pin_offset", "output_pin_radius")),
    ("circle of output pins", "right", ("carrier_centre",)),
    ("eccentric", "right", ("throw", "eccentric_phase", "eccentricity (of the flank too)")),
    ("hole", "left", ("hole_position", "hole_radius")),
    ("flank", "left", ("equidistant_modification", "shift_modification", "disc_profile", "disc_pitch")),
    ("teeth against bore", "left", ("disc_centre",)),
    ("eccentric bearing", "left", ("bearing_clearance",)),
    ("shaft", "left", ("shaft_centre", "support_clearance")),
)
"""Part of the drive, side of its text, its errors; each side from the top."""


def errors(design: CycloidalReducer, *, axes: Axes | None = None) -> Axes:
    """One disc at input angle 0, and the part at which each error acts.

    Args:
        design: of the drive.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes, (11, 6.4))
    cycloid, output, pitch = design.cycloid, design.output, 2 * np.pi / design.cycloid.pin_count
    section(design.replace(cycloid=cycloid.replace(disc_count=1)), axes)
    centre, gap = float(cycloid.eccentricity) * unit_vector(0.0), 2 * np.pi / output.count
    hole = float(output.pin_radius + cycloid.eccentricity + output.hole_clearance / 2)
    ring, around = float(cycloid.pin_circle_radius), float(output.circle_radius)
    pin, left = pitch * round(np.radians(40) / pitch), gap * round(np.radians(125) / gap)
    points = flank(design) + centre
    ends = {
        "pin circle": ring * unit_vector(pin + 1.5 * pitch),
        "pin": ring * unit_vector(pin),
        "output pin": around * unit_vector(0.0),
        "circle of output pins": around * unit_vector(-gap / 2),
        "eccentric": centre,
        "flank": points[np.argmin(np.abs(np.arctan2(*points.T[::-1]) - np.radians(140)))],
        "hole": around * unit_vector(left) + centre + hole * unit_vector(left),
        "teeth against bore": centre + _bore(design) * unit_vector(np.radians(170)),
        "eccentric bearing": centre + (_bore(design) + _eccentric(design)) / 2 * unit_vector(np.radians(200)),
        "shaft": np.zeros(2),
    }
    outside = float(cycloid.pin_circle_radius + cycloid.pin_radius) / mm
    for side, sign in (("right", 1), ("left", -1)):
        rows = [row for row in PLACES if row[1] == side]
        for (part, _, names), height in zip(rows, np.linspace(0.9, -0.8, len(rows)) * outside):
            line = dict(arrowstyle="-|>", color="black", lw=0.8, relpos=(0.5 - sign / 2, 1.0))
            for text, form in (
                ("\n".join(names), dict(va="top", arrowprops=line)),
                (part, dict(va="bottom", weight="bold")),
            ):
                axes.annotate(
                    text, ends[part] / mm, xytext=(sign * 1.2 * outside, height), ha="left" if sign > 0 else "right",
                    fontsize=9, zorder=6, **form,
                )  # fmt: skip
    axes.set(xlim=(-2.1 * outside, 2.1 * outside), ylim=(-1.08 * outside, 1.08 * outside))
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="Errors of a single-stage drive, and where they act")
    axes.set_aspect("equal")
    axes.grid(visible=False)
    return axes


def before_and_after(before: CycloidalReducer, after: CycloidalReducer) -> Axes:
    """Two drives along their axes side by side, to one scale; below, their discs seen from the side.

    Args:
        before: on the left.
        after: on the right; a dashed line is the envelope of the other design.
    """
    return drawings.before_and_after(before, after, section)


def section(design: CycloidalReducer, axes: Axes) -> None:
    """Discs with their holes, pins of the ring, output pins, eccentrics and shaft at input angle 0.

    Args:
        design: of the drive.
        axes: where to draw.
    """
    cycloid, output = design.cycloid, design.output
    for circle in (cycloid.pin_circle_radius, output.circle_radius):
        axes.add_patch(Circle((0, 0), float(circle) / mm, fill=False, ls="-.", ec="0.6", lw=0.7, zorder=2))
    for disc in range(cycloid.disc_count):  # disc 0 is in front: dashed lines of the others are hidden ones
        colour, part, front = DISCS[disc % len(DISCS)], _part(design, disc), disc == 0
        axes.add_patch(PathPatch(part, fc=colour, ec="none", alpha=0.18, zorder=1 - disc / 8))
        if front:
            axes.add_patch(PathPatch(part, fc="white", ec="none", zorder=0.95))  # hides the discs behind
        lines = "-" if front else (0, (4, 2))
        axes.add_patch(PathPatch(part, fill=False, ec=colour, lw=1.6 if front else 0.9, ls=lines, zorder=2))
        axes.plot([], [], color=colour, lw=1.6 if front else 0.9, ls=lines, label=f"disc {disc}")
    circles(axes, cycloid.pin_circle_radius, cycloid.pin_radius, cycloid.pin_count, "0.85", zorder=3)
    circles(axes, output.circle_radius, output.pin_radius, output.count, "0.65", zorder=3)
    _shaft(design, axes)


def _part(design: CycloidalReducer, disc: int) -> Path:
    """Outline of a disc at input angle 0 with its holes and its bore, mm."""
    cycloid, output = design.cycloid, design.output
    place = 2 * np.pi * disc / cycloid.disc_count
    centre = float(cycloid.eccentricity) * unit_vector(place)
    hole = float(output.pin_radius + cycloid.eccentricity + output.hole_clearance / 2)
    around = [turned(flank(design), -place / cycloid.disc_teeth)]
    holes = 2 * np.pi * np.arange(output.count) / output.count
    around += [float(output.circle_radius) * unit_vector(a) + _circle(hole) for a in holes]
    around.append(_circle(_bore(design)))
    # Holes run against the outline, so that they stay empty.
    return Path.make_compound_path(*(Path((points + centre) / mm, closed=True) for points in around))


def _circle(radius: float) -> np.ndarray:
    """Points of a circle, clockwise, (n, 2)."""
    angle = np.linspace(0, -2 * np.pi, 121)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _inside(design: CycloidalReducer) -> float:
    """Radius inside the holes of a disc, m."""
    output, e = design.output, design.cycloid.eccentricity
    return float(output.circle_radius - output.pin_radius - e - output.hole_clearance / 2)


def _bore(design: CycloidalReducer) -> float:
    """Radius of the bore of a disc, m: outside its bearing, or assumed."""
    if design.bearings is None:
        return SEAT * _inside(design)
    arm = design.bearings.arm
    return float(arm.pitch_diameter + arm.element_diameter) / 2


def _eccentric(design: CycloidalReducer) -> float:
    """Radius of an eccentric, m: inside its bearing, or assumed."""
    if design.bearings is None:
        return 0.75 * _bore(design)
    arm = design.bearings.arm
    return float(arm.pitch_diameter - arm.element_diameter) / 2


def _shaft(design: CycloidalReducer, axes: Axes) -> None:
    """Rollers or balls and eccentric of each disc, and the shaft."""
    cycloid, eccentric = design.cycloid, _eccentric(design)
    for disc in range(cycloid.disc_count):
        colour, lines = DISCS[disc % len(DISCS)], "-" if disc == 0 else (0, (4, 2))
        centre = float(cycloid.eccentricity) * unit_vector(2 * np.pi * disc / cycloid.disc_count)
        if disc == 0 and design.bearings is not None:
            arm = design.bearings.arm
            circles(axes, arm.pitch_diameter / 2, arm.element_diameter / 2, arm.elements, "0.93", centre, zorder=3)
        journal = Circle(tuple(centre / mm), eccentric / mm, fill=False, ec=colour, lw=1.0, ls=lines, zorder=3)
        axes.add_patch(journal)
        axes.plot(*centre / mm, "o", color=colour, ms=4, zorder=5)
    axes.add_patch(
        Circle((0, 0), SHAFT * (eccentric - float(cycloid.eccentricity)) / mm, fc="none", ls=":", ec=GREY, zorder=4)
    )
    axes.plot(0, 0, "+", color="black", ms=9, zorder=5)
