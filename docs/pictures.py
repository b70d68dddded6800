"""The drawings of the docs, made from rvjax while they are built."""

from functools import cache

import jax
import matplotlib.pyplot as plt
import numpy as np
import two_studies
from matplotlib.colors import LogNorm

from benchmarks import bench_table
from benchmarks.tables import stored
from rvjax import (
    catalogue,
    compensation,
    dynamics,
    four_bar,
    loaded,
    lost_motion,
    plotting,
    published,
    study,
    tolerances,
)
from rvjax.errors import RVErrors
from rvjax.levels import table
from rvjax.plotting import drawings
from rvjax.plotting.style import AFTER, BEFORE, LIMIT
from rvjax.published import rv160
from rvjax.units import arcmin, arcsec, rpm, um


def _turn(axes):
    design = catalogue.RV_40E

    @jax.jit
    def turn(clearance, torque):
        errors = RVErrors.for_design(design, crank_eccentricity=[[5 * um, 0], [0, 0]], bearing_clearance=clearance)
        return four_bar.revolution(design, errors, angles=180, output_torque=torque)

    found = {
        "one crank journal +5 um": turn(0.0, 0.0),
        "and 8 um of bearing clearance under 412 N m": turn(8 * um, 412.0),
    }
    plotting.lines(
        np.arange(0, 360, 2), {name: (one.error - one.mean) / arcmin for name, one in found.items()},
        xlabel="crank angle (deg)", ylabel="transmission error less its mean (arcmin)",
        title="Transmission error over a crank turn", axes=axes,
    )  # fmt: skip
    axes.set(xlim=(0, 360), xticks=range(0, 361, 60))
    return axes


def _campbell(axes):
    found, speed = dynamics.modes(catalogue.RV_320E), np.linspace(100, 2000, 200) * rpm
    stage = catalogue.RV_320E.involute
    mesh = stage.sun_teeth * (1 - 1 / catalogue.RV_320E.ratio) * speed / (2 * np.pi)
    excited, highest = {1: "translational", 2: "planetary", 4: "rotational"}, 2500
    rays = {f"harmonic {n}, excites {kind}": n * mesh for n, kind in excited.items()}
    plotting.lines(speed / rpm, rays, xlabel="sun speed (r/min)", ylabel="frequency (Hz)", axes=axes)
    for k, kind in enumerate(dict.fromkeys(found.kind)):
        own = np.asarray(found.frequency)[(found.kind == kind) & (found.frequency < highest)]
        axes.hlines(own, *(speed[[0, -1]] / rpm), f"C{k + 3}", label=kind, lw=1)
        for n in (n for n, name in excited.items() if name == kind):
            axes.plot(np.interp(own, n * mesh, speed / rpm, np.nan, np.nan), own, "ko", ms=4)
    axes.set(
        xlim=speed[[0, -1]] / rpm, ylim=(0, highest), title="Natural frequencies and mesh harmonics; dots: excited"
    )
    axes.legend(loc="upper left", frameon=True, framealpha=0.9, fontsize=8)
    return axes


@cache
def _joint():
    """The embedded joint, the speeds of its sun, and lines of 1000 random units at each."""
    question = study.load("rv-40e-joint")
    given = question.conditions
    speeds = np.linspace(given.slowest_sun_speed, given.fastest_sun_speed, 240)

    @jax.jit
    @jax.vmap
    def swept(unit):
        errors = tolerances.sample(question.tolerances, unit, seed=0)
        return dynamics.speed_sweep(question.design, errors, sun_speeds=speeds, load_inertia=given.load_inertia)

    return question, speeds, swept(np.arange(1000))


def _joint_orders(axes):
    question, speeds, units = _joint()
    inertia = question.design.inertia
    heavy = inertia.replace(output_inertia=inertia.output_inertia + question.conditions.load_inertia)
    found = dynamics.modes(question.design.replace(inertia=heavy))
    modes = [float(f) for f, kind in zip(found.frequency, found.kind) if kind == "rotational" and f < 80]
    turns, size = speeds / question.design.ratio, np.abs(units.amplitude[1, :, :, 0]) / arcmin
    norm = LogNorm(size.max() / 1000, size.max(), clip=True)
    for k, (n, height) in enumerate(zip(np.asarray(units.order[1]), size.T)):
        frequency, drop = n * turns / (2 * np.pi), ("bottom", "top")[k % 2]
        drawn = axes.scatter(turns / rpm, frequency, 4 + 30 * norm(height), height, cmap="viridis_r", norm=norm, lw=0)
        last = np.flatnonzero(frequency <= 80)[-1]
        axes.annotate(f" {n:.4g}", (turns[last] / rpm, frequency[last]), fontsize=8, va=drop)
    for value in modes:
        axes.axhline(value, color="0.35", ls="--", lw=1, label="mode" if value == modes[0] else None)
    axes.figure.colorbar(drawn, ax=axes, label="amplitude (arcmin)", pad=0.1)
    axes.set(xlabel="output speed (r/min)", ylabel="frequency (Hz)", xlim=turns[[0, -1]] / rpm, ylim=(0, 80))
    axes.set_title("Orders per output turn (numbers) and their amplitudes", pad=14)
    axes.legend(loc="upper left")
    return axes


def _joint_batch(axes):
    question, speeds, units = _joint()
    turns = speeds / question.design.ratio
    frequency = turns[:, None] * np.asarray(units.order[0])
    rms = np.sqrt(np.sum(np.abs(units.amplitude[..., 0] * frequency**2) ** 2, axis=2) / 2)
    low, middle, high, most = np.quantile(rms, (0.05, 0.5, 0.95, 0.9973), axis=0)
    rows = {"median": middle, "99.73 % lie below": most, f"worst of {len(rms)}": rms.max(axis=0)}
    plotting.lines(
        turns / rpm, rows, band={"90 % of the units": (low, high)}, title="Spread of vibration over speed",
        looks=dict(zip(rows, ({"lw": 1.8}, {"color": "black", "lw": 1.2}, {"color": "0.5", "ls": ":", "lw": 1.2}))),
        xlabel="output speed (r/min)", ylabel="vibration (rad/s2)", axes=axes,
    )  # fmt: skip
    axes.axhline(question.requirements["dynamic_vibration"].upper, color=LIMIT, lw=1.5, label="limit")
    axes.set(xlim=(turns[0] / rpm, turns[-1] / rpm), ylim=(0, None))
    axes.legend(fontsize=9)
    return axes


@cache
def _loaded_unit():
    """An RV-40E of assumed stiffness with a micron of scatter, and its equilibria over a crank turn and over torque."""
    design = bench_table.DESIGN
    draw = np.random.default_rng(3).normal
    errors = RVErrors(
        crank_eccentricity=1 * um * draw(size=(2, 2)),
        pin_offset=1 * um * draw(size=(40, 2)),
        disc_pitch=1 * um * draw(size=(2, 39)),
        bearing_clearance=3 * um,
        equidistant_modification=2 * um,
    )
    return design, errors


@cache
def _loaded_cases():
    design, errors = _loaded_unit()
    turn = np.linspace(0, 1, 61)
    half = np.geomspace(1e-3, 1, 30) * 412.0
    torque = np.concatenate([-half[::-1], half])
    solve = jax.vmap(lambda angle, load: loaded.equilibrium(design, errors, input_angle=angle, output_torque=load))
    angle = np.append(2 * np.pi * design.ratio / design.cycloid.pin_count * turn, np.zeros(60))
    found = jax.jit(solve)(angle, np.append(np.full(61, 412.0), torque))
    return turn, torque, found


def _loaded_pins(_):
    _, _, found = _loaded_cases()
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 5.6))
    one = jax.tree.map(lambda x: x[0], found)
    for k in range(2):
        drawings.pin_forces(_loaded_unit()[0], one, input_angle=0.0, disc=k, axes=axes[k])
    return figure


def _loaded_sharing(axes):
    turn, _, found = _loaded_cases()
    rows = {}
    for part, load in (("crank", found.gear[:61]), ("disc", found.disc_torque[:61])):
        shares = np.asarray(load / load.mean(axis=1, keepdims=True)).T
        rows |= {f"{part} {k}: {share.min():.2f} to {share.max():.2f}": share for k, share in enumerate(shares)}
    axes.axhline(1, color="0.3", lw=0.8)
    plotting.lines(
        turn, rows, xlabel="crank angle (turns)", ylabel="load over an equal share (-)",
        legend=dict(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9), axes=axes,
    )  # fmt: skip
    axes.set_xlim(0, 1)
    return axes


def _loaded_torsion(_):
    """On the right what the bench evaluates: backlash at no load, lost motion at 3 % of the rated torque."""
    _, torque, found = _loaded_cases()
    bench = loaded.torsion(*_loaded_unit(), input_angle=0.0, rated_torque=412.0)
    zero = (bench.angle[3] + bench.angle[4]) / 2  # the mid-point of the backlash
    curve = {"output, input held": (found.error[61:] - zero) / arcmin}
    labels = dict(xlabel="load at the output (N m)", ylabel="angle of the output (arcmin)")
    figure, both = plt.subplots(1, 2, figsize=(9.6, 4.4))
    for axes in both:
        plotting.lines(-torque, curve, **labels, axes=axes)
        axes.plot(-bench.torque, (bench.angle - zero) / arcmin, "o", mfc="white")
    both[0].set_title(f"stiffness {bench.stiffness * arcmin:.4g} N m/arcmin")
    reach = 0.06 * 412.0
    for name, value, colour in (("backlash", bench.backlash, "C2"), ("lost motion", bench.lost_motion, LIMIT)):
        for side in (-0.5, 0.5):
            label = f"{name} {value / arcmin:.3f} arcmin" if side > 0 else None
            both[1].axhline(side * value / arcmin, color=colour, ls=":", label=label)
    both[1].set(xlim=(-reach, reach), ylim=np.array([-1, 1]) * bench.lost_motion / arcmin)
    both[1].set_title("grey: 3 % of the rated torque")
    for load in (-0.5 * reach, 0.5 * reach):
        both[1].axvline(load, color="0.6", lw=0.8)
    both[1].legend(loc="upper left", fontsize=9)
    return figure


def _loaded_orders(_):
    turns = {"412 N m": loaded.revolution(*_loaded_unit(), output_torque=412.0, turns=1.0, samples=512)}
    figure, axes = plt.subplots(2, 1, figsize=(8, 6.4))
    plotting.lines(
        np.arange(512) * 360 / 512,
        {
            f"{name}: {turn.peak_to_peak / arcsec:.1f} arcsec peak to peak": (turn.error - turn.mean) / arcsec
            for name, turn in turns.items()
        },
        xlabel="angle of the output (deg)", ylabel="transmission error less its mean (arcsec)",
        legend=dict(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9), axes=axes[0],
    )  # fmt: skip
    axes[0].set(xlim=(0, 360), xticks=range(0, 361, 60))
    size = 2 / 512 * np.abs(np.fft.rfft(turns["412 N m"].error))[1:] / arcsec
    axes[1].vlines(np.arange(1, 251), 0, size[:250], lw=1.6)
    for order in np.argsort(-size)[:6] + 1:
        axes[1].annotate(f" {order}", (order, size[order - 1]), va="bottom", ha="center", fontsize=9, rotation=90)
    axes[1].set(xlabel="order of the output turn", ylabel="amplitude (arcsec)", xlim=(0, 251))
    axes[1].set_ylim(0, 1.15 * size.max())
    return figure


def _loaded_measured(axes):
    rows = {figure["id"]: figure for figure in published.figures("rv160")}
    model = np.empty(len(rv160.TORQUE))
    model[rv160.FITTED] = rows["rv160.windup.fitted"]["our_value"]
    model[~rv160.FITTED] = rows["rv160.windup.predicted"]["our_value"]
    bench = rv160.MEASURED / arcmin
    miss = np.abs(model - bench)[~rv160.FITTED].max()
    curves = {f"model, fitted to every second torque: predicted within {miss:.3f} arcmin": model}
    curves["measured, fitted to"] = np.where(rv160.FITTED, bench, np.nan)
    curves["measured, predicted"] = np.where(rv160.FITTED, np.nan, bench)
    points = dict(color="black", ls="", marker="o", ms=6)
    plotting.lines(
        rv160.TORQUE, curves, looks={"measured, fitted to": points, "measured, predicted": points | {"mfc": "white"}},
        xlabel="torque at the output (N m)", ylabel="half of backward less forward error (arcmin)", axes=axes,
    )  # fmt: skip
    return axes


def _gauge_picture(axes):
    kept = stored("assembly")["gauge"]
    axes.axhline(100, color=BEFORE, ls="--", label="random assembly")
    axes.axhline(100 * kept["came true"][0], color="0.5", ls=":", label="exact measurement")
    plotting.lines(
        kept["sd"], {"promised": 100 * np.array(kept["promised"]), "came true": 100 * np.array(kept["came true"])},
        looks={"promised": {"marker": "o"}, "came true": dict(color=LIMIT, ls="", marker="x", ms=9, mew=2)},
        xlabel="measurement uncertainty (share of the spread of the parts)", ylabel="mean response (% of random)",
        title="What the gauge lets through", axes=axes,
    )  # fmt: skip
    axes.set_ylim(0, None)
    return axes


def _correction_picture(axes):
    """A curve after the measured amplitudes of an RV reducer at 1.2 kN m, its correction from a noisy measurement."""
    order, rng = np.array([3, 39, 40, 78, 81]), np.random.default_rng(0)
    value = np.array([3.14, 4.83, 2.74, 4.56, 1.25]) * arcsec * np.exp(1j * np.arange(5))
    angle = np.linspace(0, 2 * np.pi, 1440)
    error = np.real(np.exp(1j * np.outer(angle, order)) @ value) + 0.3 * arcsec * rng.standard_normal(angle.size)
    seen = value + 0.3 * arcsec * (rng.standard_normal(5) + 1j * rng.standard_normal(5))
    found = compensation.correction(order, seen, ratio=81, sd=0.3 * arcsec, angle_sd=60 * arcsec)
    return plotting.corrected_curve(angle, error, found, axes=axes)


def _bench_picture(axes):
    kept = stored("bench_table")
    numbers = kept["numbers"]
    rows = {
        bench: [100 * found["known"][name] / count for name, count in numbers.items()]
        for bench, found in kept["benches"].items()
    }
    names = [f"{plotting.words(name)} ({count})" for name, count in numbers.items()]
    plotting.bars(names, rows, xlabel="of its numbers, known (%)", axes=axes)
    axes.set_xlim(0, 100)
    axes.tick_params(axis="y", labelsize=8)
    axes.legend(loc="lower right", fontsize=8)
    return axes


def _contributions(axes):
    found = lost_motion.geometric(catalogue.RV_20E, catalogue.RV_20E_ERRORS)
    terms = {plotting.words(name): float(value) / arcmin for name, value in vars(found.terms).items() if value}
    total = f"sum {found.total / arcmin:+.3f} arcmin"
    plotting.bars([*terms], {"contribution": [*terms.values()]}, xlabel="contribution (arcmin)", axes=axes)
    axes.bar_label(axes.containers[0], fmt="%+.3f", padding=3, fontsize=9)
    axes.axvline(found.total / arcmin, color=LIMIT, ls="--", zorder=0, label=total)
    axes.margins(x=0.15)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return axes


def _loop(axes):
    """Torque-angle loop of an output whose torque is cycled, as a test bench plots it."""
    branch = np.linspace(-167, 167, 801)
    torque = np.concatenate([branch[400:], branch[::-1], branch])
    angle = lost_motion.hysteresis_loop(
        torque, play=1 * arcmin, stiffness=50 / arcmin, friction=2.0, smoothing=1.5
    ) / arcmin  # fmt: skip
    axes.plot(torque[401:], angle[401:], color=AFTER, lw=2.0, label="cycle")
    axes.plot(torque[:401], angle[:401], color=BEFORE, ls="--", lw=1.2, label="first loading")
    for k, threshold in enumerate((5, -5)):
        axes.axvline(threshold, color=LIMIT, lw=1.0, ls=":", label="" if k else "+-5 N m")
    axes.set(xlabel="torque at the output (N m)", ylabel="angle of the output (arcmin)")
    axes.set_title("Torque-angle loop, input locked")
    axes.legend(loc="upper left")
    return axes


PICTURES = {
    "assembly_gauge": (_gauge_picture, (7, 4.2)),
    "correction": (_correction_picture, (7, 4.2)),
    "bench_table": (_bench_picture, (7, 7.2)),
    "reducer": (lambda axes: drawings.reducer(catalogue.RV_40E, axes=axes), (7, 7.4)),
    "drive": (lambda axes: plotting.drive.reducer(catalogue.CYCLOIDAL_17, axes=axes), (7, 7.4)),
    "drive_errors": (lambda axes: plotting.drive.errors(catalogue.CYCLOIDAL_17, axes=axes), (11, 6.4)),
    "linkage": (lambda axes: drawings.linkage(catalogue.RV_40E, axes=axes), (7, 5.2)),
    "turn": (_turn, (7, 4.2)),
    "contributions": (_contributions, (8.4, 4.4)),
    "loop": (_loop, (7, 4.2)),
    "tooth": (lambda axes: drawings.tooth(catalogue.CORR, axes=axes), (7, 4.6)),
    "campbell": (_campbell, (7, 4.6)),
    "joint_orders": (_joint_orders, (7, 4.2)),
    "joint_batch": (_joint_batch, (7, 4.2)),
    "loaded_pins": (_loaded_pins, None),
    "loaded_sharing": (_loaded_sharing, (7, 4.2)),
    "loaded_torsion": (_loaded_torsion, None),
    "loaded_orders": (_loaded_orders, None),
    "loaded_measured": (_loaded_measured, (7, 4.4)),
    "budget_machine": (two_studies.budget, None),
    "two_studies": (two_studies.picture, (7.6, 4.4)),
    "tradeoff": (lambda axes: plotting.tradeoff(table.stored()), None),
}
