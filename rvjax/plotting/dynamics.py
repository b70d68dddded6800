"""Plots of the dynamic model: natural frequencies, responses, sensitivities, accuracy."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from rvjax.dynamics import Modes, Periodic, Response
from rvjax.plotting.style import AFTER, BEFORE, DASHES, PALETTE, Numbers, new_axes, readable_bins, words
from rvjax.units import readable, rpm, with_unit

KIND_STYLES = {
    "rotational": (PALETTE[0], "-"),
    "translational": (PALETTE[5], "--"),
    "planetary": (PALETTE[2], ":"),
    "disc": (PALETTE[3], "-."),
    "coupled": (PALETTE[7], "-"),
}


def campbell(
    found: Modes,
    speed: Numbers,
    mesh_frequency: Numbers,
    *,
    harmonics: Mapping[int, str],
    highest: float = 2500.0,
    axes: Axes | None = None,
) -> Axes:
    """Natural frequencies and mesh harmonics over speed; a dot where a harmonic meets a kind that it excites.

    A harmonic has the colour of the kind that it excites.

    Args:
        found: modes of the reducer.
        speed: sun speed, rad/s (n,).
        mesh_frequency: fundamental of the stage at each speed, Hz (n,).
        harmonics: {order: kind of mode that it excites}.
        highest: top of the frequency axis, Hz.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    turns, lines = np.asarray(speed) / rpm, np.asarray(mesh_frequency)
    frequency, kind = np.asarray(found.frequency), found.kind
    for name in dict.fromkeys(kind):
        shown = frequency[(kind == name) & (frequency < highest)]
        colour, dash = KIND_STYLES[name]
        for k, value in enumerate(shown):
            axes.axhline(value, color=colour, ls=dash, lw=1.2, label=name if k == 0 else None)
    for order, name in harmonics.items():
        axes.plot(turns, order * lines, color=KIND_STYLES[name][0], lw=0.8, alpha=0.6)
        inside = np.flatnonzero(order * lines <= highest)
        end = inside[-1]
        axes.annotate(
            f" {order}", (turns[end], order * lines[end]), fontsize=8, color=KIND_STYLES[name][0], xytext=(0, 1),
            textcoords="offset points", ha="left", annotation_clip=False,
        )  # fmt: skip
        for value in frequency[(kind == name) & (frequency < highest)]:
            if order * lines[0] <= value <= order * lines[-1]:
                at = np.interp(value, order * lines, turns)
                axes.plot(at, value, "o", ms=4, color=KIND_STYLES[name][0])
    axes.set(xlabel="sun speed (r/min)", ylabel="frequency (Hz)", xlim=(turns[0], turns[-1]), ylim=(0, highest))
    axes.set_title("Natural frequencies and mesh harmonics (numbers); dots: excited", pad=14)
    axes.grid(visible=False)
    axes.legend(loc="upper left", frameon=True, framealpha=0.9)
    return axes


def speed_response(
    mesh_frequency: Numbers,
    amplitude: Numbers,
    *,
    harmonics: Sequence[int],
    unit: str,
    name: str,
    axes: Axes | None = None,
) -> Axes:
    """Amplitudes of harmonics over the mesh frequency.

    Args:
        mesh_frequency: Hz (n,).
        amplitude: complex or magnitudes, m or rad (n, H).
        harmonics: which to draw, from 1.
        unit: of the amplitude, m or rad.
        name: of the output.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    for k, order in enumerate(harmonics):
        height = np.abs(np.asarray(amplitude)[:, order - 1]) / size
        colour, dash = PALETTE[k % len(PALETTE)], DASHES[k % 4]
        axes.semilogy(mesh_frequency, height, color=colour, ls=dash, lw=1.2, label=f"{order}")
    axes.set(xlabel="mesh frequency (Hz)", ylabel=f"amplitude ({shown})", title=f"Response of {words(name)}")
    axes.set_xlim(np.min(mesh_frequency), np.max(mesh_frequency))
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * (high / low) ** 0.15)  # space for the legend
    axes.legend(ncols=len(harmonics), loc="upper center", title="harmonic")
    return axes


def one_period(
    exact: Periodic, responses: Mapping[str, Response], *, output: str, unit: str, axes: Axes | None = None
) -> Axes:
    """One output over one mesh period: the exact steady state, and truncated solutions that should meet it.

    Args:
        exact: of `dynamics.periodic`.
        responses: {name: of `dynamics.response` under the same conditions}.
        output: name.
        unit: of the output, m or rad.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    time, column = np.asarray(exact.time), exact.outputs.index(output)
    turn = 2 * np.pi * time / (time[-1] + time[1])
    motion = np.asarray(exact.deflection)[:, column]
    axes.plot(1e3 * time, (motion - motion.mean()) / size, color="0.65", lw=4, label="exact")
    for k, (name, found) in enumerate(responses.items()):
        amplitude = np.asarray(found.amplitude)[:, found.outputs.index(output)]
        order = np.arange(1, len(amplitude) + 1)
        curve = np.real(np.exp(1j * turn[:, None] * order) @ amplitude) / size
        axes.plot(1e3 * time, curve, DASHES[k % 4], color=PALETTE[(0, 5, 2, 3)[k % 4]], label=name)
    axes.set(xlabel="time in one mesh period (ms)", ylabel=f"{words(output)} about its mean ({shown})")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return axes


def sensitivity_bars(
    shares: Mapping[str, Numbers],
    *,
    other: Mapping[str, Numbers] | None = None,
    labels: tuple[str, str],
    axes: Axes | None = None,
) -> Axes:
    """Log-sensitivities as bars, largest first, next to those of another formula; without those below 0.01.

    Args:
        shares: {field: relative change of the amplitude per relative change of the field}; real parts count.
        other: the same of another formula.
        labels: names of the two formulas.
        axes: where to draw; a new figure by default.
    """
    values = {name: float(np.real(value)) for name, value in shares.items()}
    beside = {name: float(np.real(value)) for name, value in (other or {}).items()}
    size = {name: max(abs(value), abs(beside.get(name, 0.0))) for name, value in values.items()}
    names = sorted((n for n in values if size[n] >= 0.01 * max(size.values())), key=lambda n: size[n])
    axes = new_axes(axes, (7, 1.2 + 0.26 * len(names)))
    rows, thick = np.arange(len(names)), 0.75 if other is None else 0.38
    axes.barh(
        rows + (0 if other is None else thick / 2), [values[n] for n in names], thick, color=AFTER, label=labels[0]
    )
    if other is not None:
        second = [beside[n] for n in names]
        axes.barh(rows - thick / 2, second, thick, color=BEFORE, hatch="//", edgecolor="white", label=labels[1])
    axes.set_yticks(rows, [words(n.split(".")[-1]) for n in names], fontsize=8)
    axes.set(xlabel="relative change of the amplitude / relative change of the field", title="Log-sensitivities")
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower right")
    return axes


def sensitivity_curves(
    values: Numbers, slopes: Mapping[str, Numbers], *, field: str, unit: str, ylabel: str, axes: Axes | None = None
) -> Axes:
    """Magnitude of a sensitivity over the field itself, one curve for each condition.

    Args:
        values: of the field, SI (n,).
        slopes: {condition: sensitivities (n,)}.
        field: name of the field.
        unit: its unit.
        ylabel: what the curves are, with unit.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    for k, (label, slope) in enumerate(slopes.items()):
        axes.semilogy(values, np.abs(slope), color=PALETTE[k % len(PALETTE)], ls=DASHES[k % 4], label=label)
    if np.max(values) > 30 * np.min(values) > 0:
        axes.set_xscale("log")
    axes.set(xlabel=f"{words(field)} ({unit})", ylabel=ylabel, title=f"Sensitivity to {words(field)}")
    axes.legend()
    return axes


def spread(values: Numbers, *, mean: float, sd: float, unit: str, name: str, axes: Axes | None = None) -> Axes:
    """Distribution of a response over random units, and the normal distribution of the first-order prediction.

    Args:
        values: of the response, SI (samples,), from Monte Carlo.
        mean: response without deviations, SI.
        sd: standard deviation by the sensitivities, SI.
        unit: SI unit of the response.
        name: of the response.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    shown, size = readable(unit)
    found = np.asarray(values)[np.isfinite(values)] / size
    bins = readable_bins(axes, found, 60, shown)
    weights = np.full(len(found), 1 / (max(1, len(found)) * bins.step))
    axes.hist(found, bins.edges, weights=weights, color=AFTER, alpha=0.6, label=f"Monte Carlo, {len(found)} units")
    of_decades, centre, width = bins.per == "decade", mean / size, sd / size
    line = (np.geomspace if of_decades else np.linspace)(bins.edges[0], bins.edges[-1], 300)
    normal = np.exp(-(((line - centre) / width) ** 2) / 2) / (width * np.sqrt(2 * np.pi))
    normal *= line * np.log(10) if of_decades else 1.0
    axes.plot(line, normal, color=BEFORE, lw=1.8, label=f"first order, sd {with_unit(width, shown, '.3g')}")
    axes.set(xlabel=f"{words(name)} ({shown}){bins.beyond}", ylabel=f"density (1/{bins.per})")
    axes.set_title(f"Spread of {words(name)}")
    axes.set_ylim(0, 1.25 * axes.get_ylim()[1])  # space for the legend
    axes.legend(loc="upper center", ncols=2)
    return axes


def error_against_harmonics(
    harmonics: Mapping[str, Numbers], errors: Mapping[str, Numbers], *, axes: Axes | None = None
) -> Axes:
    """Error of truncated solutions against the exact one over the number of harmonics.

    Args:
        harmonics: {method: numbers of harmonics (n,)}.
        errors: {method: rms errors relative to the moving part (n,)}.
        axes: where to draw; a new figure by default.
    """
    axes = new_axes(axes)
    for k, name in enumerate(harmonics):
        axes.loglog(harmonics[name], errors[name], "os^D"[k % 4] + "-", color=PALETTE[k], label=words(name))
    ticks = sorted({int(h) for numbers in harmonics.values() for h in numbers})
    axes.set_xticks(ticks, [str(t) for t in ticks])
    axes.set_xticks([], minor=True)
    axes.set(xlabel="harmonics", ylabel="rms error / rms of the moving part", title="Error against the exact solution")
    axes.legend()
    return axes
