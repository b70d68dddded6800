"""Results of a census, as tables of the page on stability (docs/stability.md) and of benchmarks/census/NOTES.md."""

import json
from pathlib import Path
from typing import Any

CENSUS = Path(__file__).parent / "census.json"
PAGE = Path(__file__).parents[2] / "docs" / "stability.md"
NOTES = Path(__file__).parent / "NOTES.md"
BEGIN, END = "<!-- census begins -->\n", "<!-- census ends -->\n"


def stored() -> dict[str, Any]:
    """The census that the page shows."""
    return json.loads(CENSUS.read_text())


def outcomes(file: dict[str, Any], *, statuses: bool) -> str:
    """Outcomes of every group of models in a table of Markdown.

    Args:
        file: the census.
        statuses: also the count of every status.
    """
    entries = file["census"]
    groups = list(dict.fromkeys(e["group"] for e in entries))
    rows = [
        "| models | inputs | silent NaN or inf | wrong statuses of checked | poisoned gradients |",
        "|---|---:|---:|---:|---:|",
    ]
    if statuses:
        rows = [rows[0] + " statuses |", rows[1] + "---|"]
    for group in groups:
        own = [e for e in entries if e["group"] == group]
        counts: dict[str, int] = {}
        for entry in own:
            for name, many in entry["statuses"].items():
                counts[name] = counts.get(name, 0) + many
        total = {key: sum(e[key] for e in own) for key in own[0] if isinstance(own[0][key], int)}
        silent = total["silent"] + total["finite where NaN is due"] + total["float32 silent"]
        listed = ", ".join(f"{name} {many:,}" for name, many in sorted(counts.items(), key=lambda item: -item[1]))
        rows.append(
            f"| {group} | {total['inputs']:,} | {silent} | {total['wrong status']} of {total['judged']:,} "
            f"| {total['poisoned gradients']} |" + statuses * f" {listed} |"
        )
    return "\n".join(rows) + "\n"


def deviations(file: dict[str, Any]) -> str:
    """Largest deviations of every model in a table of Markdown."""
    rows = [
        "| model | largest residual | value off | derivatives above 1e-6 | worst derivative | float32 off |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for entry in file["census"]:
        figures = [entry["worst"].get(name, {"figure": 0.0})["figure"] for name in
                   ("residual", "value", "derivative", "float32")]  # fmt: skip
        residual, value, derivative, single = (f"{figure:.1e}" if figure else "0" for figure in figures)
        many = f"{entry['derivatives above 1e-6']} of {entry['derivatives']:,}"
        rows.append(f"| {entry['model']} | {residual} | {value} | {many} | {derivative} | {single} |")
    return "\n".join(rows) + "\n"


def pages(file: dict[str, Any]) -> dict[Path, str]:
    """Text between the marks of each page."""
    return {PAGE: outcomes(file, statuses=False), NOTES: outcomes(file, statuses=True) + "\n" + deviations(file)}


def write_pages(file: dict[str, Any]) -> None:
    """Put the tables between the marks of the pages."""
    for page, tables in pages(file).items():
        before, rest = page.read_text().split(BEGIN)
        page.write_text(before + BEGIN + "\n" + tables + "\n" + END + rest.split(END)[1])
