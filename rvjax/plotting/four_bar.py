"""Plots of the crank linkage: its two branches, angles over a link error, the error over a crank turn."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from rvjax.four_bar import Closure, Revolution
from rvjax.plotting.style import DASHES, PALETTE, Numbers, new_axes
from rvjax.units import arcmin, um


def linkages(
    eccentricity: float,
    spacing: float,
    closures: Mapping[str, Closure],
    *,
    crank_angle: float,
    axes: Axes | None = None,
) -> Axes:
    """One linkage without errors, closed in several ways: frame, two cranks, disc between them.

    Args:
        eccentricity: length of both cranks, m.
        spacing: length of frame and disc, m.
        closures: {name: of `four_bar.solve_closure` for these lengths}.
        crank_angle: of the first crank, rad.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    axes.plot([0, 1], [0, 0], color="0.6", lw=4, solid_capstyle="round", zorder=0, label="carrier (frame)")
    pin = eccentricity / spacing * np.array([np.cos(crank_angle), np.sin(crank_angle)])
    for k, (name, closure) in enumerate(closures.items()):
        angle = float(closure.coupler_angle)
        end = pin + np.array([np.cos(angle), np.sin(angle)])
        colour = PALETTE[(0, 5)[k % 2]]
        links = np.array([[0.0, 0.0], pin, end, [1.0, 0.0]])
        label = f"{name}: disc at {np.degrees(angle):.2f} deg"
        axes.plot(*links.T, DASHES[k % 4], color=colour, lw=2.0, marker="o", ms=6, mfc="white", label=label)
    axes.set_aspect("equal")
    axes.set(xlabel="x / spacing of the cranks (-)", ylabel="y / spacing (-)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return axes


def angles_over_error(errors: Numbers, angles: Mapping[str, Numbers], *, name: str, axes: Axes | None = None) -> Axes:
    """Magnitudes of angles over the error of one link, logarithmic: readings that lie decades apart.

    Args:
        errors: of the link, m (n,).
        angles: {reading: angles, rad (n,)}; exact zeros leave a gap.
        name: of the link.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    for k, (label, angle) in enumerate(angles.items()):
        size = np.abs(np.asarray(angle)) / arcmin
        shown = np.where(size > 0, size, np.nan)
        axes.semilogy(np.asarray(errors) / um, shown, DASHES[k % 4], color=PALETTE[(5, 1, 0, 2)[k % 4]], lw=1.8)
        axes.lines[-1].set_label(label)
    axes.set(xlabel=f"error of the {name} (um)", ylabel="|angle of the disc| (arcmin)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return axes


def turns(revolutions: Mapping[str, Revolution], *, axes: Axes | None = None) -> Axes:
    """Transmission error over a crank turn, one curve for each unit, with its peak to peak.

    Args:
        revolutions: {unit: of `four_bar.revolution`}.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    for k, (name, turn) in enumerate(revolutions.items()):
        degrees = np.append(np.degrees(turn.crank_angle), 360)
        error = np.asarray(turn.error) / arcmin
        label = f"{name}: {float(turn.peak_to_peak) / arcmin:.3f} arcmin peak to peak"
        axes.plot(degrees, np.append(error, error[0]), DASHES[k % 4], color=PALETTE[k % len(PALETTE)], label=label)
    axes.set(xlabel="crank angle (deg)", ylabel="transmission error (arcmin)", xlim=(0, 360))
    axes.set_xticks(range(0, 361, 60))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9)
    return axes
