"""Curves of units, total effects of errors on their harmonics, and tables of the influence of errors.

Units have one program for all commands and torques. For the effect of an error it is sampled again and the others are
kept (Jansen 1999).
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import QUICK
from rvjax._jax.sizes import AT_ONCE, PLOTTED, calls
from rvjax.base.words import choose
from rvjax.errors import STAGES, described
from rvjax.outputs import Curve, Output, torque_condition
from rvjax.population import Population
from rvjax.records import Design, Record, Scalar, field, record, text
from rvjax.render import CSV, EVERYWHERE, Column, Interval, Note, Quantity, Table, Text, number
from rvjax.response import UNITS, mesh_of, on, per_response
from rvjax.study import Study
from rvjax.tolerances import Influence
from rvjax.units import readable


@record
class _Drawn(Record):
    """errors -> angles and curve of one unit."""

    design: Design = field("-", "the reducer", kind="record")
    torque: Scalar | None = field("N m", "None: that of the conditions")
    conditions: object = text("how the reducer runs")
    condition: str = text("name of the torque")
    evaluate: Callable[..., tuple[jax.Array, jax.Array]] = text("of a model")

    def __call__(self, errors: object) -> tuple[jax.Array, jax.Array]:
        """Angles and values (n,)."""
        given = self.conditions
        if self.torque is not None:
            given = dataclasses.replace(given, **{self.condition: self.torque})  # type: ignore[type-var]
        angle, values = self.evaluate(self.design, errors, given)
        return jnp.asarray(angle), values


def curves_of(
    curve: Curve, design: Design, conditions: object, population: Population, z: np.ndarray, torque: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) and curves (units, n) of units with random numbers z (numbers, units).

    Args:
        curve: of a model.
        design: the reducer.
        conditions: how it runs.
        population: of the units.
        z: their random numbers.
        torque: other than that of the conditions, N m.
    """
    unit, count, found = _unit(curve, design, conditions, torque), z.shape[1], list[np.ndarray]()
    mesh = mesh_of(PLOTTED)
    for lanes in calls(count, PLOTTED):
        angles, values = _curves(unit, population, on(mesh, jnp.asarray(z[:, lanes])), mesh=mesh)
        found.append(np.asarray(values))
    return np.asarray(angles)[0], np.concatenate(found)[:count]


def _unit(curve: Curve, design: Design, conditions: object, torque: float | None) -> _Drawn:
    name = torque_condition(conditions)
    torque = getattr(conditions, name, None) if torque is None else torque
    if not torque:  # no effects of a load are traced
        return _Drawn(design, None, conditions, name, curve.evaluate)
    return _Drawn(design, float(torque), dataclasses.replace(conditions, **{name: 0.0}), name, curve.evaluate)  # type: ignore[type-var]


@per_response(options=QUICK, shared=UNITS)
def _curves(
    unit: Callable[..., tuple[jax.Array, jax.Array]], population: Population, z: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Angles and curves (units, n)."""
    return jax.vmap(lambda z: unit(population.errors(z)), in_axes=-1)(z)


FEWEST, MOST = 16, 2**16
LEVELS = ("field", "part", "stage")
Solve = Callable[[np.ndarray], np.ndarray]  # random numbers of units -> their waves
V = TypeVar("V", float, np.ndarray)


def of_load(
    solve: Solve, draw: Callable[..., np.ndarray], population: Population, samples: int, block: int = AT_ONCE
) -> dict[str, Any]:
    """Variances by error from units, of which each error is sampled again: fields of `Budget`, for one load.

    Args:
        solve: random numbers of units -> their waves (units, k); NaN of a failed unit.
        draw: (first unit, count=) -> random numbers.
        population: of the units.
        samples: number of units.
        block: units at once.

    Raises:
        ValueError: no unit can be solved.
    """
    one, other, changed = _solved(solve, draw, population, samples, block)
    good = np.isfinite(one).all(1) & np.isfinite(other).all(1)
    for values in changed.values():
        good &= np.isfinite(values).all(1)
    if not good.any():
        raise ValueError(f"none of {samples} units can be solved")
    one, other, count = one[good], other[good], int(good.sum())
    waves = squares(one.shape[1])
    moved = {field: values[good] - one for field, values in changed.items()}
    square = {field: 0.5 * waves * np.abs(values) ** 2 for field, values in moved.items()}
    mean = one.sum(0) / count
    total = waves * (np.abs(one - mean) ** 2).sum(0) / max(1, count - 1)
    rest = 0.25 * (waves * np.abs(other - one - sum(moved.values())) ** 2)[:, 1:].sum(1)
    whole = total[1:].sum()
    share, spread = (float(x / whole) if whole > 0 else 0.0 for x in (rest.sum() / count, rest.std() / np.sqrt(count)))
    return {
        "variance": {field: values.sum(0) / count for field, values in square.items()},
        "error": {field: float(v[:, 1:].sum(1).std() / np.sqrt(count)) for field, v in square.items()},
        "total": total,
        "together": (share, spread),
        "alike": waves * np.abs(mean) ** 2,
        "failed": int(samples - good.sum()),
    }


def squares(count: int) -> np.ndarray:
    """Mean squares (count,) of waves of amplitude 1; the first is a constant.

    Args:
        count: of the waves.
    """
    return np.where(np.arange(count) > 0, 0.5, 1.0)


def _solved(
    solve: Solve, draw: Callable[..., np.ndarray], population: Population, samples: int, block: int
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Waves (units, k) of units, of other units, and of the first with one error of the others, by that error."""
    block = min(block, samples)
    parts: list[list[np.ndarray]] = []
    for first in range(0, samples, block):
        own, new = (draw(first + start, count=block) for start in (0, samples))
        batches = [own, new, *(mixed for _, mixed in population.exchanged(own, new))]
        parts.append([solve(batch)[: samples - first] for batch in batches])
    one, another, *changed = (np.concatenate(values) for values in zip(*parts))
    return one, another, dict(zip(population.active, changed))


def parts_of(study: Study, population: Population) -> dict[str, str]:
    """Part of the reducer by error that varies; "" for an error of none."""
    part = described(study.design.error_record, "part")
    return {field: part.get(field, "") for field in population.active}


def by_level(level: str, variance: dict[str, V], part: dict[str, str]) -> dict[str, V]:
    """Variances of errors, or summed over those of a part or stage, the largest first without the mean of a curve.

    Args:
        level: "field", "part" or "stage".
        variance: by error; a number, or an array by order.
        part: of each error.

    Raises:
        ValueError: another level.
    """
    choose("level", level, LEVELS)
    sums: dict[str, V] = {}
    for error, values in variance.items():
        own = part[error] or "other"
        name = {"field": error, "part": own, "stage": STAGES.get(own, "other")}[level]
        sums[name] = sums[name] + values if name in sums else values
    return dict(
        sorted(sums.items(), key=lambda item: -float(np.sum(np.asarray(item[1])[1:] if np.ndim(item[1]) else item[1])))
    )


UNMOVED = "no slope"
UNMOVED_MEANS = (
    "no slope: raising and lowering the error act alike, or the model ignores it (share -); "
    "rms: slope of single units, root mean square."
)
SHARE_MEANS = "share: variance that the error causes, alone and with others [95 %]; scaled to sum to 100 %."
KNOWN = 5e-4  # half of the last digit of a share: no interval within it is shown


def influence_share(found: Influence, field: str) -> Quantity | None:
    """Share of an error in the variance, with its interval; None if the error does nothing.

    Args:
        found: influences on a response.
        field: name of the error.
    """
    one = found.shares[field]
    if one.value == 0 and found.scatter[field] == 0:
        return None
    if one.upper - one.lower < KNOWN:
        return Quantity(one.value, read_in="%", form=".1f")
    return Quantity.of(one, read_in="%", form=".1f")


def slope_text(found: Influence, field: str, study: Study, output: Output) -> str:
    """Mean slope of a response along an error, or that there is none.

    Args:
        found: influences on the response.
        field: name of the error.
        study: with both.
        output: what the response is.
    """
    unit, size = output.shown
    per = f"{unit}/{readable(study.unit(field))[0]}"
    sizes = {name: readable(study.unit(name))[1] / size for name in found.slopes}
    shown = [slope * sizes[name] for each in (found.slopes, found.scatter) for name, slope in each.items()]
    largest = max((slope for slope in shown if math.isfinite(slope) and slope > 0), default=1.0)
    decimals = min(4, max(0, 3 - math.floor(math.log10(largest))))  # fewer where the largest then has four digits
    mean, single = (each[field] * sizes[field] for each in (found.slopes, found.scatter))
    if mean:
        return f"{mean:.{decimals}f} {per}"
    said = f"{single:.{decimals}f}"
    return f"{UNMOVED} [rms {said} {per}]" if float(said) > 0 else UNMOVED


def together_text(influence: Mapping[str, Influence]) -> str:
    """A line on responses in which errors act together; "" if there are none.

    Args:
        influence: of the errors, by response.
    """
    sums = {name: found.total for name, found in influence.items() if found.total.lower > 1 + KNOWN}
    said = ", ".join(f"{name} {100 * total.value:.0f} %" for name, total in sums.items())
    return f"errors act together; before scaling the shares sum to: {said}." if said else ""


NOT_IN_FILE, IN_FILE = EVERYWHERE - {CSV}, frozenset({CSV})
MOST_ERRORS = 6  # of a response in text and page


def influence_tables(study: Study, influence: Mapping[str, Influence]) -> list[Table | Note]:
    """Mean slope of each response along each error and share of the variance, with its interval, after.

    In text and page a table for each response with the errors that cause most of it; in the file all of them.

    Args:
        study: with the errors.
        influence: of the errors, by response.
    """
    titles = ("error", "response", "slope", "unit of the slope", "share of variance")
    ends = ("share, lower end", "share, upper end", "slope of a unit, rms")
    rows = [_influence_row(study, influence[name], field, name) for field in study.fields for name in influence]
    means = Note("\n".join(filter(None, [UNMOVED_MEANS, SHARE_MEANS, together_text(influence)])))
    shown = (_influence_on(study, influence[name], name) for name in study.requirements)
    return [Table("influence", [Column(title) for title in (*titles, *ends)], rows, on=IN_FILE), *shown, means]


def _influence_row(study: Study, one: Influence, field: str, name: str) -> list[object]:
    """Numbers of an error and a response for the file."""
    (error_unit, error_size), (unit, size) = readable(study.unit(field)), study.output(name).shown
    mean, single = (each[field] * error_size / size or None for each in (one.slopes, one.scatter))
    known = one.shares[field]
    three = (known.value, known.lower, known.upper) if influence_share(one, field) else (None, None, None)
    return [field, name, number(mean), f"{unit}/{error_unit}", *map(number, three), number(single)]


def _influence_on(study: Study, one: Influence, name: str) -> Table:
    """The errors that cause most of a response, the largest share first, and what the others cause together."""
    acting = [field for field in study.fields if influence_share(one, field)]
    acting.sort(key=lambda field: -one.shares[field].value)
    listed = [field for field in acting[:MOST_ERRORS] if not one.shares[field].value < KNOWN]
    rows = [[f, influence_share(one, f), slope_text(one, f, study, study.output(name))] for f in listed]
    others, left = acting[len(listed) :], len(study.fields) - len(acting)
    rest = [f"{len(others)} more: {100 * sum(one.shares[field].value for field in others):.2g} %"] if others else []
    rest += [f"{left} without influence"] if left else []
    columns: list[Column] = [Text("error"), Interval("share [interval]"), Text(f"d {name} / d error", narrow=20)]
    note = f"{'; '.join(rest)} (influence.csv)" if rest else ""
    return Table("influence", columns, rows, f"Influence on {name}:", note, on=NOT_IN_FILE)
