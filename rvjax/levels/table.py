"""Measured times and errors of the levels of a model, and the cheapest level for an accuracy.

A level is one way to compute the same outputs: an approximation, a number of angles, a precision. `rvjax tradeoff`
measures and writes such a table, a study reads it. This file does not depend on gears.
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
from typing import Any, Self

import numpy as np

from rvjax.records import PyTree

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
        """As JSON values; an error without bound is null."""
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


def _tuples(value: PyTree) -> PyTree:
    """A table of a condition as conditions hold it."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _plain(value: PyTree) -> PyTree:
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
