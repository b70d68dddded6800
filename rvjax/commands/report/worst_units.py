"""Worst units of a sample: numbers, responses and the errors that cause them."""

from dataclasses import dataclass

import numpy as np

from rvjax._jax.sizes import PULLED, padded
from rvjax.commands.allocate import Answer
from rvjax.outputs import Output
from rvjax.population import Population, root_key
from rvjax.response import elements, numbers_of
from rvjax.status import MEANING, Status
from rvjax.tolerances import Limits
from rvjax.units import readable, with_unit

EACH = 2  # worst units of a requirement
SHARE_SHOWN = 0.01  # of the variance: errors below it are not listed for a worst unit


@dataclass(frozen=True)
class WorstUnit:
    """One unit with the allocated tolerances.

    Attributes:
        index: number of the unit; `tolerances.sample` with the seed of the sample replays it.
        requirement: that it is worst in, or "" for a unit that failed.
        status: name of its status.
        values: {response: value}, SI; nan where it failed.
        errors: {field: value of every element}, SI.
    """

    index: int
    requirement: str
    status: str
    values: dict[str, float]
    errors: dict[str, np.ndarray]


def worst_units(answer: Answer) -> list[WorstUnit]:
    """First failed unit of each status, then the worst units of each requirement, in the sample of the histograms."""
    study, side = answer.study, answer.after
    found = [(index, "", status) for status, index in side.failed.items()]
    for name, requirement in study.requirements.items():
        if not requirement.of_units:
            continue
        margin = np.asarray(requirement.margin(side.values[name]))
        order = np.argsort(np.where(np.isfinite(margin), margin, -np.inf))[::-1]
        found += [(int(index), name, "CONVERGED") for index in order[:EACH] if np.isfinite(margin[index])]
    if not found:
        return []
    population = Population.of(side.tolerances)
    indices = np.array([index for index, _, _ in found])
    z = numbers_of(population, root_key(side.seed), padded(indices, PULLED))
    drawn = [population.constants | population.by_field(unit) for unit in np.asarray(elements(population, z)).T]
    return [
        WorstUnit(
            index=index,
            requirement=name,
            status=status,
            values={other: float(side.values[other][index]) for other in study.requirements},
            errors={f: np.ravel(drawn[k].get(f, 0.0)) for f in study.fields},
        )
        for k, (index, name, status) in enumerate(found)
    ]


def rows_of(answer: Answer, unit: WorstUnit) -> dict[str, object]:
    """Title, responses, and the place of every error in its tolerance; of a vector, that of its length.

    Args:
        answer: of a study.
        unit: one of its worst.
    """
    study, side = answer.study, answer.after
    if unit.requirement:
        shares = side.shares[unit.requirement]
        fields = sorted((f for f in study.fields if shares[f] >= SHARE_SHOWN), key=lambda f: -shares[f])
        requirement, output = study.requirements[unit.requirement], study.output(unit.requirement)
        place = against_limit(unit.values[unit.requirement], requirement, output)
        title, reason = f"Unit {unit.index:,}: {unit.requirement.replace('_', ' ')} {place}", f"status {unit.status}"
    else:
        fields, title = study.fields, f"Unit {unit.index:,} failed"
        reason = f"status {unit.status}: {MEANING[Status[unit.status]]}"
    responses = "; ".join(
        f"{name.replace('_', ' ')} {with_unit(value / size, shown) if np.isfinite(value) else '-'}"
        for name, value in unit.values.items()
        for shown, size in [study.output(name).shown]
    )
    rows = []
    for field in fields:
        tolerance, values = getattr(side.tolerances, field), unit.errors[field]
        if tolerance.is_vector:  # its tolerance limits the length
            values = np.hypot(*values.reshape(-1, 2).T)
        middle, half = float(tolerance.middle), float(tolerance.half_width)
        shown, size = readable(study.unit(field))
        places = (values - middle) / half if half > 0 else np.zeros_like(values)
        largest = with_unit(values[int(np.argmax(np.abs(places)))] / size, shown, "+.2f")
        rows.append({"name": field, "places": [float(x) for x in places], "value": largest})
    return {"title": title, "said": f"{responses}; {reason}", "rows": rows}


def against_limit(value: float, requirement: Limits, output: Output) -> str:
    """A value and its nearer limit, such as "4,780 h, below 6000 h".

    Args:
        value: SI.
        requirement: with limits of the value.
        output: what the value is.
    """
    unit, size = output.shown
    beyond = {"below": requirement.lower - value, "above": value - requirement.upper}
    side = max(beyond, key=lambda name: beyond[name])
    limit = with_unit((requirement.lower if side == "below" else requirement.upper) / size, unit)
    return f"{with_unit(value / size, unit, ',.4g')}, {side if beyond[side] > 0 else 'limit'} {limit}"
