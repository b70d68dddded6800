"""Measured times and errors of the levels of a model, and the cheapest level for an accuracy.

A level is one way to compute the same outputs: an approximation, a number of angles, a precision. `rvjax tradeoff`
measures and writes such a table, a study reads it. This file does not depend on gears.

The measured table as text, and for each model one sentence that says which level to use when.
"""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from rvjax.records import PyTree
from rvjax.units import arcsec, readable, with_unit

SAFETY = 2.0  # times the largest error that was measured


@dataclass(frozen=True)
class Level:
    """One measured level of a model.

    Attributes:
        name: for a person.
        settings: conditions that select it.
        precision: "float64" or "float32".
        largest: largest error of each output at each error size, SI.
        rms: root mean square error, likewise.
        ns: nanoseconds per case.
        compile_s: seconds to compile.
        memory_MB: temporary memory of the program.
        cases: in one call, when it was timed.
        instead: substitute output of another model, by the replaced output.
        without: physics of the reference that it leaves out.
    """

    name: str
    settings: dict[str, Any]
    precision: str
    largest: dict[str, list[float]]
    rms: dict[str, list[float]]
    ns: float
    compile_s: float
    memory_MB: float
    cases: int
    instead: dict[str, str] = dataclasses.field(default_factory=dict)
    without: str = ""

    def error(self, sizes: Sequence[float], output: str, size: float) -> float:
        """Largest measured error of an output at an error size within the measured ones.

        A straight line between logarithms. A level is never credited with a smaller error than at a smaller size.

        Args:
            sizes: measured error sizes, ascending.
            output: name.
            size: where.
        """
        values = np.maximum.accumulate(self.largest[output])
        values = values[np.isfinite(values)]  # it fails from the first size on where it was seen to
        if not values.size or size > sizes[values.size - 1]:
            return math.inf
        if values[-1] == 0:
            return 0.0
        logs = np.log(np.maximum(values, 1e-300))
        return float(np.exp(np.interp(math.log(size), np.log(sizes[: values.size]), logs)))


@dataclass(frozen=True)
class Model:
    """The levels of one model, and the cases they were measured on: outside their range nothing is known.

    Attributes:
        name: of the model.
        outputs: units of its outputs, by name.
        case: what one case is, for a person.
        design: numbers of the design that the model reads, around which cases were sampled, by path; counts too.
        spread: every such value was sampled within this share of itself.
        errors: reach of each sampled error, |mean| + 3 standard deviations at size 1, by field.
        sizes: factors on the errors, ascending.
        torque: smallest and largest, N m; None where it does not matter.
        conditions: that every case had, by name.
        typical: root mean square of each output at each size, SI.
        failed: cases without a reference value, left out, of how many.
        reference: name of the level that the errors are measured from.
        levels: measured, the reference among them.
        question: further conditions of every case; with others it is another question, of which nothing is known.
        others: errors, and paths of numbers of the design, that some level reads and that no case had.
        drawn: cases of each error size; 0 if not counted.
        machine: processor and cores of the measurement, if not those of the table.
    """

    name: str
    outputs: dict[str, str]
    case: str
    design: dict[str, float]
    spread: float
    errors: dict[str, float]
    sizes: list[float]
    torque: tuple[float, float] | None
    conditions: dict[str, Any]
    typical: dict[str, list[float]]
    failed: tuple[int, int]
    reference: str
    levels: tuple[Level, ...]
    question: dict[str, Any] = dataclasses.field(default_factory=dict)
    others: tuple[str, ...] = ()
    drawn: int = 0
    machine: dict[str, Any] = dataclasses.field(default_factory=dict)

    def level(self, name: str) -> Level:
        """The level of this name."""
        return next(level for level in self.levels if level.name == name)

    def bound(self, level: Level, output: str, size: float) -> float:
        """Bound of the error of an output: the largest measured error, interpolated in size, times `SAFETY`.

        Args:
            level: of this model.
            output: name.
            size: of the errors; at most the largest measured one.
        """
        return SAFETY * level.error(self.sizes, output, size)

    def cheapest(self, wanted: Mapping[str, float], size: float) -> Level:
        """The cheapest level whose bound meets every accuracy wanted; the reference where none does.

        Args:
            wanted: largest error allowed of each output, SI.
            size: of the errors.
        """
        if not self.sizes[0] <= size <= self.sizes[-1]:
            return self.level(self.reference)
        fits = [
            level
            for level in self.levels
            if level.name == self.reference or all(self.bound(level, o, size) <= a for o, a in wanted.items())
        ]
        return min(fits, key=lambda level: level.ns)

    def front(self) -> list[Level]:
        """Levels that no other beats in both cost and error (first output, error size nearest 1), cheapest first."""
        kept: list[Level] = []
        for level in sorted(self.levels, key=lambda level: level.ns):
            if not kept or self.relative(level) < self.relative(kept[-1]):
                kept.append(level)
        return kept

    def relative(self, level: Level, kind: str = "largest") -> float:
        """Error of the first output at the error size nearest 1, over the root mean square of that output.

        Args:
            level: of this model.
            kind: "largest" or "rms".
        """
        output, k = next(iter(self.outputs)), int(np.argmin(np.abs(np.log(self.sizes))))
        return getattr(level, kind)[output][k] / self.typical[output][k]


@dataclass(frozen=True)
class Table:
    """Everything measured in one run.

    Attributes:
        machine: processor, cores, versions, flags.
        seed: of the cases.
        models: measured, by name.
    """

    machine: dict[str, Any]
    seed: int
    models: dict[str, Model]

    def save(self, path: str | Path) -> None:
        """Write as JSON."""
        Path(path).write_text(json.dumps(self.as_json(), indent=1, allow_nan=False) + "\n", "utf-8")

    def as_json(self) -> dict[str, object]:
        """Table as JSON values; an error without bound is null."""
        return _plain(dataclasses.asdict(self))

    @classmethod
    def load(cls, path: str | Path | Traversable) -> Self:
        """Read what `save` wrote."""
        data = json.loads(path.read_text("utf-8") if hasattr(path, "read_text") else Path(path).read_text("utf-8"))
        models = {}
        for name, model in data["models"].items():
            levels = tuple(
                Level(**(level | {kind: _lists(level[kind]) for kind in ("largest", "rms")}))
                for level in model.pop("levels")
            )
            model |= {"torque": model["torque"] and tuple(model["torque"]), "failed": tuple(model["failed"])}
            model["others"] = tuple(model.get("others", ()))
            model["conditions"] = {name: _tuples(value) for name, value in model["conditions"].items()}
            models[name] = Model(**model, levels=levels)
        return cls(data["machine"], data["seed"], models)


@cache
def stored() -> Table:
    """The table that comes with rvjax; `rvjax tradeoff --json FILE` measures another on your computer."""
    return Table.load(resources.files("rvjax.levels") / "table.json")


def _tuples(value: object) -> object:
    """A table of a condition as conditions hold it."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _plain(value: object) -> PyTree:
    """Replace infinity, which JSON lacks: a level that fails has null for its error."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value


def _lists(errors: dict[str, list[float | None]]) -> dict[str, list[float]]:
    return {name: [math.inf if value is None else value for value in values] for name, values in errors.items()}


STEP = 5.0  # a level is mentioned if it is this many times as accurate as the last mentioned level


class Block(NamedTuple):
    """Text on one model."""

    head: str
    titles: tuple[str, ...]
    rows: list[list[str]]  # a level each
    foot: str  # advice


def blocks(table: Table) -> list[Block]:
    """Levels and advice of each model."""
    return [_block(model) for model in table.models.values()]


def measured_on(table: Table) -> str:
    """Computer and seed of a table."""
    facts = ", ".join(f"{key} {value}" for key, value in table.machine.items() if value not in ("", []))
    return f"Measured on {facts}; seed {table.seed}."


def advice(model: Model) -> str:
    """Advise on levels, from the measured errors at the error size nearest 1 and times."""
    *mentioned, exact = worth_a_mention(model)
    if not mentioned:
        return f"Only {exact.name} ({_time(exact.ns)}) is useful: faster levels have errors as large as the output."
    parts = [f"for an error below {_error(model, level)} {level.name} ({_time(level.ns)})" for level in mentioned]
    return "Take " + "; ".join([*parts, f"for less {exact.name} ({_time(exact.ns)})"]) + "."


def worth_a_mention(model: Model) -> list[Level]:
    """Levels of the front, each several times as accurate as the one before, and the exact one."""
    mentioned: list[Level] = []
    exact = model.level(model.reference)
    for level in model.front():
        last = model.relative(mentioned[-1]) if mentioned else float("inf")
        if level is not exact and model.relative(level) < 1 and model.relative(level) * STEP <= last:
            mentioned.append(level)
    return [*mentioned, exact]


def _block(model: Model) -> Block:
    first = next(iter(model.outputs))
    unit, unit_size = _shown(model.outputs[first])
    failed = f"; {model.failed[0]} of {model.failed[1]} cases without a reference excluded" if model.failed[0] else ""
    size = min(model.sizes, key=lambda s: abs(s - 1))
    head = [
        f"{model.name}: {first} per {model.case}",
        f"error against {model.reference}, at {size:g} x the errors, relative to the rms of the output{failed}",
    ]
    front, rows = model.front(), []
    for level in sorted(model.levels, key=lambda level: level.ns):
        shown = level.largest[first][model.sizes.index(size)] / unit_size
        errors = [f"{x:.2g}" for x in (model.relative(level), model.relative(level, "rms"), shown)]
        spent = [_time(level.ns), f"{level.compile_s:.1f}", f"{level.memory_MB:.1f}"]
        rows.append([f"{'*' if level in front else ' '} {level.name}", *errors, *spent])
    foot, about = [advice(model)], [f"{model.drawn} cases of each error size"] if model.drawn else []
    about += [f"on {model.machine['processor']}, {model.machine['cores']} cores"] if model.machine else []
    titles = ("level", "largest", "rms", unit, "time", "compile s", "MB")
    foot += [", ".join(about) + "."] if about else []
    return Block("\n".join(head), titles, rows, "\n".join(foot))


def _error(model: Model, level: Level) -> str:
    first = next(iter(model.outputs))
    bound = SAFETY * level.largest[first][min(range(len(model.sizes)), key=lambda k: abs(model.sizes[k] - 1))]
    unit, size = _shown(model.outputs[first])
    return with_unit(bound / size, unit, ".2g")


def _shown(unit: str) -> tuple[str, float]:
    return ("arcsec", arcsec) if unit == "rad" else readable(unit)


def _time(ns: float) -> str:
    for limit, size, name in ((1e3, 1, "ns"), (1e6, 1e3, "us"), (1e9, 1e6, "ms")):
        if ns < limit:
            return f"{ns / size:.3g} {name}"
    return f"{ns / 1e9:.3g} s"
