"""Plots of the loaded reducer: forces on discs, load sharing, torque-angle curve, transmission error and orders."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from rvjax.designs import RVReducer
from rvjax.loaded import Loaded, Revolution, Torsion
from rvjax.plotting.drawings import crank_axes, flank, turned, unit_vector
from rvjax.plotting.style import AFTER, BEFORE, DASHES, LIMIT, PALETTE, Numbers, new_axes
from rvjax.units import arcmin, arcsec, mm


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
        axes.add_patch(
            Circle(tuple(radius / mm * unit_vector(place)), float(cycloid.pin_radius) / mm, fc="0.8", ec="0.5")
        )
    # The force on the disc points from a pin's centre through the pitch point.
    pitch_point = cycloid.eccentricity * cycloid.pin_count * unit_vector(crank)
    pins = radius * np.stack([np.cos(places), np.sin(places)], axis=1)
    normal = (pitch_point - pins) / np.linalg.norm(pitch_point - pins, axis=1)[:, None]
    force, largest = np.asarray(result.pins)[disc], float(np.max(np.asarray(result.pins)))
    touch, pressed = (pins + cycloid.pin_radius * normal) / mm, force > 0
    length = 0.45 * radius / mm / max(largest, 1e-300)
    tips = normal * force[:, None] * length
    label = f"{int(np.sum(pressed))} of {cycloid.pin_count} pins, at most {force.max() / 1e3:.3g} kN"
    axes.quiver(
        *touch[pressed].T,
        *tips[pressed].T,
        angles="xy",
        scale_units="xy",
        scale=1,
        color=AFTER,
        width=0.005,
        label=label,
    )

    bearing = np.asarray(result.disc_bearing)[disc]
    size = np.linalg.norm(bearing, axis=1)
    journals = (np.array(crank_axes(design)) + centre) / mm
    for place in journals:
        axes.add_patch(Circle(tuple(place), 0.2 * float(design.cranks.circle_radius) / mm, fc="white", ec="0.45"))
    greatest = max(float(np.linalg.norm(np.asarray(result.disc_bearing), axis=-1).max()), 1e-300)
    axes.quiver(
        *journals.T, *(bearing.T * 0.4 * radius / mm / greatest), angles="xy", scale_units="xy", scale=1, color=LIMIT,
        width=0.008, label=f"cranks on the disc, at most {size.max() / 1e3:.3g} kN", zorder=3,
    )  # fmt: skip
    axes.plot(*(centre / mm), "o", color="black", ms=3)
    axes.set_aspect("equal")
    reach = 1.12 * (radius + cycloid.pin_radius) / mm
    axes.set(
        xlabel="x (mm)", ylabel="y (mm)", xlim=(-reach, reach), ylim=(-reach, reach), title=f"Forces on disc {disc}"
    )
    axes.grid(visible=False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=9)
    return axes


def torsion_curve(
    result: Torsion, *, torque: Numbers | None = None, angle: Numbers | None = None, axes: Axes | None = None
) -> Axes:
    """Hysteresis curve with backlash, lost motion and stiffness, evaluated as on a test bench.

    The load at the output is the opposite of the torque that the discs exert, and turns the output its own way.

    Args:
        result: of `loaded.torsion`.
        torque: more torques of the discs on the carrier, ascending, N m (n,).
        angle: error of the carrier at each of them, rad (n,).
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    points, twist = np.asarray(result.torque), np.asarray(result.angle) / arcmin
    zero = (twist[3] + twist[4]) / 2  # the mid-point of the backlash
    load, twist = -points, twist - zero
    line = (load, twist) if torque is None else (-np.asarray(torque), np.asarray(angle) / arcmin - zero)
    rated, stiffness = float(points[-1]), float(result.stiffness) * arcmin
    inset = axes.inset_axes((0.57, 0.1, 0.41, 0.4))
    for panel in (axes, inset):
        panel.plot(*line, color=AFTER, lw=1.8, label="output, input held")
        panel.plot(load, twist, "o", color=AFTER, mfc="white", ms=4)
    for side in (-1, 1):
        end = 0 if side > 0 else -1
        secant = np.array([0.0, side * rated])
        label = f"stiffness {stiffness:.4g} N m/arcmin" if side > 0 else None
        axes.plot(secant, twist[end] + (secant - side * rated) / stiffness, "--", color=BEFORE, lw=1.2, label=label)
    window = 0.06 * rated
    near = np.interp([-window, window], load[::-1], twist[::-1])
    inset.set(xlim=(-window, window), ylim=tuple(1.15 * near))
    for at, value, colour, name in (
        (-0.6 * window, float(result.backlash) / arcmin, PALETTE[2], "backlash"),
        (0.6 * window, float(result.lost_motion) / arcmin, LIMIT, "lost motion"),
    ):
        inset.annotate("", (at, value / 2), (at, -value / 2), arrowprops=dict(arrowstyle="<->", color=colour, lw=1.4))
        inset.plot([0, at], [value / 2] * 2, ":", [0, at], [-value / 2] * 2, ":", color=colour, lw=1.0)
        axes.plot([], [], color=colour, label=f"{name} {value:.3f} arcmin")
    for side in (-1, 1):
        inset.axvline(side * 0.03 * rated, color="0.6", lw=0.8)
    inset.set_title("+-3 % of rated load between the grey lines", fontsize=8)
    inset.tick_params(labelsize=8)
    axes.set(xlabel="load at the output (N m)", ylabel="angle of the output (arcmin)")
    axes.legend(loc="upper left", fontsize=9)
    return axes


def output_orders(
    turns: Mapping[str, Revolution], *, named: int = 6, highest: int | None = None, axes: Axes | None = None
) -> Axes:
    """Amplitudes of the orders of a whole output turn, the largest with their numbers.

    Args:
        turns: {name: of `loaded.revolution` with turns = 1}.
        named: orders to name, of the first curve.
        highest: order shown, by default all that the samples resolve.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    width = 0.8 / len(turns)
    for k, (name, found) in enumerate(turns.items()):
        error = np.asarray(found.error) / arcsec
        last = min(highest or len(error), (len(error) - 1) // 2)
        size = 2 / len(error) * np.abs(np.fft.rfft(error))[1 : last + 1]
        orders = np.arange(1, last + 1)
        axes.vlines(orders + (k - (len(turns) - 1) / 2) * width * 3, 0, size, color=PALETTE[k % len(PALETTE)], lw=1.6)
        axes.plot([], [], color=PALETTE[k % len(PALETTE)], lw=1.6, label=name)
        if k == 0:
            told = orders[np.argsort(-size)[:named]]
            for order in told:
                near = [other - order for other in told if 0 < abs(other - order) < 0.03 * last]  # names would overlap
                side = "center" if not near else "right" if max(near) > 0 else "left"
                axes.annotate(f"{order}", (order, size[order - 1]), ha=side, va="bottom", fontsize=9)
    axes.set(xlabel="order of the output turn", ylabel="amplitude (arcsec)", xlim=(0, last + 1))
    axes.set_ylim(0, None)
    axes.margins(y=0.12)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9)
    return axes


def measured_curve(
    torque: Numbers,
    measured: Numbers,
    fitted: Numbers,
    curves: Mapping[str, Numbers],
    *,
    stiffness: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Measured wind-up over torque, curves of a model, and the points of their fit.

    Args:
        torque: N m (n,).
        measured: rad (n,).
        fitted: bool (n,).
        curves: {name: angle of the model at the same torques, rad (n,)}.
        stiffness: N m/rad; the torque over it is taken off all angles, which leaves play and soft start.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    torque, shown, used = np.asarray(torque), np.asarray(measured) / arcmin, np.asarray(fitted)
    straight = 0 * torque if stiffness is None else torque / (stiffness * arcmin)
    axes.plot(torque[used], (shown - straight)[used], "o", color="black", ms=6, label="measured, fitted to")
    axes.plot(
        torque[~used], (shown - straight)[~used], "o", color="black", mfc="white", ms=6, label="measured, predicted"
    )
    for k, (name, angle) in enumerate(curves.items()):
        miss = (np.asarray(angle) / arcmin - shown)[~used]
        label = f"{name}: predicted within {np.abs(miss).max():.3f} arcmin"
        axes.plot(
            torque, np.asarray(angle) / arcmin - straight, DASHES[k % 4], color=PALETTE[(0, 1, 2)[k % 3]], label=label
        )
    label = "half of backward less forward error (arcmin)"
    if stiffness is not None:
        label = f"the same less torque over\n{stiffness * arcmin:.0f} N m/arcmin (arcmin)"
    axes.set(xlabel="torque at the output (N m)", ylabel=label)
    axes.legend(loc="upper left" if stiffness is None else "lower right", fontsize=9)
    return axes
