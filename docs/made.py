"""What the docs show of rvjax itself, made while they are built: tables that never go stale, and the drawings."""

import dataclasses
from pathlib import Path

import matplotlib.pyplot as plt
import pictures
from scipy import special

import rvjax
from benchmarks import bench_table
from rvjax import levels, models, plotting, published, units
from rvjax.errors import CamRollerErrors, RVErrors
from rvjax.levels import table
from rvjax.status import MEANING, PRECEDENCE, SUCCESS
from rvjax.units import arcsec, readable


def everything(folder: Path, draft: bool = False) -> None:
    """Write all pictures and tables; a draft leaves empty what a model is compiled for."""
    folder.mkdir(exist_ok=True)
    rvjax.enable_x64()
    for name, text in TEXTS.items():
        _write(folder / f"{name}.md", text().encode())
    with plotting.style():
        for name, (draw, size) in pictures.PICTURES.items():
            axes = plt.subplots(figsize=size)[1] if size else None
            figure = plt.figure() if draft and name in pictures.SOLVED else draw(axes)
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
        for name, f in pictures.kept("coverage")["rare"].items()
    ]
    heads = ["failures", "probability", "seeds", "held, %", "second held, %", "mean / exact", "worst / exact"]
    return _table([*heads, "error, %", "disagree, %", "units beside `samples`"], rows)


def _coverage_intervals():
    kept = pictures.kept("coverage")["intervals"]
    due = {"yield, lower end": 0.975}
    names = list(dict.fromkeys(name for found in kept.values() for name in found if name != "seeds"))
    rows = [
        (law, *(_percent(found[n], found["seeds"], due.get(n, 0.95)) if n in found else "-" for n in names))
        for law, found in kept.items()
    ]
    return _table(["law, method", *names], rows)


def _assembly_gauge():
    kept = pictures.kept("assembly")["gauge"]
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
    kept = pictures.kept("assembly")["levers"]
    rows = [
        [
            name,
            f"{100 * share:.0f} % ± {100 * kept['standard error'][name]:.0f}",
            f"{kept['mean, arcsec'][name]:.2f} arcsec",
        ]
        for name, share in kept["good units"].items()
    ]
    return _table(["chosen", f"units within {kept['limit, arcsec']:.1f} arcsec", "mean peak to peak"], rows)


def _bench_table():
    rows = bench_table.table(pictures.kept("bench_table"))
    return _table(rows[0], [[row[0].replace("_", " "), *row[1:]] for row in rows[1:]])


def _end_of_line():
    kept = pictures.kept("end_of_line")
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
    kept = pictures.kept("multi_fidelity")
    rows = []
    for name, found in kept.items():
        for figure in ("mean", "sd", "yield"):
            of, case = found[figure], name.rpartition(",")[0] if figure == "mean" else ""
            held = _percent(of["held"], found["seeds"]), _percent(of["lower end held"], found["seeds"], 0.975)
            spared = f"{of['evaluations of plain for the same width']:.1f}"
            rows.append((case, figure, *held, f"{of['bias, standard errors']:+.1f}", spared))
    return _table(["response", "figure", "held, %", "lower end held, %", "off", "evaluations spared, times"], rows)


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
    "units": _units,
}
