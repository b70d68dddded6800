"""Curves by name over one variable, and the plots of results that are curves."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, ScalarFormatter
from numpy.typing import ArrayLike

from rvjax.compensation import Correction
from rvjax.measured import Judged
from rvjax.plotting.style import AFTER, BEFORE, DASHES, LIMIT, PALETTE, Looks, Numbers, limit_lines, new_axes, words
from rvjax.units import arcmin, arcsec, deg, readable, rpm

HOUR = 3600.0


def lines(
    x: ArrayLike,
    rows: Mapping[str, ArrayLike],
    *,
    xlabel: str,
    ylabel: str,
    band: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    title: str = "",
    looks: Looks | None = None,
    legend: Mapping[str, object] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Curves by name over one variable; the curve of an angle about its mean, a force or a cost.

    Args:
        x: the variable, in the unit of its axis (n,).
        rows: {name: values in the unit of the axis (n,)}; NaN leaves a gap.
        xlabel: name of the variable with its unit.
        ylabel: name of the values with their unit.
        band: {name: lower and upper ends of a filled band (n,)}.
        title: of the plot.
        looks: {name: options of Matplotlib for this curve or band}.
        legend: options of Matplotlib for the legend.
        axes: where to draw; a new figure by default.
    """
    axes, looks = new_axes(axes), looks or {}
    for name, (low, high) in (band or {}).items():
        axes.fill_between(
            x, low, high, **{"color": AFTER, "alpha": 0.25, "lw": 0, "label": name, **looks.get(name, {})}
        )
    for k, (name, values) in enumerate(rows.items()):
        default = {"color": PALETTE[k % len(PALETTE)], "ls": DASHES[k % len(DASHES)], "label": name}
        axes.plot(x, np.asarray(values), **{**default, **looks.get(name, {})})
    axes.set(xlabel=xlabel, ylabel=ylabel, title=title)
    axes.legend(**legend or {})
    return axes


def unit_curves(
    angle: Numbers,
    before: Numbers,
    after: Numbers,
    title: str,
    unit: str,
    *,
    read_in: str | None = None,
    axes: Axes | None = None,
) -> Axes:
    """A response over one cycle, before and after: the range of all units at each angle, and the curve of one of them.

    That one has the median range of its side. Angles are about the mean of their own curve.

    Args:
        angle: rad (n,), uniform over the cycle.
        before: values, SI (units, n), with the tolerances of the study.
        after: the same with the allocated tolerances.
        title: of the plot.
        unit: SI unit of the values; a mean angle is an offset of assembly and is taken away.
        read_in: measurement unit of the plot; by default the usual one of responses in `unit`.
        axes: where to draw; a new figure by default.
    """
    shown, size = readable(unit, read_in)
    end = np.degrees(2 * angle[-1] - angle[-2])
    rows, bands, looks = (
        dict[str, np.ndarray](),
        dict[str, tuple[np.ndarray, np.ndarray]](),
        dict[str, dict[str, Any]](),
    )
    for curves, colour, dash, label in ((before, BEFORE, (0, (4, 2)), "before"), (after, AFTER, "-", "after")):
        values = np.asarray(curves) / size
        solved = values[np.isfinite(values).all(axis=1)]
        values = solved if len(solved) else values[:1]  # a gap, where every unit failed
        values = values - values.mean(axis=1, keepdims=True) if unit == "rad" else values
        values = np.column_stack([values, values[:, :1]])
        one, units = f"{label}, one unit", f"{label}, {len(solved)} units"
        rows[one] = values[np.argsort(np.ptp(values, axis=1))[len(values) // 2]]
        bands[units] = values.min(axis=0), values.max(axis=0)
        looks |= {one: {"color": colour, "ls": dash, "lw": 0.9}, units: {"color": colour}}
    axes = lines(
        np.append(np.degrees(angle), end), rows, band=bands, looks=looks, axes=axes,
        xlabel="angle (deg)", ylabel=shown, title=title, legend={"loc": "upper right", "ncols": 2},
    )  # fmt: skip
    low, high = axes.get_ylim()
    axes.set(xlim=(0, end), ylim=(low, high + 0.15 * (high - low)))  # with room for the legend
    if np.isclose(end, 360):
        axes.set_xticks(range(0, 361, 60))
    return axes


def matched_units(
    planned: Numbers, random: Numbers, *, unit: str, name: str, limits: Sequence[float] = (), axes: Axes | None = None
) -> Axes:
    """Share of units up to each value of the response, matched and by chance.

    Args:
        planned: responses of units of the plan, SI (n,).
        random: responses of random units, SI (m,).
        unit: SI unit of the response.
        name: of the response.
        limits: of the response, SI.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    for values, colour, dash, label in ((random, BEFORE, "--", "random"), (planned, AFTER, "-", "matched")):
        seen = np.sort(np.asarray(values)[np.isfinite(values)]) / size
        share = 100 * np.arange(1, len(seen) + 1) / len(values)
        axes.step(seen, share, where="post", color=colour, ls=dash, lw=1.8, label=label)
    limit_lines(axes, limits, shown, size)
    axes.set(xlabel=f"{words(name)} ({shown})", ylabel="units up to there (%)", ylim=(0, 102))
    axes.set_title(f"Matched parts: {words(name)}")
    axes.legend(loc="lower right")
    return axes


def corrected_curve(
    angle: Numbers,
    error: Numbers,
    correction: Correction,
    *,
    title: str = "Error and its correction",
    axes: Axes | None = None,
) -> Axes:
    """A measured error over the output angle, and the rest after the correction.

    Args:
        angle: of the output, rad (n,).
        error: of the output, rad (n,); its mean is taken away.
        correction: added at the output.
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    rank = np.argsort(angle)
    y = (np.asarray(error) - np.mean(error))[rank] / arcsec
    left = y + correction.output(np.asarray(angle)[rank]) / arcsec
    rows = {f"{label}, rms {np.std(v):.3g} arcsec": v for label, v in (("before", y), ("after", left))}
    looks = {name: {"color": c, "ls": ls, "lw": 1.0} for name, c, ls in zip(rows, (BEFORE, AFTER), ("--", "-"))}
    axes = lines(
        np.degrees(np.asarray(angle)[rank]), rows, xlabel="output angle (deg)", ylabel="transmission error (arcsec)",
        title=title, looks=looks, legend={"loc": "upper right", "ncols": 2}, axes=axes,
    )  # fmt: skip
    axes.set_ylim(top=1.25 * max(1e-12, float(np.max(np.abs(y)))))  # space for the legend
    return axes


def measured_contents(judged: Judged, *, title: str = "", axes: Axes | None = None) -> Axes:
    """A measured error over the output angle, the curve of its contents, and below it the rest.

    Args:
        judged: of `rvjax.measured.judge`; bad readings are not shown.
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    model, used = judged.model, np.isin(judged.model.angle, judged.angle)
    y, fit = model.value[used] / arcsec, (model.value - model.residual)[used] / arcsec
    rest = y - fit
    below = min(float(np.min(y)), float(np.min(fit))) - 1.2 * float(np.max(rest, initial=0.0))  # its own zero line
    left = f"rest, rms {np.std(rest):.3g} arcsec (shifted)"
    looks = {
        "measured": {"color": BEFORE, "ls": "", "marker": ".", "ms": 3},
        "contents": {"color": AFTER, "ls": "-", "lw": 1.0},
        left: {"color": "0.4", "ls": "-", "lw": 0.8},
    }
    axes = lines(
        np.degrees(model.angle[used]), {"measured": y, "contents": fit, left: below + rest}, looks=looks, title=title,
        xlabel="output angle (deg)", ylabel="transmission error (arcsec)",
        legend={"loc": "upper right", "ncols": 3}, axes=axes,
    )  # fmt: skip
    axes.axhline(below, color="0.8", lw=0.8, zorder=1)
    high = max(float(np.max(y)), float(np.max(fit)))
    axes.set_ylim(top=high + 0.2 * max(1e-12, high - below))  # space for the legend
    return axes


def identified_curve(
    angle: np.ndarray,
    error: np.ndarray,
    *,
    predicted_angle: np.ndarray,
    predicted: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    title: str,
    axes: Axes | None = None,
) -> Axes:
    """A measured transmission error and that of the identified unit.

    Args:
        angle: of the output, rad (n,).
        error: measured, rad (n,).
        predicted_angle: rad (k,).
        predicted: rad (k,).
        lower: of the band, rad (k,).
        upper: of the band, rad (k,).
        title: of the plot.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown = (angle >= predicted_angle[0]) & (angle <= predicted_angle[-1])
    axes.plot(angle[shown] / deg, error[shown] / arcsec, ".", color="0.6", ms=3, label="measured")
    degrees = predicted_angle / deg
    lines(
        degrees, {"identified unit": predicted / arcsec}, band={"95 % band": (lower / arcsec, upper / arcsec)},
        xlabel="angle of the output (deg)", ylabel="arcsec", title=title,
        legend={"loc": "upper right", "ncols": 3}, axes=axes,
    )  # fmt: skip
    axes.set_xlim(degrees[0], degrees[-1])
    return axes


def measured_loop(
    torque: np.ndarray,
    midline: np.ndarray,
    width: np.ndarray,
    predicted: np.ndarray,
    *,
    recorded: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Midline and branches of a measured torque-angle loop and the identified unit.

    Args:
        torque: of the bench, N m (n,).
        midline: measured, rad (n,).
        width: of the loop, rad (n,).
        predicted: midline of the unit, rad (n,).
        recorded: torque N m, angle rad, and branch of each sample: 1 rising, -1 falling, 0 not used (m,).
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    low, high = (midline - width / 2) / arcmin, (midline + width / 2) / arcmin
    axes.fill_between(torque, low, high, color="0.88", lw=0, label="measured loop" if recorded is None else "width")
    if recorded is not None:
        for branch, colour, label in ((0, "0.6", "not used"), (1, PALETTE[4], "rising"), (-1, PALETTE[3], "falling")):
            own = recorded[2] == branch
            if np.any(own):
                axes.plot(recorded[0][own], recorded[1][own] / arcmin, ".", color=colour, ms=2, label=label)
    axes.plot(torque, midline / arcmin, "o", color=BEFORE, ms=4, label="its midline")
    axes.plot(torque, predicted / arcmin, color=AFTER, label="identified unit")
    if torque[0] <= 0 <= torque[-1]:
        ends = [float(np.interp(0.0, torque, side)) for side in (low, high)]
        axes.plot([0.0, 0.0], ends, "|-", color=LIMIT, lw=1.4, label=f"{ends[1] - ends[0]:.3g} arcmin at zero torque")
    axes.set(xlabel="torque on the output (N m)", ylabel="arcmin")
    axes.legend(loc="upper left", markerscale=2 if recorded is not None else 1)
    return axes


def efficiency_against_torque(
    torque: ArrayLike, efficiency: ArrayLike, *, speeds: ArrayLike, rated: int, axes: Axes | None = None
) -> Axes:
    """Efficiency against the output torque at several speeds: the median of the units and their band.

    Args:
        torque: sizes (t,) N m.
        efficiency: low, 50 % and high quantile over the units at each speed (3, s, t).
        speeds: sizes (s,) rad/s; 0 for rest.
        rated: place of the torque of the conditions, which is marked.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    torque, band, speeds = np.asarray(torque), 100 * np.asarray(efficiency), np.asarray(speeds)
    for k, speed in enumerate(speeds):
        label = f"{speed / rpm:.4g} r/min" if speed else "limit of low speed"
        dash = DASHES[k % len(DASHES)]
        if k == len(speeds) // 2:  # one band is filled, the others would cover it
            axes.fill_between(torque, band[0, k], band[2, k], color=PALETTE[k], alpha=0.25, lw=0)
        axes.plot(torque, band[::2, k].T, dash, color=PALETTE[k], lw=0.7)
        axes.plot(torque, band[1, k], dash, color=PALETTE[k], marker="o", ms=3, label=label)
    axes.axvline(torque[rated], color=LIMIT, lw=1, label="torque of the conditions")
    axes.set(xlabel="output torque (N m)", ylabel="efficiency (%)", xlim=(0, None))
    axes.set_title("Efficiency against torque: median, and 1 to 99 % of the units")
    axes.legend(fontsize=8)
    return axes


def life_against_torque(
    torque: ArrayLike,
    life: ArrayLike,
    *,
    low: float,
    speeds: Sequence[float],
    speed: float,
    limit: float | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Life of all bearings of a unit against a constant torque, at several speeds; the spread of the units at one.

    Args:
        torque: (t,) N m.
        life: with errors at the centre of their limits; low, 50 % and high quantile over the units, at `speed`
            (t, 4) s.
        low: share of the units below the low quantile, and above the high one.
        speeds: of the output, rad/s: life is in inverse proportion to the speed.
        speed: of the lives, rad/s.
        limit: s, or None.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    central, least, median, most = np.asarray(life).T / HOUR
    for dash, one in zip(DASHES, speeds):
        label = f"{one / rpm:.4g} r/min, errors at the centre of their limits"
        axes.plot(torque, central * speed / one, dash, color=AFTER, label=label)
    at, shares = f"{speed / rpm:.4g} r/min", f"{100 - 200 * low:g} % of the units"
    lines(
        torque, {f"{at}, median unit": median}, band={f"{at}, {shares}": (least, most)},
        looks={f"{at}, {shares}": {"color": BEFORE, "alpha": 0.35}, f"{at}, median unit": {"color": BEFORE}},
        xlabel="output torque (N m)", ylabel="life (h)", title="Life of the rated bearings against torque and speed",
        axes=axes,
    )  # fmt: skip
    if limit is not None:
        axes.axhline(limit / HOUR, color=LIMIT, lw=1.5, label=f"limit {limit / HOUR:.4g} h")
    axes.set(xscale="log", yscale="log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(lambda *_: "")
    axes.legend(fontsize=8)
    return axes
