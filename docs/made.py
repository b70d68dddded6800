"""What the docs show of rvjax itself, made while they are built: drawings, and tables that never go stale."""

import dataclasses
import json
from functools import cache
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from scipy import special

import rvjax
from benchmarks import bench_table
from rvjax import (
    catalogue,
    compensation,
    dynamics,
    four_bar,
    levels,
    loaded,
    lost_motion,
    models,
    plotting,
    published,
    study,
    tolerances,
    units,
)
from rvjax.errors import CamRollerErrors, RVErrors
from rvjax.levels import table
from rvjax.plotting import drawings, dynamic_error
from rvjax.plotting import dynamics as dynamic_pictures
from rvjax.plotting import identified as identified_pictures
from rvjax.plotting import mesh_force as mesh_pictures
from rvjax.plotting.style import AFTER, BEFORE
from rvjax.published import rv160
from rvjax.report.text import tolerance_text
from rvjax.status import MEANING, PRECEDENCE, SUCCESS
from rvjax.units import arcmin, arcsec, readable, rpm, um


def everything(folder: Path) -> None:
    """Write all pictures and tables."""
    folder.mkdir(exist_ok=True)
    rvjax.enable_x64()
    for name, text in TEXTS.items():
        _write(folder / f"{name}.md", text().encode())
    with plotting.style():
        for name, (draw, size) in PICTURES.items():
            figure = draw(plt.subplots(figsize=size)[1] if size else None)
            getattr(figure, "figure", figure).savefig(folder / f"{name}.png", dpi=110)
            plt.close("all")


def _write(path: Path, content: bytes) -> None:
    if not path.exists() or path.read_bytes() != content:  # an unchanged page is not built again
        path.write_bytes(content)


def _table(headers, rows):
    lines = [headers, ["---"] * len(headers), *rows]
    cell = lambda value: str(value).replace("|", "\\|").replace("\n", " ")  # noqa: E731
    return "\n".join("| " + " | ".join(map(cell, line)) + " |" for line in lines) + "\n"


def _statuses():
    rows = [(f"`{s.name}`", MEANING[s], "passes" if s in SUCCESS else "raises") for s in PRECEDENCE]
    return _table(["status, worst first", "meaning", "`check`"], rows)


def _units():
    rows = [(f"`{unit}`", ", ".join(f"`{name}`" for name in names)) for unit, names in units.KNOWN.items()]
    return _table(["SI unit", "what a study file may write"], rows)


def _outputs():
    rows = [
        (f"`{kind}`", f"`{name}`", output.unit, output.meaning)
        for kind, design in models.kinds().items()
        for name, output in models.kind_of(design).outputs.items()
    ]
    return _table(["kind of design", "response", "unit", "meaning"], rows)


def _conditions():
    blocks = []
    for name, design in models.kinds().items():
        rows = []
        for f in dataclasses.fields(models.kind_of(design).conditions):
            choices = ", ".join(f"`{choice}`" for choice in f.metadata["choices"] or ())
            what = choices or f.metadata["unit"] or f"count, {f.metadata['minimum']} to {f.metadata['maximum']}"
            rows.append((f"`{f.name}`", what, "-" if f.default is None else f"`{f.default}`", f.metadata["meaning"]))
        blocks += [f"For designs of kind `{name}`:\n", _table(["key", "unit or choices", "default", "meaning"], rows)]
    return "\n".join(blocks)


def _errors(cls):
    rows = [(f"`{f.name}`", f.metadata["unit"], _shape(f), f.metadata["meaning"]) for f in dataclasses.fields(cls)]
    return _table(["error", "unit", "shape", "meaning; a deviation from nominal"], rows)


def _shape(f):
    return " x ".join(map(str, f.metadata["shape"])) or "one number"


def _levels():
    blocks = []
    for model in table.stored().models.values():
        first = next(iter(model.outputs))
        unit, size = ("arcsec", arcsec) if model.outputs[first] == "rad" else readable(model.outputs[first])
        front, at = model.front(), model.sizes.index(min(model.sizes, key=lambda s: abs(s - 1)))
        rows = []
        for level in sorted(model.levels, key=lambda level: level.ns):
            mark = "**" if level in front else ""
            error = level.largest[first][at] / size
            rows.append(
                (f"{mark}{level.name}{mark}", f"{level.ns / 1e3:.3g}", f"{error:.2g}", f"{model.relative(level):.1g}")
            )
        blocks += [
            f"## {model.name}: {first.replace('_', ' ')}\n",
            f"One case is a {model.case}.\n\n{levels.advice(model)}\n",
            _table(
                ["level (bold: on the front)", "time, us", f"largest error, {unit}", "over rms of the output"], rows
            ),
        ]
    stored = table.stored()
    machine = ", ".join(
        f"{key} {value}" for key, value in stored.machine.items() if key in ("processor", "cores", "jax")
    )
    return "\n".join([*blocks, f"\nMeasured on: {machine}; seed {stored.seed}.\n"])


def _reproduce():
    """The ledger: the tests hold its values and verdicts against those that the models give."""
    blocks, counts = [], {}
    for source in published.SOURCES:
        rows = []
        for figure in published.figures(source):
            row = published.compare(figure, published.ours(figure))
            counts[row.status] = counts.get(row.status, 0) + 1
            parts = [f"`{row.id}`", _plain(row.claim), *([f"*{_plain(row.note)}*"] if row.note else [])]
            shown = [published.show(value) for value in (row.published, row.computed)]
            rows.append(("<br>".join(parts), *shown, row.unit, row.status.replace("_", " ")))
        blocks += [f"## {source}\n", published.parse(source)["citation"] + ".\n"]
        blocks.append(_table(["figure, claim, and why", "published", "computed", "unit", "verdict"], rows))
    verdicts = [(verdict.replace("_", " "), number) for verdict, number in sorted(counts.items())]
    return _table(["verdict", "figures"], [*verdicts, ("all", sum(counts.values()))]) + "\n" + "\n".join(blocks)


def _plain(text):
    """Ledger text is plain: nothing in it is Markdown."""
    for character in "\\`*_<>$[]{}":
        text = text.replace(character, "\\" + character)
    return text


def _turn(axes):
    design = catalogue.RV_40E

    @jax.jit
    def turn(clearance, torque):
        errors = RVErrors.for_design(design, crank_eccentricity=[[5 * um, 0], [0, 0]], bearing_clearance=clearance)
        return four_bar.revolution(design, errors, angles=180, output_torque=torque)

    for label, clearance, torque, colour, dash in (
        ("one crank journal +5 um", 0.0, 0.0, AFTER, "-"),
        ("and 8 um of bearing clearance under 412 N m", 8 * um, 412.0, BEFORE, "--"),
    ):
        found = turn(clearance, torque)
        error = np.asarray(found.error - found.mean) / arcmin
        axes.plot(np.degrees(found.crank_angle), error, linestyle=dash, color=colour, label=label)
    axes.set(xlabel="crank angle (deg)", ylabel="transmission error less its mean (arcmin)", xlim=(0, 360))
    axes.set_title("Transmission error over a crank turn")
    axes.set_xticks(range(0, 361, 60))
    axes.legend()
    return axes


def _campbell(axes):
    design = catalogue.RV_320E
    speed = np.linspace(100, 2000, 200) * rpm
    per_turn = design.involute.sun_teeth * (1 - 1 / float(_ratio(design)))
    return dynamic_pictures.campbell(
        dynamics.modes(design), speed, per_turn * speed / (2 * np.pi),
        harmonics={1: "translational", 2: "planetary", 4: "rotational"}, axes=axes,
    )  # fmt: skip


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
    return dynamic_error.campbell_amplitudes(
        jax.tree.map(lambda x: x[1], units), speeds, ratio=question.design.ratio, modes=modes, highest=80, axes=axes
    )


def _joint_batch(axes):
    question, speeds, units = _joint()
    turns = speeds / question.design.ratio
    frequency = turns[:, None] * np.asarray(units.order[0])
    rms = np.sqrt(np.sum(np.abs(units.amplitude[..., 0] * frequency**2) ** 2, axis=2) / 2)
    limit = question.requirements["dynamic_vibration"].upper
    return dynamic_error.batch_over_speed(turns, rms, unit="rad/s2", name="vibration", limit=limit, axes=axes)


def _ratio(design):
    return 1 + design.cycloid.pin_count * design.involute.planet_teeth / design.involute.sun_teeth


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
        plotting.loaded.pin_forces(_loaded_unit()[0], one, input_angle=0.0, disc=k, axes=axes[k])
    return figure


def _loaded_sharing(axes):
    turn, _, found = _loaded_cases()
    return plotting.loaded.load_sharing(turn, jax.tree.map(lambda x: x[:61], found), axes=axes)


def _loaded_torsion(axes):
    _, torque, found = _loaded_cases()
    bench = loaded.torsion(*_loaded_unit(), input_angle=0.0, rated_torque=412.0)
    return plotting.loaded.torsion_curve(bench, torque=torque, angle=found.error[61:], axes=axes)


def _loaded_orders(_):
    turns = {"412 N m": loaded.revolution(*_loaded_unit(), output_torque=412.0, turns=1.0, samples=512)}
    figure, axes = plt.subplots(2, 1, figsize=(8, 6.4))
    plotting.loaded.output_turn(turns, axes=axes[0])
    plotting.loaded.output_orders(turns, highest=250, axes=axes[1])
    return figure


def _loaded_measured(axes):
    rows = {figure["id"]: figure for figure in published.figures("rv160")}
    model = np.empty(len(rv160.TORQUE))
    model[rv160.FITTED] = rows["rv160.windup.fitted"]["our_value"]
    model[~rv160.FITTED] = rows["rv160.windup.predicted"]["our_value"]
    curves = {"model, fitted to every second torque": model * arcmin}
    return plotting.loaded.measured_curve(rv160.TORQUE, rv160.MEASURED, rv160.FITTED, curves, axes=axes)


def _coverage():
    return json.loads((Path(__file__).parents[1] / "benchmarks" / "coverage.json").read_text())


def _percent(share, seeds, due=0.95):
    """A share of seeds; bold where what is due would be so far off in fewer than one case in a hundred."""
    hits = round(share * seeds)
    chance = min(special.bdtr(hits, seeds, due), special.bdtrc(hits - 1, seeds, due))
    return f"**{100 * share:.1f}**" if chance < 0.005 else f"{100 * share:.1f}"


def _coverage_rare():
    rows = [
        (
            name,
            f"{f['exact']:.2g}",
            f["seeds"],
            *(_percent(f[key], f["seeds"]) for key in ("held", "second held")),
            f"{f['mean over exact']:.3f}",
            f"{f['worst over exact']:.2f}",
            f"{100 * f['relative error']:.0f}",
            f"{100 * f['disagree']:.1f}",
            f"{f['evaluations'] - f['samples']:,}",
        )
        for name, f in _coverage()["rare"].items()
    ]
    heads = ["failures", "probability", "seeds", "held, %", "second held, %", "mean / exact", "worst / exact"]
    return _table([*heads, "error, %", "disagree, %", "units beside `samples`"], rows)


def _coverage_intervals():
    kept = _coverage()["intervals"]
    due = {"yield, lower end": 0.975}
    names = list(dict.fromkeys(name for found in kept.values() for name in found if name != "seeds"))
    rows = [
        (law, *(_percent(found[n], found["seeds"], due.get(n, 0.95)) if n in found else "-" for n in names))
        for law, found in kept.items()
    ]
    return _table(["law, method", *names], rows)


def _kept(name):
    return json.loads((Path(__file__).parents[1] / "benchmarks" / f"{name}.json").read_text())


def _assembly_gauge():
    kept = _kept("assembly")["gauge"]
    names = ["promised", "came true", "error of the difference", "unshrunk promise"]
    rows = [[f"{sd:g}", *(f"{100 * kept[name][k]:.1f} %" for name in names)] for k, sd in enumerate(kept["sd"])]
    headers = [
        "measurement sd",
        "promised",
        "came true",
        "standard error of the difference",
        "promised without population",
    ]
    return _table(headers, rows)


def _assembly_levers():
    kept = _kept("assembly")["levers"]
    rows = [
        [
            name,
            f"{100 * share:.0f} % ± {100 * kept['standard error'][name]:.0f}",
            f"{kept['mean, arcsec'][name]:.2f} arcsec",
        ]
        for name, share in kept["good units"].items()
    ]
    return _table(["chosen", f"units within {kept['limit, arcsec']:.1f} arcsec", "mean peak to peak"], rows)


def _gauge_picture(axes):
    kept = _kept("assembly")["gauge"]
    return plotting.assembly.gain_against_gauge(
        kept["sd"], kept["promised"], kept["came true"], chance=1.0, known=kept["came true"][0], axes=axes
    )


def _correction_picture(axes):
    """A curve after the measured amplitudes of an RV reducer at 1.2 kN m, its correction from a noisy measurement."""
    order, rng = np.array([3, 39, 40, 78, 81]), np.random.default_rng(0)
    value = np.array([3.14, 4.83, 2.74, 4.56, 1.25]) * arcsec * np.exp(1j * np.arange(5))
    angle = np.linspace(0, 2 * np.pi, 1440)
    error = np.real(np.exp(1j * np.outer(angle, order)) @ value) + 0.3 * arcsec * rng.standard_normal(angle.size)
    seen = value + 0.3 * arcsec * (rng.standard_normal(5) + 1j * rng.standard_normal(5))
    found = compensation.correction(order, seen, ratio=81, sd=0.3 * arcsec, angle_sd=60 * arcsec)
    return plotting.compensation.before_and_after(angle, error, found, axes=axes)


def _bench_table():
    rows = bench_table.table(_kept("bench_table"))
    return _table(rows[0], [[row[0].replace("_", " "), *row[1:]] for row in rows[1:]])


def _bench_picture(axes):
    kept = _kept("bench_table")
    benches = {bench: found["known"] for bench, found in kept["benches"].items()}
    return identified_pictures.known_numbers(kept["numbers"], benches, axes=axes)


def _end_of_line():
    kept = _kept("end_of_line")
    held = [(name.replace("_", " "), f"{100 * share:.1f} %") for name, share in kept["held"].items()]
    held.append(("all", f"{100 * kept['held in all']:.1f} %"))
    found = [
        (f"{size} sigma" if size != "0" else "none", f"{100 * share:.1f} %", f"{100 * kept['due'][size]:.1f} %")
        for size, share in kept["alarms"].items()
    ]
    return "\n".join(
        [
            _table(["intervals of 95 % that hold the truth", f"of {kept['units']:,} units"], held),
            _table(["one journal off by", "called broken", "due"], found),
        ]
    )


def _coverage_multi_fidelity():
    kept = _kept("multi_fidelity")
    rows = []
    for name, found in kept.items():
        for figure in ("mean", "sd", "yield"):
            of, case = found[figure], name.rpartition(",")[0] if figure == "mean" else ""
            held = _percent(of["held"], found["seeds"]), _percent(of["lower end held"], found["seeds"], 0.975)
            spared = f"{of['evaluations of plain for the same width']:.1f}"
            rows.append((case, figure, *held, f"{of['bias, standard errors']:+.1f}", spared))
    return _table(["response", "figure", "held, %", "lower end held, %", "off", "evaluations spared, times"], rows)


JUDGED = {
    "optimum of the four-bar, its errors alone": "optimum of rv-40e, the errors of the four-bar alone",
    "optimum of the four-bar": "optimum of rv-40e, all errors",
    "optimum of the four-bar, with its flanks": "the same with the flanks of rv-40e",
    "tolerances of rv-40e-whole": "tolerances of rv-40e-whole",
    "optimum of the machine": "optimum of rv-40e-whole",
}
"""Sets of tolerances judged on the whole machine, and how the docs call them."""


def _two_studies():
    kept = _kept("two_studies")
    shown = ["loaded_transmission_error", "second_transmission_error", "bench_lost_motion", "misfit"]
    rows = []
    for name, text in JUDGED.items():
        found = kept[name]
        yields = ("{:.1f} [{:.1f}, {:.1f}]".format(*(100 * x for x in found["yield"][n])) for n in shown)
        joint = "{:.1f}".format(100 * found["yield"]["all of rv-40e-whole"][0])
        cost = "-" if name.endswith("alone") else f"{found['cost']:.1f}"
        rows.append((text, *yields, joint, f"{found['99 % quantile']['pin_force']:.1f}", cost))
    heads = ["tolerances", "412 N m", "12.4 N m", "lost motion", "misfit", "all but 12.4 N m", "pins, kN", "cost"]
    return _table(heads, rows)


def _two_models():
    kept = _kept("two_studies")
    errors = {"412 N m": "loaded_transmission_error", "12.4 N m": "second_transmission_error"}
    rows = []
    for name in ("optimum of the four-bar, its errors alone", "optimum of the four-bar"):
        found = kept[name]
        quantile, above = found["99 % quantile"], {n: 100 * (1 - y[0]) for n, y in found["yield"].items()}
        rows.append(
            (
                JUDGED[name],
                "four-bar",
                f"{above['transmission_error']:.2f}",
                f"{quantile['transmission_error']:.2f}",
                "1",
            )
        )
        rows += [
            ("", load, f"{above[n]:.1f}", f"{quantile[n]:.2f}", f"{found['correlation with the four-bar'][load]:.2f}")
            for load, n in errors.items()
        ]
    heads = ["tolerances", "model", "units above 1 arcmin, %", "99 % quantile, arcmin", "correlation with the four-bar"]
    return _table(heads, rows)


def _two_tolerances():
    kept = _kept("two_studies")
    picture, machine = (kept[f"answer to {name}"]["limits"] for name in ("rv-40e", "rv-40e-whole"))
    start = study.load("rv-40e-whole", solve=False)
    four = study.load("rv-40e", solve=False)
    rows = []
    for name in dict.fromkeys([*four.costs, *start.costs]):
        cells = []
        for asked, limits in ((four, picture), (start, machine)):
            before = getattr(asked.tolerances, name)
            after = before and before.replace(**dict(zip(("lower", "upper"), limits[name])))
            cells += [tolerance_text(one, asked.unit(name)) if one else "-" for one in (before, after)]
        rows.append((f"`{name}`", *cells))
    heads = ["error", "rv-40e", "its optimum", "rv-40e-whole", "its optimum"]
    return _table(heads, rows)


def _two_picture(axes):
    kept = _kept("two_studies")
    models = {
        "four-bar": "transmission_error",
        "412 N m": "loaded_transmission_error",
        "12.4 N m": "second_transmission_error",
    }
    names = [name for name in JUDGED if not name.endswith("flanks")]
    for k, (model, response) in enumerate(models.items()):
        at = np.arange(len(names)) + 0.22 * (k - 1)
        value, lower, upper = np.array([kept[name]["yield"][response] for name in names]).T
        above = 100 * (1 - value)
        reach = np.abs(np.array([100 * (1 - upper), 100 * (1 - lower)]) - above)
        axes.errorbar(above, at, xerr=reach, fmt="osD"[k], color=(AFTER, BEFORE, "0.2")[k], capsize=3, label=model)
    axes.axvline(0.27, color="0.5", linestyle=":")
    axes.axvline(1, color="0.5", linestyle="--")
    axes.set_xscale("log")
    axes.set_xlim(0.005, 100)
    axes.set_yticks(range(len(names)), [JUDGED[name].replace(", ", ",\n") for name in names])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("units above 1 arcmin (%); dotted: 0.27, dashed: 1")
    axes.set_title("Transmission error: the picture and the machine")
    axes.legend(loc="upper left")
    return axes


def _budget_machine(_):
    kept = _kept("two_studies")["budget of rv-40e-whole"]

    def arrays(value):
        return {key: arrays(item) for key, item in value.items()} if isinstance(value, dict) else np.asarray(value)

    waves = {key: arrays(kept[key]) for key in ("orders", "variance", "total", "alike")}
    return plotting.error_budget(study.Budget(**(kept | waves)))


TEXTS = {
    "assembly_gauge": _assembly_gauge,
    "assembly_levers": _assembly_levers,
    "bench_table": _bench_table,
    "end_of_line": _end_of_line,
    "conditions": _conditions,
    "coverage_intervals": _coverage_intervals,
    "coverage_multi_fidelity": _coverage_multi_fidelity,
    "coverage_rare": _coverage_rare,
    "errors_cam_roller": lambda: _errors(CamRollerErrors),
    "errors_rv": lambda: _errors(RVErrors),
    "levels": _levels,
    "outputs": _outputs,
    "reproduce": _reproduce,
    "statuses": _statuses,
    "two_models": _two_models,
    "two_studies": _two_studies,
    "two_tolerances": _two_tolerances,
    "units": _units,
}
PICTURES = {
    "assembly_gauge": (_gauge_picture, (7, 4.2)),
    "correction": (_correction_picture, (7, 4.2)),
    "bench_table": (_bench_picture, (7, 7.2)),
    "reducer": (lambda axes: drawings.reducer(catalogue.RV_40E, axes=axes), (7, 7.4)),
    "linkage": (lambda axes: drawings.linkage(catalogue.RV_40E, axes=axes), (7, 5.2)),
    "turn": (_turn, (7, 4.2)),
    "contributions": (
        lambda axes: plotting.contributions(
            lost_motion.geometric(catalogue.RV_20E, catalogue.RV_20E_ERRORS), axes=axes
        ),
        (8.4, 4.4),
    ),
    "loop": (
        lambda axes: plotting.torque_angle_loop(
            torque_max=167.0,
            torque_threshold=5.0,
            play=1 * arcmin,
            stiffness=50 / arcmin,
            friction=2.0,
            smoothing=1.5,
            axes=axes,
        ),
        (7, 4.2),
    ),
    "tooth": (lambda axes: mesh_pictures.tooth(catalogue.CORR, axes=axes), (7, 4.6)),
    "campbell": (_campbell, (7, 4.6)),
    "joint_orders": (_joint_orders, (7, 4.2)),
    "joint_batch": (_joint_batch, (7, 4.2)),
    "loaded_pins": (_loaded_pins, None),
    "loaded_sharing": (_loaded_sharing, (7, 4.2)),
    "loaded_torsion": (_loaded_torsion, (7, 4.6)),
    "loaded_orders": (_loaded_orders, None),
    "loaded_measured": (_loaded_measured, (7, 4.4)),
    "budget_machine": (_budget_machine, None),
    "two_studies": (_two_picture, (7.6, 4.4)),
    "tradeoff": (lambda axes: plotting.tradeoff(table.stored()), None),
}
