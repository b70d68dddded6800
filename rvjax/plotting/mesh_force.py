"""Plots of the oscillatory roller stage: the tooth with its undercut limit, and the parametric studies."""

from collections.abc import Mapping

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rvjax.designs import CamRollerReducer
from rvjax.mesh_force import CycleStatistics, MeshForces, largest_roller_radius, tooth_profile
from rvjax.plotting.style import AFTER, BEFORE, LIMIT, PALETTE, Numbers, new_axes, words
from rvjax.units import mm, um


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


FORCES = ("cam_mean", "cam_peak", "gear_mean", "gear_peak", "cage_mean", "cage_peak_to_peak")


def roller_forces(units: Mapping[str, MeshForces], *, part: str = "cam", axes: Axes | None = None) -> Axes:
    """Force on each roller at one angle, one set of bars for each unit.

    Args:
        units: {unit: of `mesh_force.solve`}, three at most.
        part: "cam", "cage" or "gear".
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    width = 0.8 / len(units)
    for k, (name, forces) in enumerate(units.items()):
        force = np.asarray(getattr(forces, part))
        place = np.arange(len(force)) + 1 + (k - (len(units) - 1) / 2) * width
        colour, hatch = ((AFTER, ""), (BEFORE, "//"), (PALETTE[2], ".."))[k]
        axes.bar(place, force, width, color=colour, hatch=hatch, edgecolor="white", lw=0.3, label=name)
    axes.set(xlabel="roller (number)", ylabel=f"{part} force (N)")
    axes.set_xticks(range(1, len(force) + 1, 5))
    axes.grid(axis="x", visible=False)
    axes.legend()
    return axes


def study(
    parameter: str,
    values: Numbers,
    statistics: CycleStatistics,
    *,
    title: str,
    printed: Mapping[str, tuple[float, float]] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Forces of a work cycle while one dimension or error varies.

    Args:
        parameter: as in `mesh_force.sweep`.
        values: of the parameter, m (k,).
        statistics: of `mesh_force.sweep`, fields (k,); NaN (undercut) leaves a gap.
        title: of the plot.
        printed: {statistic: forces in N at the first and the last value} published in a source, as crosses.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    name = words(parameter.removeprefix("errors."))
    shown, size, label = ("mm", mm, name) if words(parameter) == name else ("um", um, f"error of {name}")
    for k, name in enumerate(FORCES):
        dash = "-" if name.endswith("mean") else "--"
        force = np.asarray(getattr(statistics, name))
        axes.plot(np.asarray(values) / size, force, dash, color=PALETTE[k // 2], lw=1.6, label=words(name))
        if printed and name in printed:
            ends = np.asarray(values)[[0, -1]] / size
            mark = "x" if name.endswith("mean") else "+"
            axes.plot(ends, printed[name], mark, color=PALETTE[k // 2], ms=8, mew=1.8, clip_on=False, zorder=3)
    gone = ~np.isfinite(np.asarray(statistics.cam_mean))
    if gone.any():
        axes.axvspan(
            np.asarray(values)[gone].min() / size, np.asarray(values)[gone].max() / size, color="0.92", zorder=0
        )
        axes.text(0.98, 0.5, "undercut", transform=axes.transAxes, ha="right", color="0.4")
    axes.set(xlabel=f"{label} ({shown})", ylabel="force (N)", title=title)
    return axes


def studies(
    results: Mapping[str, tuple[str, Numbers, CycleStatistics]],
    printed: Mapping[str, Mapping[str, tuple[float, float]]] | None = None,
) -> Figure:
    """Several parametric studies side by side, three in a row.

    Args:
        results: {title: (parameter, values, statistics)}.
        printed: {title: as in `study`}.

    Returns:
        The figure.
    """
    rows = -(-len(results) // 3)
    figure, grid = plt.subplots(rows, 3, figsize=(12, 3.2 * rows + 0.6), squeeze=False)
    for axes, (title, (parameter, values, statistics)) in zip(grid.flat, results.items()):
        study(parameter, values, statistics, title=title, printed=(printed or {}).get(title), axes=axes)
    for axes in grid.flat[len(results) :]:
        axes.set_visible(False)
    handles, labels = grid.flat[0].get_legend_handles_labels()
    if printed:
        for mark, label in (("x", "published mean"), ("+", "published peak")):
            handles += grid.flat[0].plot([], [], mark, color="0.3", ms=8, mew=1.8)
            labels.append(label)
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure
