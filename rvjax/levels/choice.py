"""Level of a model for a study: the cheapest that is measured to be accurate enough, and the time of its equilibria.

The run time of any study of the loaded reducer follows from the measured time of its equilibria.
"""

import dataclasses
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from importlib import resources
from typing import Any

import numpy as np

from rvjax import models
from rvjax.base.words import unknown
from rvjax.catalogue import walk
from rvjax.levels.table import Level, Model, Table, stored
from rvjax.outputs import Reading, Source, torque_of
from rvjax.population import Tolerance
from rvjax.records import Design, PyTree, Scalar, is_concrete
from rvjax.units import readable, with_unit


@dataclass(frozen=True)
class Choice:
    """Selected level of one output.

    Attributes:
        output: name.
        level: name of the level.
        settings: conditions that select it, as (name, value).
        precision: "float64" or "float32".
        bound: its error stays below this, SI; None for the exact level, and where nothing was measured.
        ns: measured nanoseconds per case, for comparison: measured on the computer of the table; None likewise.
        why: one line, with what the level does not model.
        instead: substitute output of another model, or None.
        without: physics that the exact level has and this one leaves out; "" for none.
    """

    output: str
    level: str
    settings: tuple[tuple[str, Any], ...]
    precision: str
    bound: float | None
    ns: float | None
    why: str
    instead: str | None = None
    without: str = ""


def choose(
    design: Design,
    outputs: Sequence[str],
    conditions: object,
    *,
    tolerances: object,
    accuracy: Mapping[str, float],
    table: Table | None = None,
) -> dict[str, Choice]:
    """The cheapest level of each output whose error stays below the required accuracy.

    The largest measured error, interpolated in the size of the errors, must meet it with a factor of two. A design,
    an error or a torque that was not measured takes the exact level. `accuracy` decides over the conditions that
    select a level (angles, closure, profile), and ignores their values; where nothing was measured, it takes
    no fewer angles than the conditions.

    Args:
        design: the reducer.
        outputs: required; outputs without an accuracy are computed by `conditions` and are not in the result.
        conditions: how the reducer runs.
        tolerances: of the units that are to come, the widest if they change; record with a `Tolerance` or None.
        accuracy: largest error allowed of each output, SI.
        table: measured levels; by default those that come with rvjax.

    Raises:
        ValueError: an accuracy that is not positive, or of an output that is not required.
    """
    for name, value in accuracy.items():
        if name not in outputs:
            raise unknown(f"accuracy of {name!r}: it is not required", name, outputs, "; required are")
        if not (is_concrete(value) and value > 0):
            raise ValueError(f"accuracy of {name!r} = {value!r}: must be a positive number")
    models = (table or stored()).models.values()
    wanted_of: dict[str, tuple[Model, str, list[str]]] = {}
    choices = {}
    for name in accuracy:
        if not (known := _known(models, name, conditions)):
            choices[name] = _unmeasured(name, ", accuracy ignored")
            continue
        model, reason = _model(known, design, conditions, tolerances)
        wanted_of.setdefault(model.name, (model, reason, []))[2].append(name)
    for model, reason, names in wanted_of.values():  # outputs of one model share a level: one solution serves them all
        size, problem = _size(model, tolerances)
        reason = reason or problem
        wanted = {name: accuracy[name] for name in names}
        level = model.level(model.reference) if reason else model.cheapest(wanted, size)
        exact = level.name == model.reference
        own = _differs(model, conditions)
        settings = tuple((key, value) for key, value in level.settings.items() if not (own and key in model.conditions))
        if reason:
            settings = tuple((key, _no_fewer(value, getattr(conditions, key))) for key, value in settings)
        for name in names:
            bound = None if exact else model.bound(level, name, size)
            if reason:
                why = f"outside the measured range ({reason}): exact level"
            elif exact:
                why = "no cheaper level is accurate enough"
            else:
                unit, unit_size = readable(model.outputs[name])
                limit = with_unit(wanted[name] / unit_size, unit, ".3g")
                why = f"cheapest of {len(model.levels)} levels with twice its measured error below {limit}"
            choices[name] = _choice(name, level, settings, bound, why)
    return {name: choices[name] for name in outputs if name in choices}


def as_given(design: Design, outputs: Sequence[str], conditions: object, *, tolerances: object) -> dict[str, Choice]:
    """Level that the conditions select for each output, with its measured error and time.

    Args:
        design: the reducer.
        outputs: required.
        conditions: how the reducer runs.
        tolerances: of the units; record with a `Tolerance` or None.
    """
    choices = {}
    models = stored().models.values()
    for name in outputs:
        choices[name] = _unmeasured(name)
        if not (known := _known(models, name, conditions)):
            continue
        model, reason = _model(known, design, conditions, tolerances)
        size, problem = _size(model, tolerances)
        reason = reason or problem
        for level in model.levels:
            settings = tuple(level.settings.items())
            if level.precision != "float64" or any(getattr(conditions, key) != value for key, value in settings):
                continue
            if level.instead or not math.isfinite(level.largest[name][0]):
                continue
            bound = None if reason or level.name == model.reference else model.bound(level, name, size)
            why = f"set in the study; its error here is not measured ({reason})" if reason else "set in the study"
            if bound == math.inf:
                bound, why = None, f"{why}; with larger errors it failed for a unit that the exact level solves"
            choices[name] = _choice(name, level, settings, bound, why)
    return choices


def _choice(output: str, level: Level, settings: tuple[tuple[str, Any], ...], bound: float | None, why: str) -> Choice:
    """A measured level of an output, with what it does not model; the exact level leaves out nothing."""
    why += f"; not modelled: {level.without}" if level.without else ""
    instead = level.instead.get(output)
    return Choice(output, level.name, settings, level.precision, bound, level.ns, why, instead, level.without)


def _no_fewer(value: PyTree, wanted_of: PyTree) -> object:
    """A count of the exact level, or that of the conditions where it is larger: more angles are never less exact."""
    counts = isinstance(value, int) and isinstance(wanted_of, int) and not isinstance(value, bool)
    return max(value, wanted_of) if counts else value


def _unmeasured(output: str, further: str = "") -> Choice:
    why = f"no level with these conditions was measured: computed as the conditions define{further}"
    return Choice(output, "as in the conditions", (), "float64", None, None, why)


def _differs(model: Model, conditions: object) -> list[str]:
    return [name for name, value in model.conditions.items() if not _same(getattr(conditions, name), value)]


def _same(given: object, measured: object) -> bool:
    """Equal; numbers of a table to the digits that the file of levels keeps."""
    if not isinstance(measured, tuple):
        return given == measured
    one, other = np.asarray(given, object), np.asarray(measured, object)
    return one.shape == other.shape and np.allclose(one.astype(float), other.astype(float), rtol=1e-4)


def _known(models: Iterable[Model], output: str, conditions: object) -> list[Model]:
    """Models with this output, measured with the conditions of the study; none of a reducer with other conditions."""
    return [
        model
        for model in models
        if output in model.outputs
        and all(hasattr(conditions, name) for name in model.conditions)
        and all(getattr(conditions, name) == value for name, value in model.question.items())
    ]


def _model(known: Sequence[Model], design: object, conditions: object, tolerances: object) -> tuple[Model, str]:
    """The model that fits the conditions and, of these, the errors; and why its measurements do not hold."""
    numbers = design_numbers(design)
    given = {*reach(tolerances), *numbers}

    def misfit(model: Model) -> tuple[int, int, int]:
        return len(_differs(model, conditions)), len(given.intersection(model.others)), len(model.errors)

    model = min(known, key=misfit)
    if different := _differs(model, conditions):
        return model, f"{different[0]} = {getattr(conditions, different[0])!r}"
    if beside := [name for name in model.others if name in given]:
        return model, f"{beside[0]}, which no case had"
    for name in model.design:  # those that the model reads
        value = numbers.get(name, math.nan)
        if not abs(value - model.design[name]) <= model.spread * abs(model.design[name]) * (1 + 1e-9):  # also NaN
            return model, f"{name} = {value:.4g}"
    for name, own in _overridden(design).items():
        if name not in model.design:  # it was measured as derived
            return model, f"{name} = {own}"
    if model.torque is not None:
        torque = torque_of(conditions)
        if not (is_concrete(torque) and model.torque[0] <= torque <= model.torque[1]):
            return model, f"torque = {torque} N m" if is_concrete(torque) else "a torque that is traced"
    return model, ""


def _overridden(design: PyTree) -> dict[str, Scalar]:
    """Numbers by path that differ from their derived value (`derived_NAME`) by more than rounding."""
    values: dict[str, Scalar] = {}
    for path, value, _ in walk(design):
        *parts, name = path.split(".")
        derived: PyTree = getattr(reduce(getattr, parts, design), f"derived_{name}", None)
        alike = is_concrete(value) and is_concrete(derived) and np.allclose(value, derived, rtol=1e-9, atol=0)
        if derived is not None and not alike:
            values[path] = value
    return values


def _size(model: Model, tolerances: object) -> tuple[float, str]:
    """Size of the errors in units of those measured, the largest of all fields; and why it was not measured."""
    # A field that is not in the table is one that the model does not read.
    shares = {name: value / model.errors[name] for name, value in reach(tolerances).items() if name in model.errors}
    name, size = max(shares.items(), key=lambda item: item[1], default=("errors", 0.0))
    if not model.sizes[0] <= size <= model.sizes[-1]:
        return size, f"{name} of {size:.3g} times those measured"
    return size, ""


def reach(tolerances: PyTree) -> dict[str, float]:
    """Reach of each error: |mean| + 3 standard deviations of every active field, SI.

    Args:
        tolerances: record with a `Tolerance`, a constant or None in each field.
    """
    largest = {}
    for f in dataclasses.fields(tolerances):
        value = getattr(tolerances, f.name)
        if isinstance(value, Tolerance):
            mean, variance, _, _ = value.moments()
            largest[f.name] = float(np.max(np.abs(mean) + 3 * np.sqrt(variance)))
        elif value is not None and np.any(value != 0):
            largest[f.name] = float(np.max(np.abs(value)))
    return largest


def design_numbers(design: PyTree) -> dict[str, float]:
    """Numbers of a design by path, with counts and elements of arrays; NaN for a traced number."""
    numbers: dict[str, float] = {}
    for path, value, _ in walk(design):
        if is_concrete(value) and np.ndim(value) == 1:
            numbers |= {f"{path}[{k}]": float(x) for k, x in enumerate(value)}
        else:
            numbers[path] = float(value) if is_concrete(value) and np.ndim(value) == 0 else math.nan
    return numbers


@cache
def equilibrium_times() -> dict[str, Any]:
    """Times of `equilibria.toml`: microseconds by kind of reducer, use and contact law, and the computer."""
    return tomllib.loads((resources.files("rvjax.levels") / "equilibria.toml").read_text("utf-8"))


def sources_of(design: object, output: str) -> tuple[Source, ...]:
    """Results that an output reads, if the number of equilibria of each is known, else none.

    Args:
        design: the reducer.
        output: name.
    """
    kind = models.kind(design)
    evaluate = kind.outputs[output].evaluate
    sources = evaluate.sources if isinstance(evaluate, Reading) else ()
    return sources if all(source in kind.work for source in sources) else ()


def seconds(design: PyTree, results: Iterable[tuple[Source, Any]]) -> float | None:
    """Seconds of a unit on the cores of the measurement, None for a kind of equilibrium that was not measured.

    Time is in proportion to the pins of all discs, output pins among them.

    Args:
        design: the reducer.
        results: each with the conditions under which it is computed.
    """
    kind, table, total = models.kind(design), equilibrium_times().get(design.kind, {}), 0.0
    for source, given in results:
        name, count = kind.work[source](given)
        each = table.get(name, {}).get(given.pin_contact)
        if each is None:
            return None
        total += 1e-6 * each * count * contacts(design) / table["contacts"]
    return total / equilibrium_times()["measured_on"]["cores"]


def contacts(design: Design) -> int:
    """Pins and output pins that touch the discs, counted for each disc.

    Args:
        design: counts are read.
    """
    counts = design.counts
    return int(counts["discs"] * (counts["pins"] + counts.get("output_pins", 0)))
