"""`rvjax compare`: two results of `rvjax allocate` side by side, or under the requirements of one study."""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rvjax import study
from rvjax.base import progress
from rvjax.commands import Inputs, argument, option, quiet_option, whole_number
from rvjax.commands.cells import evaluated, failures_text, limit_text, limits_data, limits_of, met_text, share
from rvjax.commands.compare.results import (
    Crossed,
    Result,
    Rows,
    Topics,
    answered,
    compared,
    cost_of,
    crossed,
    only,
    put_into,
    result,
    shown,
)
from rvjax.commands.forecast import forewarn
from rvjax.records import PyTree
from rvjax.render import Cell, Column, Content, Limits, Note, Number, Quantity, Report, Table, Text
from rvjax.study import Study, numbers, shown as sized

__all__ = ["Crossed", "cost_of", "crossed", "put_into", "result"]


@dataclass(kw_only=True)
class CompareInputs(Inputs):
    """Print two results folders side by side: status, cost, tolerances, yields, variance shares, seeds, versions and
    differences. With --on, certify their tolerances under the requirements of one study.

    examples:
      rvjax compare results/rv-40e results/rv-40e-2
      rvjax compare before after --format json
      rvjax compare results/rv-40e results/rv-40e-whole --on rv-40e-whole
      rvjax compare results/rv-40e --on my-study.toml --samples 2000

    --on uses limits and distributions of a result for every error that the study has too. It lists the errors that
    only one of them has: the study keeps its tolerance, the other error is ignored. Costs are those of the study.
    exit code 0 for any content; 2 if a folder has no result.
    """

    first: str = argument("a results folder, or its result.json", "A")
    second: str | None = argument("second results folder; optional with --on", "B", nargs="?", default=None)
    on: str | None = option(
        "certify the tolerances of the results under this study: a file (.toml), or an embedded study", "STUDY"
    )
    samples: int | None = option(
        "independent units for --on (default: the study's certificate_samples)", "N", type=whole_number
    )
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the results, and the study that certifies their tolerances."""
        if self.second is None and self.on is None:
            raise ValueError("B is missing: name two results folders, or one folder and --on STUDY")
        if self.samples is not None and self.on is None:
            raise ValueError(f"--samples {self.samples}: only with --on STUDY")
        self.paths = {letter: path for letter, path in zip("AB", (self.first, self.second)) if path is not None}
        self.results = {letter: result(path) for letter, path in self.paths.items()}
        self.study: Study | None = None
        self.answers: dict[str, tuple[Study, PyTree]] = {}
        if self.on is not None:
            self.study = study.load(self.on, solve=False)  # a unit that fails counts among the others
            self.answers = {letter: answered(path) for letter, path in self.paths.items()}
            self.phases = tuple(map(_drawing, self.answers))
            forewarn(self.study)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two results, or one, side by side.

    Attributes:
        topics: what differs by topic and name, as `compared` gives it; empty for one result.
        crossed: certificates under the study of --on, by letter.
    """

    topics: Topics
    crossed: dict[str, Crossed]


def _drawing(letter: str) -> str:
    return f"units of {letter}"


def compute(inputs: CompareInputs) -> Comparison:
    """Compare two results; certify each under the study of --on."""
    topics = compared(*inputs.results.values()) if len(inputs.results) == 2 else {}
    found = {}
    for letter, (_, tolerances) in inputs.answers.items():
        progress.begin(_drawing(letter))
        assert inputs.study is not None
        found[letter] = crossed(inputs.study, tolerances, samples=inputs.samples)
    return Comparison(topics, found)


LISTED = 8  # names of equal values that are listed
NEAR = 1e-9  # relative: numbers of two designs that are equal


def report(inputs: CompareInputs, found: Comparison) -> Report:
    """The report on a comparison: verdicts, then what differs.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    said = [*(f"{letter}: {path}" for letter, path in inputs.paths.items()), ""]
    data: dict[str, object] = dict(found.topics)
    content: list[Content] = []
    if inputs.study is not None:
        own = {letter: answer for letter, (answer, _) in inputs.answers.items()}
        said += [f"{letter} on {inputs.study.name}: {_on(one)}" for letter, one in found.crossed.items()]
        content += [
            _yields(inputs.study, found.crossed),
            _tolerances(inputs.study, found.crossed),
            Note("\n".join(_explained(found.crossed, own))),
        ]
        data["on"] = _data(inputs.study, found.crossed, own)
    if found.topics:
        said += _verdicts(found.topics)
        content += _differences(inputs.results, found.topics)
    return Report("Comparison", (Note("\n".join(said)), *content), data=data)


def _verdicts(topics: Topics) -> list[str]:
    """Status and cost of each result, of the second with its difference."""
    status, cost = topics["run"]["verdict"], topics["cost"]["after"]
    lines = [f"{side.upper()}: {status[side]}" + (f", cost {cost[side]:.3f}" if cost[side] else "") for side in "ab"]
    change = f" ({_change(cost['a'], cost['b'], 'number')})" if cost["a"] and cost["b"] and not cost["same"] else ""
    return [lines[0], lines[1] + change]


def _on(found: Crossed) -> str:
    """Text on the requirements of a study: met, not met, not shown."""
    count, said = found.statistics.samples, dict[str, list[str]]()
    for name, verdict in (found.statistics.verdicts or {}).items():
        said.setdefault(met_text(found.study.requirements[name], verdict, count), []).append(name)
    if list(said) == ["met"]:
        return "all requirements met"
    last = sorted(said, key=lambda what: what == "met")
    return "; ".join(f"{what}: {', '.join(said[what])}" for what in last)


def _differences(results: Mapping[str, Result], topics: Topics) -> Iterator[Note | Table]:
    """Names in one result only, a table for each topic with values that differ, and names of equal values."""
    alone: list[str] = []
    hidden: set[str] = set()
    for (letter, one), other in zip(results.items(), reversed(list(results.values()))):
        limits = only(one, other, "certificate", "verdicts")
        errors = only(one, other, "tolerances")
        hidden |= {*limits, *errors}
        alone += [f"Requirements only in {letter}: {', '.join(_limit(one, name) for name in limits)}"] if limits else []
        alone += [f"Errors only in {letter}: {', '.join(errors)}"] if errors else []
    if alone:
        yield Note("\n".join(alone))
    equal = []
    for topic, every in topics.items():
        if topic.removeprefix("variance of ").partition(",")[0] in hidden:
            continue
        rows = {name: row for name, row in shown(topic, every).items() if name.rpartition(", ")[0] not in hidden}
        rows = {name: row for name, row in rows.items() if name not in hidden}
        if differing := {name: row for name, row in rows.items() if not row["same"]}:
            yield _topic(topic, differing)
        if same := [name for name, row in rows.items() if row["same"]]:
            listed = "; ".join(same) if len(same) <= LISTED else f"{len(same)} others"
            equal.append(f"  {topic}: {'all' if len(same) == len(rows) else listed}")
    if equal:
        yield Note("\n".join(["The same in both:", *equal]))


def _limit(result: Result, name: str) -> str:
    """A requirement with its limits, if the result has them."""
    said = (result.get("limits") or {}).get(name)
    return f"{name} ({said})" if said else name


def _topic(topic: str, rows: Rows) -> Table:
    """Table of one topic: values of both results, and the change from the first to the second."""
    cells = []
    for name, row in rows.items():
        a, b, unit = row["a"], row["b"], row["unit"]
        cells.append([name, _cell(a, unit), _cell(b, unit), _change(a, b, unit)])
    return Table(topic, [Text(topic), Column("A"), Column("B"), Text("change")], cells)


def _cell(value: PyTree, unit: str) -> str | Quantity | None:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or unit == "text":
        return None if value is None else str(value)
    if unit == "share":
        return Quantity(value, read_in="%", form=".4g" if value < 0.9 else ".3f")
    return Quantity(value, "-" if unit == "number" else unit)


def _change(a: PyTree, b: PyTree, unit: str) -> str:
    if unit == "text" or a is None or b is None:
        return "differs"
    if unit == "share":
        return f"{100 * (b - a):+.3g}"
    return f"{100 * (b / a - 1):+.1f} %" if a and math.isfinite(b / a) and a * b > 0 else "differs"


def _yields(study: Study, found: dict[str, Crossed]) -> Table:
    """Yields of the results under the requirements of the study."""
    columns: list[Column] = [Text("requirement"), Text("limit"), Text("required")]
    for letter in found:
        columns += [Column(f"{letter} [interval]"), Text("")]
    rows = []
    for name, requirement in study.requirements.items():
        output = study.output(name)
        row: list[Cell] = [name, limit_text(requirement, output), requirement.text()]
        for one in found.values():
            verdict = one.statistics.verdicts[name]
            row += [evaluated(verdict, output), met_text(requirement, verdict, one.statistics.samples)]
        rows.append(row)
    joint = [each for one in found.values() if (each := one.statistics.joint_yield) is not None]
    if len(joint) == len(found):  # none where no requirement limits single units
        rows.append(["all at once", "", "", *(cell for each in joint for cell in (share(each), ""))])
    return Table("yields", columns, rows)


def _tolerances(study: Study, found: dict[str, Crossed]) -> Table:
    """Tolerances and their costs under the study."""
    costs = [Number(f"cost {letter}", form=".3f") for letter in found]
    rows: list[list[Cell]] = []
    for name in study.fields:
        used, cost = [getattr(one.tolerances, name) for one in found.values()], study.costs.get(name)
        prices = [float(cost(tolerance.half_width)) if cost else None for tolerance in used]
        rows.append([name, *(limits_of(study, name, tolerance) for tolerance in used), *prices])
    rows.append(["sum", *(None for _ in found), *(one.cost for one in found.values())])
    return Table("tolerances", [Text("error"), *(Limits(k, missing="") for k in found), *costs], rows, total=True)


def _explained(found: dict[str, Crossed], answers: dict[str, Study]) -> list[str]:
    """Units of each certificate, and differences between result and study."""
    lines = []
    for letter, one in found.items():
        answer, name = answers[letter].name, one.study.name
        lines.append(f"{letter}: {one.statistics.samples:,} independent units, {failures_text(one.statistics)}")
        if one.own:
            lines.append(
                f"{letter}: {answer} has no tolerance for {', '.join(one.own)}: the tolerances of {name} are used"
            )
        if one.left:
            lines.append(f"{letter}: {name} has no tolerance for {', '.join(one.left)}: ignored")
        if apart := differences(answers[letter], one.study):
            deviate = f"the tolerances are applied to the design of {name}"
            lines.append(f"{letter}: {deviate}: {'; '.join(apart)}")
    return lines


def differences(answer: Study, study: Study) -> list[str]:
    """Numbers of the designs that both have and that differ, a line each.

    Args:
        answer: study of a result.
        study: of --on.
    """
    ours, theirs = dict(numbers(study.design)), dict(numbers(answer.design))
    return [
        f"{name} is {sized(theirs[name][0], unit)} in {answer.name} and {sized(value, unit)} in {study.name}"
        for name, (value, unit) in ours.items()
        if name in theirs and abs(theirs[name][0] - value) > NEAR * max(abs(theirs[name][0]), abs(value))
    ]


def _data(study: Study, found: dict[str, Crossed], answers: dict[str, Study]) -> dict[str, object]:
    sides = {
        letter.lower(): {
            "study": answers[letter].name,
            "taken": one.taken,
            "own": one.own,
            "left_out": one.left,
            "design": differences(answers[letter], study),
            "cost": one.cost,
            "tolerances": {
                name: {"unit": study.unit(name)} | limits_data(study, name, getattr(one.tolerances, name))
                for name in study.fields
            },
            "certificate": dataclasses.replace(one.statistics, values=None),
        }
        for letter, one in found.items()
    }
    return {"study": study.name, "answers": sides}
