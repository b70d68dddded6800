"""Results of a census, as the tables of the page on stability."""

import json
from pathlib import Path
from typing import Any

CENSUS = Path(__file__).parent / "census.json"
PAGE = Path(__file__).parents[1] / "docs" / "stability.md"
BEGIN, END = "<!-- census begins -->\n", "<!-- census ends -->\n"


def stored() -> dict[str, Any]:
    """The census that the page shows."""
    return json.loads(CENSUS.read_text())


def tables(file: dict[str, Any]) -> str:
    """The census in two tables of Markdown: outcomes, and how far off."""
    entries = file["census"]
    groups = list(dict.fromkeys(e["group"] for e in entries))
    rows = [
        "| models | inputs | silent NaN or inf | wrong statuses of checked | poisoned gradients | statuses |",
        "|---|---:|---:|---:|---:|---|",
    ]
    for group in groups:
        own = [e for e in entries if e["group"] == group]
        counts: dict[str, int] = {}
        for entry in own:
            for name, many in entry["statuses"].items():
                counts[name] = counts.get(name, 0) + many
        total = {key: sum(e[key] for e in own) for key in own[0] if isinstance(own[0][key], int)}
        silent = total["silent"] + total["finite where NaN is due"] + total["float32 silent"]
        statuses = ", ".join(f"{name} {many:,}" for name, many in sorted(counts.items(), key=lambda item: -item[1]))
        rows.append(
            f"| {group} | {total['inputs']:,} | {silent} | {total['wrong status']} of {total['judged']:,} "
            f"| {total['poisoned gradients']} | {statuses} |"
        )
    rows += [
        "",
        "| model | largest residual | value off | derivatives above 1e-6 | worst derivative | float32 off |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for entry in entries:
        figures = [entry["worst"].get(name, {"figure": 0.0})["figure"] for name in
                   ("residual", "value", "derivative", "float32")]  # fmt: skip
        residual, value, derivative, single = (f"{figure:.1e}" if figure else "0" for figure in figures)
        many = f"{entry['derivatives above 1e-6']} of {entry['derivatives']:,}"
        rows.append(f"| {entry['model']} | {residual} | {value} | {many} | {derivative} | {single} |")
    return "\n".join(rows) + "\n"


def write_page(file: dict[str, Any], page: Path) -> None:
    """Put the tables between the marks of the page."""
    text = page.read_text()
    before, rest = text.split(BEGIN)
    page.write_text(before + BEGIN + "\n" + tables(file) + "\n" + END + rest.split(END)[1])
