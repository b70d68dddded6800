"""Drawings, and tables of stored measurements, made while the docs are built."""

from pathlib import Path

import matplotlib.pyplot as plt
import measured
import pictures
import two_studies

import rvjax
from benchmarks.tables import table
from rvjax import levels, plotting, published
from rvjax.levels.table import stored as measured_levels
from rvjax.study.kinds import drive_starts
from rvjax.units import arcsec, readable, um


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


def _processes():
    """Processes of single-stage drives, at the sizes of the drive of 17 lobes."""
    heads = ["process", "flank", "positions, diametral", "throw", "holes", "offset of flanks", "clearance of holes"]
    keys = {"flank": "+-", "position": "", "throw": "+-", "hole": "+-", "flank_clearance": "", "hole_clearance": ""}
    rows = [
        (f"`{name}`", *(f"{sign}{own[key] / um:g} um" for key, sign in keys.items()), ", ".join(own["materials"]))
        for name, own in drive_starts.PROCESSES.items()
    ]
    return table([*heads, "materials"], rows)


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
    "coverage_intervals": measured.coverage_intervals,
    "coverage_rare": measured.coverage_rare,
    "levels": _levels,
    "processes": _processes,
    "reproduce": _reproduce,
    "two_models": two_studies.models,
    "two_studies": two_studies.yields,
    "two_tolerances": two_studies.tolerances,
    "two_forces": two_studies.forces,
}
