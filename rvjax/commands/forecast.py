"""Forecast of a computation: warnings, levels, seconds of a unit; phases, units and seconds of an allocation."""

import dataclasses
import sys
from collections.abc import Callable, Mapping
from typing import Any

from rvjax import levels, study as studies
from rvjax.base.progress import spelled
from rvjax.commands import say, share_cores
from rvjax.commands.cells import against_limit
from rvjax.levels import Choice
from rvjax.population import grows_from_lower
from rvjax.response import BLOCK, Response, is_costly
from rvjax.status import MEANING, SUCCESS, Status
from rvjax.study import Study, scalars
from rvjax.tolerances import COSTLY_UNITS, KEPT, QUICK, units_of


def choices(study: Study) -> dict[str, Choice]:
    """Level of each response: selected by its accuracy, else by the conditions."""
    outputs = tuple(study.requirements)
    given = levels.as_given(study.design, outputs, study.conditions, tolerances=study.tolerances)
    return given | study.choices()


def level_lines(study: Study) -> list[str]:
    """A line for each level of the responses: their names, its error, and why."""
    lines = dict[str, list[str]]()
    for name, choice in choices(study).items():
        error = "" if choice.bound is None else f"error < {study.output(name).text(choice.bound, '.2g')}; "
        lines.setdefault(f"{choice.level} ({error}{choice.why})", []).append(name)
    return [f"{', '.join(names)}: {line}" for line, names in lines.items()]


def unit_seconds(study: Study) -> float | None:
    """Time of one unit on two cores, or None where a level was never measured."""
    found, results = 0.0, dict[tuple[Any, Any], None]()  # several outputs read one result
    for name, choice in choices(study).items():
        if sources := levels.sources_of(study.design, choice.instead or name):
            given = dataclasses.replace(study.conditions, **dict(choice.settings))
            results |= dict.fromkeys((source, given) for source in sources)
        elif choice.ns is None:
            return None
        else:
            found += 1e-9 * choice.ns
    solved = levels.seconds(study.design, results)
    return None if solved is None else found + solved


def warned(line: str) -> None:
    """Print a warning.

    Args:
        line: without the word.
    """
    say(f"rvjax: warning: {line}", file=sys.stderr)


def forewarn(study: Study, time: str = "") -> None:
    """Print warnings on input values, and the level of each response with an accuracy, before any work.

    Args:
        study: as read.
        time: expected time of the command, shown next to the levels; "" for none.
    """
    for line in study.doubts:
        warned(line)
    if study.accuracy:
        for line in filter(None, [*level_lines(study), time]):
            say(f"rvjax: {line}", file=sys.stderr)


def doubts_of_unit(study: Study, values: Mapping[str, float], status: Status) -> list[str]:
    """Warnings of the unit at the mid-points: it cannot be solved, or a line for each limit that it does not meet.

    Finer tolerances lead to this unit, unless mid-points or numbers of the design move. Statistics, and limits that
    half of the units may miss, have no such line.

    Args:
        study: with the limits.
        values: of the unit, SI.
        status: of the unit.
    """
    if status not in SUCCESS:
        return [f"the unit at the mid-points cannot be solved: {status.name} ({MEANING[status]})"]
    return list(missed_at_mid_points(study, values).values())


def missed_at_mid_points(study: Study, values: Mapping[str, float]) -> dict[str, str]:
    """Lines of `doubts_of_unit` on limits, by response.

    Args:
        study: with the limits.
        values: of the unit, SI.
    """
    moves = ["mid-points"] if study.middles or any(map(grows_from_lower, scalars(study.tolerances).values())) else []
    moves += ["numbers of the design"] if study.variables else []
    unless = f" unless {' or '.join(moves)} move" if moves else ""
    lines = {}
    for name, limits in study.requirements.items():
        if limits.limits_values and getattr(limits, "target", 1.0) > 0.5 and limits.margin(values[name]) > 0:
            shown_value = against_limit(values[name], limits, study.output(name))
            lines[name] = f"{name}: {shown_value}, at the mid-points: no tolerance can meet this{unless}"
    return lines


SEARCHING, CERTIFYING = "cheapest tolerances", "yield before"  # phases of a run
SAMPLING, PRICING = "sample units", "cost against yield"
ALLOCATING = (SEARCHING, CERTIFYING, SAMPLING, PRICING)
SHOWN_VALUES = KEPT  # units behind a histogram: those of the certificate where it has no more
FEWEST_BEYOND = 8  # units of the learning sample beyond a limit, below which a point of the cost curve is left out
YIELD_SWEEP = (0.9, 0.95, 0.99, 0.995, 0.999)

# Counted in results of rv-40e, with moving mid-points and half-widths rounded to grades; of costly units in those of an
# RV-20E with a moving mid-point and of rv-40e-whole.
PASSES = 60  # of a search and its cost curve over its sample: 30 to 90
CERTIFICATES = {True: 6, False: 4}  # with a mid-point: 3 of a million units, 12 of 8,000
PASSES_A_POINT = 6  # of the cost curve
COSTLY_PASSES, COSTLY_CERTIFICATES, COSTLY_POINT = {True: 7, False: 3}, 3, 5000

_BEFORE = 4096  # costly units of the given tolerances, at most


@dataclasses.dataclass(frozen=True)
class Effort:
    """Extent of the computations of commands, for units of some time.

    Attributes:
        units: (study) -> units that an allocation solves, by phase; of `SAMPLING` those of influences.
        compiling: time of tracing and compilation, in words.
        shared: whether all cores, or another device, share the units.
        before: units of the given tolerances, at most; None: those of the certificate.
        sliders: whether a page has them without an option.
        surrogate: units of the surrogate behind them, some of which are compared; None: usual ones, and fresh units.
        front: usual points of a trade front.
        plan: responses at most to plan an assembly, as `assembly.plan` names them.
    """

    units: Callable[[Study], dict[str, float]]
    compiling: str
    shared: bool = False
    before: int | None = None
    sliders: bool = True
    surrogate: int | None = None
    front: int = 4
    plan: Mapping[str, int] = dataclasses.field(default_factory=dict)


def _quick_units(study: Study) -> dict[str, float]:
    drawn = study.certificate_samples
    return {
        SEARCHING: PASSES * QUICK + CERTIFICATES[bool(study.middles)] * units_of(study.requirements, drawn),
        CERTIFYING: drawn,
        SAMPLING: 0,
        PRICING: len(targets(study)) * (PASSES_A_POINT * study.samples + shown_values(study)),
    }


def _costly_units(study: Study) -> dict[str, float]:
    return {
        SEARCHING: COSTLY_PASSES[bool(study.middles)] * study.samples + COSTLY_CERTIFICATES * study.certificate_samples,
        CERTIFYING: min(study.certificate_samples, _BEFORE),
        SAMPLING: COSTLY_UNITS * (1 + len(study.fields)),
        PRICING: len(targets(study)) * COSTLY_POINT,
    }


OF_QUICK = Effort(_quick_units, "20 s for an RV-40E, 45 s")
"""Of units that take microseconds."""

OF_COSTLY = Effort(
    _costly_units, "30 s for a loaded RV-40E, 60 s", shared=True, before=_BEFORE, sliders=False, surrogate=768, front=0,
    plan={"most_valued": 2**18, "most_fresh": 2**14},
)  # fmt: skip
"""Of units that take a millisecond. A surrogate takes three calls of the gradients' program."""


def effort_of(computed: Study | Response) -> Effort:
    """Extent of the computations for a study, or for a response."""
    return OF_COSTLY if is_costly(computed) else OF_QUICK


def read_study(source: str) -> Study:
    """The study of a command, without solving a unit; each core becomes a device if its units are costly.

    Args:
        source: path, or name of an embedded study.
    """
    found = studies.load(source, solve=False)
    if effort_of(found).shared:
        share_cores(1)
    return found


def solved_units(study: Study) -> dict[str, int]:
    """Estimate the number of solved units in each phase of a run, in their order."""
    found = effort_of(study).units(study)
    found[SAMPLING] += 2 * SHOWN_VALUES if study.certificate_samples > KEPT else 0
    return {phase: int(units) for phase, units in found.items()}


def targets(study: Study) -> list[float]:
    """Target yields of the points of the cost curve; none if no requirement has a target."""
    if all(requirement.goal != "target" for requirement in study.requirements.values()):
        return []
    return [target for target in YIELD_SWEEP if study.samples * (1 - target) >= FEWEST_BEYOND]


def shown_values(study: Study) -> int:
    """Units behind a histogram."""
    return min(SHOWN_VALUES, study.certificate_samples)


def seconds_of_units(study: Study) -> float | None:
    """Seconds of two cores that the units of an allocation take, if devices share them; else 0, None if unknown."""
    unit = unit_seconds(study) if effort_of(study).shared else 0.0
    return unit and unit * sum(solved_units(study).values())


def expected(study: Study) -> str:
    """Time and memory of an allocation, from the measured time of a unit, in words."""
    unit = unit_seconds(study)
    if unit is None:
        return "time: unknown, these levels are not measured"
    return (
        f"time: about {spelled(unit * sum(solved_units(study).values()))} of computation on the two cores of the "
        f"measured table, besides tracing and compilation ({effort_of(study).compiling} at the first run); "
        f"chunks of {BLOCK:,} units, memory does not grow with their number"
    )
