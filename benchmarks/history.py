"""History of measurements: one file a day and computer in `benchmarks/history`, and a comparison of two files.

A figure is a speed if its name says so: a time (`ns`, `ms`, `s`; less is faster), memory (`MB`), or a ratio `a / b` or
`a_over_b` of two contenders that alternated in one process. Times of others (C, NumPy, SciPy, Numba) show how fast the
computer was that day. Times and memory are compared on one computer only, ratios between any two.
"""

import datetime
import json
import math
import re
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

HISTORY = Path(__file__).parent / "history"
OTHERS = re.compile(
    r"(?:^| )(?:numpy|scipy|numba|C|jax|unrolled|dense|time integration|time of the exact level"
    r"|COBY\w+|Nelder-Mead|Powell|differential evolution)\b",
    re.IGNORECASE,
)
# Largest over smallest of a figure when a script runs again on an idle computer: assumed, and replaced where several
# runs (`--repeat`) scattered more. Of two entries the factors multiply, for each may lie at either end of its own.
SCATTER = {"ratio": 1.1, "time": 1.2, "memory": 1.05}


class Change(NamedTuple):
    """One speed then and now."""

    script: str
    figure: str
    before: float
    after: float
    slower: float  # ratio, > 1 is slower or larger
    noise: float  # a ratio within it, or within its inverse, says nothing

    @property
    def beyond(self) -> bool:
        return not 1 / self.noise <= self.slower <= self.noise


def entries(folder: Path = HISTORY) -> dict[str, dict[str, Any]]:
    """All entries by name, oldest first."""
    found = {path.stem: json.loads(path.read_text("utf-8")) for path in folder.glob("*.json")}
    return dict(sorted(found.items(), key=lambda item: item[1]["date"]))


def newest(folder: Path = HISTORY) -> dict[str, Any]:
    """The last figures of every script at its usual size, whichever entry holds them."""
    found: dict[str, Any] = {}
    for entry in entries(folder).values():
        found |= {name: s for name, s in entry["scripts"].items() if not s["small"] or found.get(name, s)["small"]}
    return found


def keep(name: str, script: dict[str, Any], label: str = "", folder: Path = HISTORY) -> Path:
    """Store the values of a script in today's file of its computer, and return the path."""
    now, machine = datetime.datetime.now().isoformat(timespec="seconds"), script["machine"]["processor"] or "unknown"
    parts = [now[:10], re.sub(r"[^a-z0-9]+", "-", machine.lower()).strip("-"), *([label] if label else [])]
    path = folder / f"{'-'.join(parts)}.json"
    scripts = json.loads(path.read_text("utf-8"))["scripts"] if path.exists() else {}
    entry = {"date": now, "machine": machine, "scripts": scripts | {name: script}}
    folder.mkdir(exist_ok=True)
    path.write_text(json.dumps(entry, indent=1) + "\n", "utf-8")
    return path


def together(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """One entry of several runs of a script: the median of every speed, and its scatter as a ratio."""
    whole, scatter = dict(runs[-1]), {}
    whole["figures"] = dict(whole["figures"])
    for figure in whole["figures"]:
        values = [run["figures"].get(figure) for run in runs]
        if kind(figure) and all(isinstance(value, int | float) and 0 < value < math.inf for value in values):
            whole["figures"][figure] = statistics.median(values)
            scatter[figure] = max(values) / min(values)
    return whole | ({"scatter": scatter} if len(runs) > 1 else {})


def kind(figure: str) -> tuple[str, bool] | None:
    """Kind of a statistic, and true if less of it is faster; None if it is no speed of the library."""
    words = figure.replace("_", " ")
    if re.search(r"error|cost|accuracy|optimum", words):
        return None
    ratio = re.fullmatch(r"(.*?) (?:/|over) .*", words)
    if ratio:
        return "ratio", not OTHERS.search(ratio.group(1))
    if OTHERS.search(words):
        return None
    if words.endswith(" ratio"):
        return "ratio", True
    if re.search(r"\bMB\b", words):
        return "memory", True
    return ("time", True) if re.search(r"\b(ns|ms|s|seconds)\b", words) else None


def changes(before: dict[str, Any], after: dict[str, Any]) -> Iterator[Change]:
    """Every speed that two entries share and may be compared, the largest change first."""
    found = []
    for name in before["scripts"].keys() & after["scripts"].keys():
        old, new = before["scripts"][name], after["scripts"][name]
        same = all(old["machine"].get(key) == new["machine"].get(key) for key in ("processor", "cores", "backend"))
        for figure in old["figures"].keys() & new["figures"].keys():
            what, values = kind(figure), (old["figures"][figure], new["figures"][figure])
            if what is None or (what[0] != "ratio" and not same) or old["small"] != new["small"]:
                continue
            if not all(isinstance(value, int | float) and 0 < value < math.inf for value in values):
                continue
            slower = values[1] / values[0] if what[1] else values[0] / values[1]
            noise = math.prod(max(SCATTER[what[0]], e.get("scatter", {}).get(figure, 1)) for e in (old, new))
            found.append(Change(name, figure, *values, slower, noise))
    yield from sorted(found, key=lambda change: -abs(math.log(change.slower)))


def versions(entry: dict[str, Any]) -> str:
    """All versions that an entry was measured with."""
    return ", ".join(sorted({f"{k} {v}" for s in entry["scripts"].values() for k, v in s["versions"].items()}))


def report(before: dict[str, Any], after: dict[str, Any]) -> str:
    """List slower and faster values."""
    found = list(changes(before, after))
    beyond = [change for change in found if change.beyond]
    lines = [" -> ".join(f"{e['date']} ({e['machine']}; {versions(e)})" for e in (before, after))]
    for title, part in (
        ("slower", [c for c in beyond if c.slower > 1]),
        ("faster", [c for c in beyond if c.slower < 1]),
    ):
        lines.append(f"{title}: {len(part)}")
        lines += [
            f"  {max(c.slower, 1 / c.slower):6.2f} x  {c.script}: {c.figure}  {c.before:.4g} -> {c.after:.4g}"
            f"  (noise {c.noise:.2f} x)"
            for c in part
        ]
    lines.append(f"within noise: {len(found) - len(beyond)} of {len(found)} speeds")
    return "\n".join(lines)
