"""Tables and drawings of rvjax itself, made while the docs are built."""

import dataclasses
from pathlib import Path

import matplotlib.pyplot as plt
import measured
import pictures
import two_studies
from stored import table

import rvjax
from rvjax import levels, models, plotting, published, units
from rvjax.errors import CamRollerErrors, RVErrors
from rvjax.levels.table import stored as measured_levels
from rvjax.status import MEANING, PRECEDENCE, SUCCESS
from rvjax.units import arcsec, readable


def everything(folder: Path) -> None:
    """Write all pictures and tables."""
    folder.mkdir(exist_ok=True)
    rvjax.enable_x64()
    for name, text in TEXTS.items():
        _write(folder / f"{name}.md", text().encode())
    with plotting.style():
        for name, (draw, size) in pictures.PICTURES.items():
            figure = draw(plt.subplots(figsize=size)[1] if size else None)
            getattr(figure, "figure", figure).savefig(folder / f"{name}.png", dpi=110)
            plt.close("all")


def _write(path: Path, content: bytes) -> None:
    if not path.exists() or path.read_bytes() != content:  # an unchanged page is not built again
        path.write_bytes(content)


def _statuses():
    rows = [(f"`{s.name}`", MEANING[s], "passes" if s in SUCCESS else "raises") for s in PRECEDENCE]
    return table(["status, worst first", "meaning", "`check`"], rows)


def _units():
    rows = [(f"`{unit}`", ", ".join(f"`{name}`" for name in names)) for unit, names in units.KNOWN.items()]
    return table(["SI unit", "what a study file may write"], rows)


def _outputs():
    rows = [
        (f"`{kind}`", f"`{name}`", output.unit, output.meaning)
        for kind, design in models.kinds().items()
        for name, output in models.kind_of(design).outputs.items()
    ]
    return table(["kind of design", "response", "unit", "meaning"], rows)


def _conditions():
    blocks = []
    for name, design in models.kinds().items():
        rows = []
        for f in dataclasses.fields(models.kind_of(design).conditions):
            choices = ", ".join(f"`{choice}`" for choice in f.metadata["choices"] or ())
            columns = ", ".join(f"`{key}` [{unit}]" for key, unit in (f.metadata["columns"] or {}).items())
            what = (
                choices or f.metadata["unit"] or columns or f"count, {f.metadata['minimum']} to {f.metadata['maximum']}"
            )
            rows.append((f"`{f.name}`", what, "-" if f.default is None else f"`{f.default}`", f.metadata["meaning"]))
        blocks += [f"For designs of kind `{name}`:\n", table(["key", "unit or choices", "default", "meaning"], rows)]
    return "\n".join(blocks)


def _errors(cls):
    rows = [(f"`{f.name}`", f.metadata["unit"], _shape(f), f.metadata["meaning"]) for f in dataclasses.fields(cls)]
    return table(["error", "unit", "shape", "meaning; a deviation from nominal"], rows)


def _shape(f):
    return " x ".join(map(str, f.metadata["shape"])) or "one number"


def _levels():
    blocks = []
    for model in measured_levels().models.values():
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
            table(["level (bold: on the front)", "time, us", f"largest error, {unit}", "over rms of the output"], rows),
        ]
    stored = measured_levels()
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
        blocks.append(table(["figure, claim, and why", "published", "computed", "unit", "verdict"], rows))
    verdicts = [(verdict.replace("_", " "), number) for verdict, number in sorted(counts.items())]
    return table(["verdict", "figures"], [*verdicts, ("all", sum(counts.values()))]) + "\n" + "\n".join(blocks)


def _plain(text):
    """Ledger text is plain: nothing in it is Markdown."""
    for character in "\\`*_<>$[]{}":
        text = text.replace(character, "\\" + character)
    return text


TEXTS = {
    "assembly_gauge": measured.assembly_gauge,
    "assembly_levers": measured.assembly_levers,
    "bench_table": measured.bench,
    "end_of_line": measured.end_of_line,
    "conditions": _conditions,
    "coverage_intervals": measured.coverage_intervals,
    "coverage_rare": measured.coverage_rare,
    "errors_cam_roller": lambda: _errors(CamRollerErrors),
    "errors_rv": lambda: _errors(RVErrors),
    "levels": _levels,
    "outputs": _outputs,
    "reproduce": _reproduce,
    "statuses": _statuses,
    "two_models": two_studies.models,
    "two_studies": two_studies.yields,
    "two_tolerances": two_studies.tolerances,
    "two_forces": two_studies.forces,
    "units": _units,
}
