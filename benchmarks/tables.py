"""Tables of the docs that follow from the code: errors, conditions, outputs of each kind of reducer, units, statuses.

    python -m benchmarks.tables

writes the pages of `docs/tables`. A test compares them with the code.
"""

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rvjax import models, units
from rvjax.status import MEANING, PRECEDENCE, SUCCESS

FOLDER = Path(__file__).parents[1] / "docs" / "tables"
NAMES = {
    "rv": "RV reducer",
    "cycloidal": "Single-stage cycloidal drive",
    "oscillatory-roller": "Oscillatory roller stage",
}
"""Titles of the kinds of reducers, by the name that study files give them."""


def stored(name: str) -> Any:
    """Stored results of a script of this folder."""
    return json.loads((Path(__file__).parent / f"{name}.json").read_text("utf-8"))


def table(headers: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    lines = [headers, ["---"] * len(headers), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines) + "\n"


def _cell(value: Any) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")


def errors(design: type) -> str:
    """Errors of the parts of a kind of reducer."""
    rows = [
        (f"`{f.name}`", f.metadata["unit"], " x ".join(map(str, f.metadata["shape"])) or "one number", _meaning(f))
        for f in dataclasses.fields(design.error_record)  # type: ignore[attr-defined]
    ]
    return table(["error", "unit", "shape", "meaning"], rows)


def conditions(design: type) -> str:
    """Conditions of the models of a kind of reducer."""
    rows = []
    for f in dataclasses.fields(models.kind_of(design).conditions):
        choices = ", ".join(f"`{choice}`" for choice in f.metadata["choices"] or ())
        columns = ", ".join(f"`{key}` [{unit}]" for key, unit in (f.metadata["columns"] or {}).items())
        count = f"count, {f.metadata['minimum']} to {f.metadata['maximum']}"
        default = "-" if f.default is None else f"`{f.default}`"
        rows.append((f"`{f.name}`", choices or f.metadata["unit"] or columns or count, default, _meaning(f)))
    return table(["key", "unit or choices", "default", "meaning"], rows)


def outputs(design: type) -> str:
    """Outputs of the models of a kind of reducer."""
    found = models.kind_of(design).outputs.items()
    return table(["output", "unit", "meaning"], [(f"`{name}`", one.unit, one.meaning) for name, one in found])


def _meaning(f: Any) -> str:
    return str(f.metadata["meaning"])


def page(kind: str) -> str:
    """Page of a kind of reducer."""
    design = models.kinds()[kind]
    return (
        f"# {NAMES[kind]}: errors, conditions, outputs\n\n"
        f'Designs of `kind = "{kind}"` in a study ([](../study.md)).\n\n'
        "## Errors\n\nNames of `[tolerances.ERROR]`. An error is a deviation from nominal, in SI units.\n\n"
        f"{errors(design)}\n"
        f"## Conditions\n\nKeys of `[conditions]`.\n\n{conditions(design)}\n"
        f"## Outputs\n\nNames of `[requirement.NAME]`, in SI units.\n\n{outputs(design)}"
    )


def measurement_units() -> str:
    """Page of the units of measurement that a study may write."""
    rows = [(f"`{unit}`", ", ".join(f"`{name}`" for name in names)) for unit, names in units.KNOWN.items()]
    return f"# Units of measurement\n\n{table(['SI unit', 'a study file may write'], rows)}"


def statuses() -> str:
    """Page of the statuses of a solved value."""
    rows = [(f"`{s.name}`", MEANING[s], "passes" if s in SUCCESS else "raises") for s in PRECEDENCE]
    return f"# Statuses\n\n{table(['status, worst first', 'meaning', '`rvjax.check`'], rows)}"


def pages() -> dict[str, str]:
    """Text of each page, by the name of its file in `docs/tables`."""
    kinds = {f"{kind}.md": page(kind) for kind in NAMES}
    return {**kinds, "units.md": measurement_units(), "statuses.md": statuses()}


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, "utf-8")
