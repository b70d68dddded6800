"""Drawings of frames, signs and forces: the second stage along its axis, its linkage with the errors of its parts,
forces on a disc; a tooth of the oscillatory roller stage."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from rvjax.cycloidal import Reducer
from rvjax.designs import CamRollerReducer, RVReducer
from rvjax.geometry import flank_along
from rvjax.loaded import Loaded
from rvjax.mesh_force import largest_roller_radius, tooth_profile
from rvjax.plotting.style import AFTER, BEFORE, LIMIT, PALETTE, new_axes
from rvjax.records import PyTree, Scalar
from rvjax.units import mm

GREY, GREEN = "0.45", PALETTE[2]


def reducer(design: RVReducer, *, crank_angle: float = np.pi / 4, axes: Axes | None = None) -> Axes:
    """The second stage along its axis: pins, first disc, cranks, the frame and the sense of positive angles.

    Args:
        design: of the reducer.
        crank_angle: of the first disc, rad; rounded to the next multiple of the pin pitch.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes, (7, 7))
    cycloid, cranks = design.cycloid, design.cranks
    pitch = 2 * np.pi / cycloid.pin_count
    angle = pitch * round(crank_angle / pitch)  # where the disc meshes as it does at zero
    circles(axes, cycloid.pin_circle_radius, cycloid.pin_radius, cycloid.pin_count, "0.85")
    centre = cycloid.eccentricity * unit_vector(angle)
    axes.plot(*(turned(flank(design), angle).T + centre[:, None]) / mm, color=AFTER, lw=1.6, label="disc 0")
    for k, place in enumerate(crank_axes(design)):
        axes.add_patch(Circle(tuple(place / mm), 0.14 * float(cranks.circle_radius) / mm, fc="white", ec=GREY, lw=1.2))
        bore = place + centre
        axes.add_patch(Circle(tuple(bore / mm), 0.2 * float(cranks.circle_radius) / mm, fill=False, ec=AFTER, lw=1.2))
        axes.plot(*place / mm, "o", color=LIMIT, ms=4, label="axis of a crank in the carrier" if k == 0 else None)
        axes.annotate(f"crank {k}", tuple(place / mm), xytext=(0, -32), textcoords="offset points", ha="center")
    axes.plot(0, 0, "+", color="black", ms=9)
    axes.plot(*centre / mm, "o", color=AFTER, ms=4, label="centre of the disc, an eccentricity away")
    reach = 0.42 * cycloid.pin_circle_radius / mm
    for text, end, shift in (("x", (reach, 0), (2, -10)), ("y", (0, reach), (-12, 0))):
        axes.annotate("", end, (0, 0), arrowprops=dict(arrowstyle="-|>", color="black", lw=1.2))
        axes.annotate(text, end, xytext=shift, textcoords="offset points", va="center")
    arc = np.array([unit_vector(a) for a in np.radians(np.linspace(20, 115, 40))])
    radius = float(cycloid.pin_circle_radius) / mm
    sense(axes, 0.3 * radius * arc, 1.2)
    axes.annotate("+", tuple(0.34 * radius * unit_vector(np.radians(70))), fontsize=14, ha="center")
    axes.set_aspect("equal")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="Second stage along its axis; angles counter-clockwise")
    axes.grid(visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, fontsize=9)
    return axes


def before_and_after(before: PyTree, after: PyTree, section: Callable[[Any, Axes], None] | None = None) -> Axes:
    """Sections of two designs with cycloid discs side by side, to one scale; below, their discs seen from the side.

    Args:
        before: on the left.
        after: on the right; a dashed line is the envelope of the other design.
        section: draws a design along its axis; None: the second stage of an RV reducer.
    """
    import matplotlib.pyplot as plt

    widths = [_disc_width(design) for design in (before, after)]
    if None in widths:
        _, both = plt.subplots(1, 2, figsize=(11, 5.8), sharex=True, sharey=True)
    else:
        _, rows = plt.subplots(2, 2, figsize=(11, 7.6), sharex=True, sharey="row", height_ratios=(3.6, 1))
        both = rows[0]
        for axes, design, other in zip(rows[1], (before, after), (after, before)):
            _from_the_side(design, other, axes)
        rows[1][0].set_ylabel("z (mm)")
    for axes, design, other, name in zip(both, (before, after), (after, before), ("before", "after")):
        (section or _section)(design, axes)
        for one, style in ((design, "-"), (other, "--")):
            radius = float(one.cycloid.pin_circle_radius + one.cycloid.pin_radius) / mm
            axes.add_patch(Circle((0, 0), radius, fill=False, ls=style, ec=GREY, lw=1))
        cycloid = design.cycloid
        axes.set_title(
            f"{name}: {2 * float(cycloid.pin_circle_radius + cycloid.pin_radius) / mm:.2f} mm over the pins, "
            f"e = {float(cycloid.eccentricity) / mm:.3f} mm",
            fontsize=10,
        )
        axes.set(xlabel="x (mm)" if None in widths else "", aspect="equal")
        axes.grid(visible=False)
    both[0].set_ylabel("y (mm)")
    both[0].autoscale_view()
    return both[0]


def _disc_width(design: Reducer) -> float | None:
    """Width of a disc, m; None where the design has none."""
    width = None if design.contact is None else design.contact.face_width
    return None if width is None else float(width)


def _from_the_side(design: Reducer, other: Reducer, axes: Axes) -> None:
    """Discs between the pins seen along y, half a millimetre apart; the other design's discs dashed."""
    for one, style, filled in ((other, "--", False), (design, "-", True)):
        cycloid, width = one.cycloid, (_disc_width(one) or 0.0) / mm
        outer = float(cycloid.pin_circle_radius + cycloid.pin_radius) / mm
        count, apart = int(cycloid.disc_count), 0.5
        length = count * width + (count - 1) * apart
        axes.add_patch(Rectangle((-outer, -length / 2), 2 * outer, length, fill=False, ls=style, ec=GREY, lw=1))
        for disc in range(count if filled else 0):
            low = -length / 2 + disc * (width + apart)
            aside = float(cycloid.eccentricity) * np.cos(2 * np.pi * disc / count) / mm
            radius = outer - 2 * float(cycloid.pin_radius) / mm
            axes.add_patch(Rectangle((aside - radius, low), 2 * radius, width, fc="0.85", ec=AFTER, lw=1.2))
    axes.set(xlabel="x (mm)", aspect="equal", title=f"{design.cycloid.disc_count} discs of {width:.2f} mm")
    axes.title.set_fontsize(10)
    axes.grid(visible=False)
    axes.autoscale_view()


def _section(design: RVReducer, axes: Axes) -> None:
    """Pins, first disc, cranks and planets' reference circles."""
    cycloid, cranks, gears = design.cycloid, design.cranks, design.involute
    circles(axes, cycloid.pin_circle_radius, cycloid.pin_radius, cycloid.pin_count, "0.85")
    centre = float(cycloid.eccentricity) * unit_vector(0.0)
    axes.plot(*(flank(design).T + centre[:, None]) / mm, color=AFTER, lw=1.2)
    planet = float(gears.module) * gears.planet_teeth / 2 / mm
    for place in crank_axes(design):
        axes.add_patch(Circle(tuple(place / mm), planet, fill=False, ls=":", ec=BEFORE, lw=1))
        axes.plot(*place / mm, "o", color=LIMIT, ms=4)
        axes.add_patch(
            Circle(tuple((place + centre) / mm), 0.2 * float(cranks.circle_radius) / mm, fill=False, ec=AFTER)
        )
    axes.plot(0, 0, "+", color="black", ms=9)


def linkage(design: RVReducer, *, crank_angle: float = np.pi / 3, axes: Axes | None = None) -> Axes:
    """One disc on two cranks as a four-bar linkage, and where each error acts; the cranks are not to scale.

    Args:
        design: of a reducer with two cranks.
        crank_angle: of the disc, rad.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    half = design.cranks.circle_radius / mm
    arm = 0.55 * half
    ends = np.array([[-half, 0.0], [half, 0.0]])
    pins = ends + arm * unit_vector(crank_angle)
    axes.plot(*ends.T, color="0.6", lw=6, solid_capstyle="round", zorder=1, label="carrier (frame)")
    axes.plot(*pins.T, color=AFTER, lw=6, solid_capstyle="round", zorder=1, label="disc (coupler)")
    for k in range(2):
        line = np.array([ends[k], pins[k]])
        axes.plot(*line.T, color=BEFORE, lw=4, zorder=2, label="crank" if k == 0 else None)
        axes.plot(*line.T, "o", color="white", mec="black", ms=9, zorder=3)
        axes.annotate(
            f"crank {k}",
            ends[k],
            xytext=(12 * (1 - 2 * k), -18),
            textcoords="offset points",
            ha="left" if k == 0 else "right",
        )
        outward = 1 if k else -1
        # each in the frame of its crank: radial away from the axis, tangential counter-clockwise
        for at, colour in ((ends[k], LIMIT), (pins[k], GREEN)):
            for direction, name in ((np.array([outward, 0]), "r"), (np.array([0, outward]), "t")):
                tip = at + 0.34 * half * direction
                axes.plot(*(tip + 0.1 * half * direction), alpha=0)  # arrows do not count for the limits
                axes.annotate("", tip, at, arrowprops=dict(arrowstyle="-|>", color=colour, lw=1.6), zorder=4)
                axes.annotate(name, tip + 0.07 * half * direction, color=colour, ha="center", va="center")
    axes.plot([], [], color=LIMIT, lw=1.6, label="carrier_bore [radial r, tangential t]")
    axes.plot([], [], color=GREEN, lw=1.6, label="disc_bore [radial r, tangential t]")
    middle = (ends[0] + pins[0]) / 2
    for text, place, shift in (
        ("eccentricity +\ncrank_eccentricity", middle, (-8, 0)),
        ("crank_angle +\ncrank_phase", ends[0] + 0.3 * half * unit_vector(crank_angle / 2), (8, 8)),
    ):
        side = "right" if shift[0] < 0 else "left"
        axes.annotate(text, place, xytext=shift, textcoords="offset points", ha=side, fontsize=9)
    turn = 0.28 * half * np.array([unit_vector(a) for a in np.linspace(0, crank_angle, 30)]) + ends[0]
    sense(axes, turn, 1.0)
    title = "A disc on two cranks (eccentricity far too long)\n"
    title += "transmission error > 0: carrier counter-clockwise against the disc"
    axes.set_aspect("equal")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title=title)
    axes.title.set_fontsize(10)
    axes.margins(x=0.06, y=0.1)
    axes.grid(visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2, fontsize=9)
    return axes


def unit_vector(angle: float) -> np.ndarray:
    """Direction of an angle, (2,)."""
    return np.array([np.cos(angle), np.sin(angle)])


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points (n, 2) turned counter-clockwise about the origin.

    Args:
        points: of any length unit.
        angle: rad.
    """
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def circles(
    axes: Axes, circle: Scalar, radius: Scalar, count: int, colour: str, centre: Scalar = 0.0, *, zorder: float = 1
) -> None:
    """Equal circles round a centre, the first on the x axis.

    Args:
        axes: where to draw.
        circle: radius of the circle of their middles, m.
        radius: of each, m.
        count: of the circles.
        colour: inside.
        centre: (2,) m, or 0.
        zorder: as in Matplotlib.
    """
    for angle in 2 * np.pi * np.arange(count) / count:
        middle = tuple((float(circle) * unit_vector(angle) + np.asarray(centre)) / mm)
        axes.add_patch(Circle(middle, float(radius) / mm, fc=colour, ec=GREY, lw=0.8, zorder=zorder))


def crank_axes(design: RVReducer) -> list[np.ndarray]:
    """Axes of the cranks in the carrier: crank 0 on the negative x axis, the others counter-clockwise."""
    count = design.cranks.count
    return [float(design.cranks.circle_radius) * unit_vector(np.pi + 2 * np.pi * k / count) for k in range(count)]


def flank(design: Reducer) -> np.ndarray:
    """Flank of a disc about its own centre without modifications, m (n, 2): pins touch it.

    Args:
        design: with a `cycloid` stage.
    """
    plain = dict(equidistant_modification=0.0, shift_modification=0.0, profile_modification=None)
    cycloid = design.cycloid.replace(**plain)
    return np.asarray(flank_along(cycloid, np.linspace(0, 2 * np.pi, 60 * cycloid.pin_count))[0])


def sense(axes: Axes, arc: np.ndarray, width: float) -> None:
    """Draw the sense of a rotation as an arc with an arrow.

    Args:
        axes: where to draw.
        arc: points (n, 2).
        width: of the line.
    """
    axes.plot(*arc.T, color="black", lw=width)
    axes.annotate("", arc[-1], arc[-3], arrowprops=dict(arrowstyle="-|>", color="black", lw=width))


def pin_forces(
    design: RVReducer, result: Loaded, *, input_angle: float, disc: int = 0, axes: Axes | None = None
) -> Axes:
    """A disc in its ring, seen along the axis in the frame of the carrier, with every force on it as an arrow.

    Arrows of pins and bearings have different scales; those of pins are alike for all discs of `result`.

    Args:
        design: as solved.
        result: of `loaded.equilibrium`.
        input_angle: as solved, rad.
        disc: which one.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    cycloid, radius = design.cycloid, design.cycloid.pin_circle_radius
    output = float(input_angle) / design.ratio
    crank = -cycloid.pin_count * output + 2 * np.pi * disc / cycloid.disc_count
    centre = cycloid.eccentricity * unit_vector(crank)
    part = turned(flank(design), -2 * np.pi * disc / (cycloid.disc_count * cycloid.disc_teeth))
    axes.fill(*((part + centre).T / mm), facecolor="0.95", edgecolor="0.45", lw=1.0)

    places = 2 * np.pi * np.arange(cycloid.pin_count) / cycloid.pin_count - output
    for place in places:
        pin = tuple(radius / mm * unit_vector(place))
        axes.add_patch(Circle(pin, float(cycloid.pin_radius) / mm, fc="0.8", ec="0.5"))
    # The force on the disc points from a pin's centre through the pitch point.
    pitch_point = cycloid.eccentricity * cycloid.pin_count * unit_vector(crank)
    pins = radius * np.stack([np.cos(places), np.sin(places)], axis=1)
    normal = (pitch_point - pins) / np.linalg.norm(pitch_point - pins, axis=1)[:, None]
    force, largest = np.asarray(result.pins)[disc], float(np.max(np.asarray(result.pins)))
    touch, pressed = (pins + cycloid.pin_radius * normal) / mm, force > 0
    length = 0.45 * radius / mm / max(largest, 1e-300)
    tips = normal * force[:, None] * length
    label = f"{int(np.sum(pressed))} of {cycloid.pin_count} pins, at most {force.max() / 1e3:.3g} kN"
    scale: Any = dict(angles="xy", scale_units="xy", scale=1)
    axes.quiver(*touch[pressed].T, *tips[pressed].T, **scale, color=AFTER, width=0.005, label=label)

    bearing = np.asarray(result.disc_bearing)[disc]
    size = np.linalg.norm(bearing, axis=1)
    journals = (np.array(crank_axes(design)) + centre) / mm
    for place in journals:
        axes.add_patch(Circle(tuple(place), 0.2 * float(design.cranks.circle_radius) / mm, fc="white", ec="0.45"))
    greatest = max(float(np.linalg.norm(np.asarray(result.disc_bearing), axis=-1).max()), 1e-300)
    tips = bearing * 0.4 * radius / mm / greatest
    label = f"cranks on the disc, at most {size.max() / 1e3:.3g} kN"
    axes.quiver(*journals.T, *tips.T, **scale, color=LIMIT, width=0.008, label=label, zorder=3)
    axes.plot(*(centre / mm), "o", color="black", ms=3)
    axes.set_aspect("equal")
    reach = 1.12 * (radius + cycloid.pin_radius) / mm
    axes.set(xlabel="x (mm)", ylabel="y (mm)", xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_title(f"Forces on disc {disc}")
    axes.grid(visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=9)
    return axes


def tooth(design: CamRollerReducer, *, axes: Axes | None = None) -> Axes:
    """One tooth of the inner gear: roller centre curve, flank, and the flank at the undercut limit.

    Args:
        design: the stage.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    pitch = 2 * np.pi / design.gear_teeth
    angles = np.linspace(-0.75 * pitch, 0.75 * pitch, 601)
    profiles = jax.jit(jax.vmap(tooth_profile, in_axes=(None, 0)))
    limit = float(largest_roller_radius(design))
    here = profiles(design, angles)
    axes.plot(*np.asarray(here.centre).T / mm, color="0.5", ls=":", lw=1.2, label="roller centres")
    axes.plot(
        *np.asarray(here.flank).T / mm, color=AFTER, lw=2.0, label=f"flank, r = {design.roller_radius / mm:.4g} mm"
    )
    if np.isfinite(limit):
        # the centre curve stays: a larger roller on a smaller cam
        link = design.cam_radius + design.roller_radius
        for radius, colour, dash, label in (
            (limit, BEFORE, "-", f"undercut limit, r = {limit / mm:.4g} mm"),
            (1.4 * limit, LIMIT, "--", f"undercut, r = {1.4 * limit / mm:.4g} mm"),
        ):
            other = profiles(design.replace(roller_radius=radius, cam_radius=link - radius), angles)
            axes.plot(*np.asarray(other.flank).T / mm, color=colour, ls=dash, lw=1.4, label=label)
    axes.set_aspect("equal")
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title="Tooth of the inner gear")
    axes.margins(y=0.12)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), fontsize=9, ncols=2)
    return axes
