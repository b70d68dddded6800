"""`rvjax design`: numbers of the design and tolerances together, the cheapest that meet the requirements of a study."""

import dataclasses
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import rvjax
from rvjax._jax.solved_state import moving
from rvjax.base.files import versions
from rvjax.catalogue import steep
from rvjax.commands import READING, WRITING, Inputs, argument, option, quiet_option, results_option, switch
from rvjax.commands.allocate import answer
from rvjax.commands.cells import assumed_text, failures_text, limits_data, sizes_table
from rvjax.commands.compare import cost_of
from rvjax.commands.design.optimum import JOINT, STEPS, TRADE, UNSCALED, Designed, Point, optima
from rvjax.commands.design.prices import block, price_note, script, slope, unit_of_number
from rvjax.commands.design.tables import headline, laws_of, numbers, others, requirements_of, saved_part, tolerances_of
from rvjax.commands.forecast import effort_of, forewarn, read_study
from rvjax.population import sample
from rvjax.render import Figure, Note, Report, Section, leading_comment, results_folder
from rvjax.study import Size, Study, StudyError, kind_of, number_at, outside, shown, sizes_of

MOST = 16  # points of the trade front


@dataclass(kw_only=True)
class DesignInputs(Inputs):
    """Find the numbers of the design (table [variable]) and the part tolerances together that meet all requirements at
    the least cost. Numbers of the design that follow a variable follow it by scaling laws. Independent units certify
    the result. The optimum in two steps (geometry first, tolerances after) is shown for comparison. Tables, drawings
    and a page go to a results folder.

    examples:
      rvjax design rv-40e-design
      rvjax init mine.toml --design
      rvjax design mine.toml --front 6

    The folder contains report.html, summary.txt, CSV tables, result.json (SI units, seed, versions), study.toml and
    plots. Existing results are never overwritten. exit code 1: no design and tolerances within the bounds meet the
    requirements (the summary prints how far the limits would have to move), or the result is not certified.
    """

    source: str = argument(
        "a study file (.toml) with [variable], or the embedded study rv-40e-design (default)",
        "STUDY",
        default="rv-40e-design",
    )
    front: int | None = option(
        "points of the trade front between the cost of tolerances and the priced outputs, 0 to 16 (default: 4; 0 "
        "for the loaded reducer)",
        "N",
        type=int,
    )
    alone: bool = switch("only the optimum: no optimum in two steps, none without scaling laws, no front")
    results: str | None = results_option("STUDY-design")
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the study, which has variables; each is read by an output."""
        self.study = read_study(self.source)
        if not self.study.variables:
            key = '[variable."cycloid.eccentricity"]'
            raise StudyError(f"{self.study.name}: [variable] is missing; add one, such as {key}")
        if self.front is not None and not 0 <= self.front <= MOST:
            raise ValueError(f"--front {self.front}: must lie between 0 and {MOST}")
        _refuse_unread(self.study)
        usual = effort_of(self.study).front
        self.points = 0 if self.alone or not self.study.objective else usual if self.front is None else self.front
        self.folder = results_folder(self.results, f"{self.study.name}-design")
        more = () if self.alone else (STEPS, UNSCALED)
        self.phases = (READING, JOINT, *more, *([TRADE] if self.points else []), WRITING)
        forewarn(self.study)
        self.memo = answer.memo(self.study, self.folder)


def _refuse_unread(asked: Study) -> None:
    """Raise an error for a variable on which no output depends, and for what the conditions cannot give."""
    response, errors = asked.design_response(), sample(asked.tolerances, 0, seed=0)
    start = {path: item.first for path, item in asked.variables.items()}
    read = moving(lambda values: response(errors, values).value, start)
    for path in start.keys() - read:
        outputs = ", ".join(response.response.outputs)
        raise StudyError(f'{asked.name}: variable."{path}": no required output depends on it ({outputs}); leave it out')


def compute(inputs: DesignInputs) -> Designed:
    """All optima that the options require."""
    return optima(inputs.study, inputs.memo, alone=inputs.alone, points=inputs.points, quiet=inputs.quiet)


def report(inputs: DesignInputs, found: Designed) -> Report:
    """The report on an optimum of design and tolerances.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    study, joint = inputs.study, found.joint.found
    certificate = joint.certificate
    fresh = f"Certificate: {certificate.samples:,} independent units, {failures_text(certificate)}"
    head = headline(study, found)
    return Report(
        title=f"{study.name}: design and tolerances",
        content=(
            Note(head, frozenset({"text"})),
            Section("Numbers of the design", (numbers(study, found), *_named(inputs, found, "section"))),
            Section("Tolerances", (tolerances_of(study, found), sizes_table(_sizes(found)))),
            Section("Requirements", (*requirements_of(study, found), Note(fresh))),
            Section("Prices in one currency", (price_note(study, found),)),
            *((block(),) if joint.margins else ()),
            Section("Other optima", (*others(study, found), *_named(inputs, found, "front"))),
            Section("Scaling laws", tuple(laws_of(study, found))),
            Note("\n".join(_notes(study, found))),
        ),
        status=joint.status,
        ok=joint.status == "OPTIMAL",
        data=data(study, found),
        files={"study.toml": study.text.encode()},
        page="",
        facts={
            "intro": leading_comment(study.text),
            "said": "; ".join(line.strip() for line in head.split("\n")[1:] if line),
            "boxes": _boxes(study, found),
            "origin": {"command": f"rvjax design {shlex.quote(study.name)}", "seed": str(study.seed)},
            "study": study.text,
            "script": script(study, found) if joint.margins else None,
        },
        main="report.html",
    )


def _sizes(found: Designed) -> list[Size]:
    """Sizes for the drawing of the optimum."""
    return sizes_of(found.joint.design, found.joint.found.tolerances)


def _named(inputs: DesignInputs, found: Designed, name: str) -> Iterator[Figure]:
    yield from (figure for figure in figures(inputs.study, found) if figure.name == name)


def _notes(study: Study, found: Designed) -> list[str]:
    lines = [f"warning: {line}" for line in study.doubts]
    used, joint = [law for law, _ in found.laws], found.joint
    made = dataclasses.replace(study, design=joint.design)
    lines += [f"Inaccurate: {line}" for line in made.inaccurate(joint.found.tolerances)]
    if joint.found.feasible:
        lines += [f"warning: {line}" for line in outside(study.design, joint.design, used)]
        lines += [f"warning: {line}" for line in steep(joint.design)]
    lines += [f"Assumed (not published): {assumed_text(study)}"] if study.assumed else []
    lines += ["Costs and prices are those of the study: compare ranges and prices, not one optimum only."]
    return lines + [f"Not modelled: {line}" for line in study.left_out]


def _boxes(study: Study, found: Designed) -> list[tuple[str, str, str]]:
    joint = found.joint.found
    boxes = [("cost", f"{joint.cost:.4g}", f"start {joint.start_cost:.4g}")]
    if found.two_step is not None and found.two_step.found.feasible and joint.feasible:
        steps = found.two_step.found.cost
        boxes.append(("together saves", saved_part(joint.cost, steps), f"in two steps {steps:.4g}"))
    for path, value in joint.values.items():
        unit = unit_of_number(study, path)
        before = shown(number_at(study.design, path), unit)
        boxes.append((path.rpartition(".")[2].replace("_", " "), shown(value, unit), f"from {before}"))
    return boxes


def data(study: Study, found: Designed) -> dict[str, Any]:
    """The result as JSON values.

    Args:
        study: solved study.
        found: its result.
    """
    joint = found.joint.found
    return {
        "study": study.name,
        "about": study.about,
        "status": joint.status,
        "feasible": joint.feasible,
        "reason": joint.reason,
        "seed": study.seed,
        "samples": study.samples,
        "versions": versions(),
        "cost": {"before": joint.start_cost, "after": joint.cost},
        "values": joint.values,
        "bounds_active": joint.bounds_active,
        "value_prices": joint.value_prices,
        "ranges": joint.ranges,
        "multipliers": joint.multipliers,
        "multiplier_intervals": joint.multiplier_intervals,
        "starts": joint.starts,
        "shortfall": joint.shortfall,
        "tolerances": {
            field: {"unit": study.unit(field), "after": limits_data(study, field, getattr(joint.tolerances, field))}
            | ({"price": -slope(study, found.joint, field)} if field in joint.costs else {})
            for field in study.fields
        },
        "sizes": _sizes(found),
        "joint": _point(study, found.joint),
        "two_step": _point(study, found.two_step),
        "fixed_in_the_first_step": found.fixed,
        "without_scaling_laws": _point(study, found.unscaled),
        "front": [_point(study, point) for point in found.front],
        "scaling_laws": [
            dict(name=law.name, numbers=followers, follows=law.follows, interval=law.interval, source=law.source)
            for law, followers in found.laws
        ],
        "certificate": joint.certificate,
    }


def _point(study: Study, point: Point | None) -> dict[str, object] | None:
    if point is None:
        return None
    found = point.found
    return {
        "status": found.status, "cost": found.cost, "tolerance_cost": point.of_tolerances(study),
        "priced_outputs": point.priced(study), "values": found.values, "half_widths": found.half_widths,
        "outputs_without_errors": point.outputs, "price_factor": point.factor,
    }  # fmt: skip


def figures(study: Study, found: Designed) -> Iterator[Figure]:
    """Draw the figures of a result.

    Args:
        study: with variables.
        found: result of the command.
    """
    if drawing := kind_of(study.design).drawing:
        yield Figure("section", drawing.comparison, lambda: drawing.compared(study.design, found.joint.design))
    if found.front:

        def place(point: Point) -> tuple[float, float]:
            return point.priced(study), point.of_tolerances(study)

        certified = [place(point) for point in found.front if point.certified]
        hollow = [place(point) for point in found.front if not point.certified]
        chosen, label = place(found.joint), ", ".join(name.replace("_", " ") for name in study.objective)
        before = sum(price(found.start[name]) for name, price in study.objective.items())
        meets = found.joint.found.start_cost >= found.joint.found.cost
        others = {_labelled("study, before", meets): (before, cost_of(study, study.tolerances))}
        if (first := found.two_step) is not None:
            others[_labelled("geometry first", first.found.feasible)] = place(first)
        yield Figure(
            "front",
            "Cost of the tolerances against the priced outputs, at the prices of the study",
            lambda: rvjax.plotting.trade_front(
                [*certified, chosen], uncertified=hollow, chosen=chosen, others=others, label=label
            ),
        )


def _labelled(name: str, meets: bool) -> str:
    """A point that costs less than the optimum, or is infeasible, misses a limit: its place shows no gain."""
    return name if meets else f"{name}, misses limits"
