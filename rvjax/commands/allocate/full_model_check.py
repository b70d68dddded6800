"""Units where a study does not look: the whole reducer, a whole turn of the output, and what is not limited.

A few hundred units are solved by the loaded model. What a loaded study does not limit is compared with usual limits.
One line has the share of units that meet the limits of a four-bar or lost-motion study on the whole reducer, or those
of a loaded study over a turn of the output where it follows a part of it; with the interval of Wilson.
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rvjax import models
from rvjax._jax.sizes import AT_ONCE
from rvjax.commands.cells import limit_text, share
from rvjax.errors import described
from rvjax.population import Estimate, Population, wilson
from rvjax.records import PyTree
from rvjax.render import Cell, Interval, Number, Quantity, Table, Text, Titled
from rvjax.response import parts
from rvjax.study import Response, Study
from rvjax.tolerances import Requirement, Statistics, monte_carlo

UNITS = 2 * AT_ONCE
CONFIDENCE = 0.95
ANGLES = {"samples": 24, "probe_angles": 4}
SEED = 5  # added to that of the study
TURN_ANGLES = 481
"""Most angles of a turn of the output. Against 1,921 angles 1.0 % of the largest pin pressure of an RV-40E and 1.4 % of
its transmission error are lost; with 961, in twice the time, 0.3 and 0.5 %."""


SHARE = 0.99
"""Of the units: what is not limited is listed at this share."""
TURNED = " over a turn of the output"


@dataclass(frozen=True)
class Unlimited:
    """An output of a loaded study that no requirement limits, next to its usual limit.

    Attributes:
        nominal: value of the unit without errors, SI; nan if it fails.
        reached: value that `SHARE` of the units keep, SI: a quantile of the side that has a limit.
        lower: usual limit, SI.
        upper: usual limit, SI.
        share: of the units within the usual limit; failed units are not.
        meaning: of the limit.
        units: solved ones.
        failed: those of them without a value.
    """

    nominal: float
    reached: Estimate
    lower: float
    upper: float
    share: Estimate
    meaning: str
    units: int
    failed: int

    @property
    def missed(self) -> bool:
        """True if less than `SHARE` of the units keep the usual limit."""
        return self.share.value < SHARE

    @property
    def limit(self) -> Requirement:
        """The usual limit."""
        return Requirement(lower=self.lower, upper=self.upper, target=SHARE)


def not_limited(study: Study) -> dict[str, Requirement]:
    """Usual limits of outputs that a loaded study does not limit, as far as its design and conditions allow them."""
    usual = models.kind(study.design).usual if study.costly else {}
    names = [name for name in usual if name not in study.requirements and study.allows(name)]
    ends = {name: limits for name in names if (limits := usual[name].limits(study.design))}
    return {name: Requirement(lower=low, upper=high, target=SHARE) for name, (low, high) in ends.items()}


@dataclass(frozen=True)
class Whole:
    """Units of a study on the whole reducer, or over a whole turn of its output.

    Attributes:
        share: of the units that meet all limits there.
        units: solved ones.
        within: {requirement: share of the solved units within its limit}.
        mean: {requirement: mean of the solved units, SI}.
        output: {requirement: output of the loaded model in its place}.
        failed: units that cannot be solved; they do not meet the limits.
        unread: errors with a tolerance that the loaded model does not read.
        angles: of a turn of the output; 0 where the study has its own.
        beyond: {requirement: distance from its limit that its target share of the units keeps, SI}, over a turn.
    """

    share: Estimate
    units: int
    within: Mapping[str, float]
    mean: Mapping[str, float]
    output: Mapping[str, str]
    failed: int
    unread: tuple[str, ...]
    angles: int = 0
    beyond: Mapping[str, float] = dataclasses.field(default_factory=dict)


def counterparts(study: Study) -> dict[str, str]:
    """Outputs of the whole reducer or turn, by requirement; empty where there is none or the design lacks parts."""
    if study.costly:
        spans = {n: span for n, span in study.spans.items() if study.requirements[n].limits_values}
        return {n: n for n, span in spans.items() if span != models.WHOLE or study.chooses_angles}
    design, outputs = study.design, models.kind(study.design).outputs
    found = {n: outputs[n].exact or n for n, item in study.requirements.items() if item.limits_values}
    lacks = any(getattr(design, part, None) is None for part in ("stiffness", "contact"))
    if lacks or not getattr(study.conditions, "output_torque", 0.0) or found == {n: n for n in found}:
        return {}
    return found


def whole_response(study: Study) -> Response | None:
    """Outputs of the whole reducer or turn, also those of a turn that are not limited; None where there are none."""
    outputs = counterparts(study)
    names = tuple(dict.fromkeys((*outputs.values(), *_joined(study, outputs))))
    return Response.of(study.design, names, _conditions(study, outputs)) if outputs else None


def _joined(study: Study, outputs: Mapping[str, str]) -> list[str]:
    """What is not limited and is read off the equilibria of the turn that are solved for other outputs."""
    few = models.kind(study.design).extremes(outputs) if study.costly else None
    along = set() if few is None else set(few.outputs)
    return [name for name in not_limited(study) if name in along] if along & set(outputs) else []


def _conditions(study: Study, outputs: Mapping[str, str]) -> PyTree:
    """Conditions of these outputs of the whole reducer, or of a turn at no more than `TURN_ANGLES` angles."""
    given = study.conditions
    if any(name != output for name, output in outputs.items()):
        rated = given.output_torque if given.rated_torque is None else given.rated_torque
        return dataclasses.replace(given, rated_torque=rated, **ANGLES)
    if study.spans[next(iter(outputs))] == models.WHOLE:  # at all angles
        return given
    turn = models.over_a_turn(study.design, given, next(iter(outputs)))
    return dataclasses.replace(turn, samples=min(turn.samples, TURN_ANGLES))


def check_units(study: Study, tolerances: object) -> tuple[Whole | None, dict[str, Unlimited]]:
    """Measure units of some tolerances on the whole reducer or turn, and what a loaded study does not limit.

    Args:
        study: with the design and the conditions.
        tolerances: of the units.
    """
    outputs, usual, turn = counterparts(study), not_limited(study), whole_response(study)
    joined = {name: usual.pop(name) for name in _joined(study, outputs)}
    whole, unlimited = None, dict[str, Unlimited]()
    if turn is not None:
        found = _measured(study, tolerances, turn, joined)
        whole, unlimited = _whole(study, tolerances, outputs, found), _unlimited(study, tolerances, turn, joined, found)
    if usual:
        alone = Response.of(study.design, tuple(usual), study.conditions)
        found = _measured(study, tolerances, alone, usual)
        unlimited |= _unlimited(study, tolerances, alone, usual, found)
    return whole, unlimited


def _measured(study: Study, tolerances: object, response: Response, limits: Mapping[str, Requirement]) -> Statistics:
    return monte_carlo(
        response, tolerances, samples=UNITS, seed=study.seed + SEED, chunk=UNITS, keep=True,
        requirements=limits or None, quantiles=(1 - SHARE, SHARE),
    )  # fmt: skip


def _unlimited(
    study: Study, tolerances: object, response: Response, limits: Mapping[str, Requirement], found: Statistics
) -> dict[str, Unlimited]:
    """Of the outputs with these usual limits: value without errors and statistics."""
    population = Population.of(tolerances)
    zero = np.zeros((sum(math.prod(tolerance.shape) for tolerance in population.active.values()), 1))
    own = [part for part in parts(response, population) if set(part.names) & set(limits)]
    nominal = {k: float(v) for p in own for k, v in zip(p.names, p.of_elements(population, zero)[0][:, 0])}
    return {
        name: Unlimited(
            nominal=nominal[name],
            reached=found.quantiles[SHARE if math.isfinite(limit.upper) else 1 - SHARE][name],
            lower=limit.lower,
            upper=limit.upper,
            share=found.yield_[name],
            meaning=models.kind(study.design).usual[name].meaning,
            units=found.samples,
            failed=found.failed,
        )
        for name, limit in limits.items()
    }


def _whole(study: Study, tolerances: object, outputs: Mapping[str, str], found: Statistics) -> Whole:
    """Of the outputs by requirement: units within the limits."""
    turned = all(name == output for name, output in outputs.items())
    assert found.values is not None
    values = {name: np.asarray(found.values[output]) for name, output in outputs.items()}
    margins = {name: np.asarray(study.requirements[name].margin(row)) for name, row in values.items()}
    solved = np.all([np.isfinite(row) for row in values.values()], axis=0)
    within = {name: solved & (row <= 0) for name, row in margins.items()}
    return Whole(
        share=wilson(int(np.all(list(within.values()), axis=0).sum()), UNITS, CONFIDENCE),
        units=UNITS,
        within={name: float(row.mean()) for name, row in within.items()},
        mean={name: float(row[solved].mean()) if solved.any() else math.nan for name, row in values.items()},
        output=outputs,
        failed=int((~solved).sum()),
        unread=tuple(name for name in Population.of(tolerances).active if name in described(tolerances, "bounds")),
        angles=_conditions(study, outputs).samples if turned else 0,
        beyond=_beyond(study, margins) if turned else {},
    )


def _beyond(study: Study, margins: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Distance beyond the limit of a share that this share of the units keeps, where chance does not explain it."""
    found = {}
    for name, row in margins.items():
        item = study.requirements[name]
        if isinstance(item, Requirement) and wilson(int((row <= 0).sum()), UNITS, CONFIDENCE).upper < item.target:
            row = np.where(np.isnan(row), np.inf, row)
            found[name] = float(np.quantile(row, item.target, method="higher"))
    return {name: margin for name, margin in found.items() if math.isfinite(margin)}


def whole_text(found: Whole, study: Study) -> str:
    """One line on the units of a study on the whole reducer, or over a turn of the output.

    Args:
        found: what was measured.
        study: with the limits.
    """
    said = []
    for name, output in found.output.items():
        mean = f", mean {study.output(name).text(found.mean[name], '.3g')}" if output != name else ""
        said.append(f"{output} {100 * found.within[name]:.3g} % within the limit{mean}{_moved(found, study, name)}")
    known = "errors without a tolerance" + "".join(f", {name} (it has no place)" for name in found.unread)
    failed = f"; {found.failed} failed" if found.failed else ""
    if found.angles:
        over = f"Over a turn of the output, at {found.angles:,} angles,"
        those = "all these limits" if len(found.output) > 1 else "this limit"
        told = f"{over} {share(found.share).text()} of the units meet {those}."
        return f"{told} Of {found.units} other units: {'; '.join(said)}{failed}."
    return (
        f"On the whole reducer {share(found.share).text()} of these units meet all limits. Of {found.units} solved "
        f"units: {'; '.join(said)}{failed}. Not included: {known}."
    )


def _moved(found: Whole, study: Study, name: str) -> str:
    """Text on the limit that a target share of the units keeps over a turn, and that of the span which would do."""
    limits, missing = study.requirements[name], found.beyond.get(name)
    if missing is None or not isinstance(limits, Requirement):
        return ""
    output, goal = study.output(name), f"{100 * limits.target:g} %"
    kept, needed = (
        limit_text(dataclasses.replace(limits, lower=limits.lower - by, upper=limits.upper + by), output)
        for by in (missing, -missing)
    )
    where = "at the chosen angles" if study.chooses_angles else f"over {study.spans[name]}"
    wanted = f"about {goal} keep {limit_text(limits, output)} over a turn"
    return f", {goal} {kept} (with a limit {needed} {where}, {wanted})"


def unlimited_texts(found: Mapping[str, Unlimited], study: Study) -> list[str]:
    """A line for each usual limit that less than `SHARE` of the units keep.

    Args:
        found: what was measured.
        study: that does not limit it.
    """
    along = _joined(study, counterparts(study)) if found else []
    return [
        f"Not limited: {name}. {100 * (1 - one.share.value):.3g} % of the units miss a usual limit"
        f"{TURNED if name in along else ''}, {limit_text(one.limit, study.output(name))} ({one.meaning})."
        for name, one in found.items()
        if one.missed
    ]


def unlimited_tables(found: Mapping[str, Unlimited], study: Study) -> list[Table]:
    """Outputs without a limit: value without errors and at `SHARE` of the units, next to a usual limit.

    Args:
        found: what was measured.
        study: that does not limit it.
    """
    rows: list[list[Cell]] = []
    for name, one in found.items():
        output = study.output(name)
        nominal = Quantity(one.nominal, output.unit, read_in=output.read_in)
        reached = Quantity.of(one.reached, output.unit, output.read_in)
        limit = limit_text(one.limit, output)
        rows.append([Titled(name, output.meaning), nominal, reached, limit, share(one.share), one.meaning])
    units = f"{100 * SHARE:g} % of the units"
    columns = [Text("not limited"), Number("without errors"), Interval(f"{units} [interval]", file_title=units)]
    columns += [Text("usual limit"), Interval("within it [interval]", file_title="within it"), Text("why", wraps=True)]
    if not rows:
        return []
    along = ", ".join(_joined(study, counterparts(study)))
    return [Table("not_limited", columns, rows, note=f"{along}:{TURNED}" if along else "")]
