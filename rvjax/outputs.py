"""Description of a model, declared in its `outputs.py`: studies and reports use it and import no model.

A model lists its conditions, its outputs (one number of one unit each), the curve a person looks at, and the cases and
ways by which its levels are measured. `rvjax.models` collects what there is for one kind of design.
"""

import dataclasses
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rvjax.records import Design, PyTree
from rvjax.units import KNOWN, arcsec, readable, with_unit

Solved = tuple[Any, Any]  # value and status
Spectrum = tuple[Any, Any]  # mean and complex amplitudes of a curve
Source = Callable[..., Any]  # (design, errors, conditions) -> a result
Work = Callable[[Any], tuple[str, int]]  # (conditions) -> kind and number of the equilibria of a result


KNOWN_ERROR = 10 * arcsec
"""Transmission error and lost motion of the most accurate known reducers; assumed: makers promise 50 arcsec or more."""


def torque_condition(conditions: PyTree) -> str:
    """Name of the condition that is the torque; "" for conditions without a torque."""
    return next((f.name for f in dataclasses.fields(conditions) if f.metadata["torque"]), "")


def torque_of(conditions: object) -> Any:
    """Torque of the conditions, N m; 0 for conditions without a torque, None if it is not given."""
    name = torque_condition(conditions)
    return getattr(conditions, name) if name else 0.0


def condition(
    default: object,
    meaning: str,
    *,
    unit: str | None = None,
    choices: Sequence[str] | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
    torque: bool = False,
    columns: Mapping[str, str] | None = None,
) -> Any:
    """Declare a condition under which a unit is evaluated: a quantity, one of several words, a count, or a table.

    Args:
        default: None for one that only some outputs need.
        meaning: one line.
        unit: SI unit of a quantity, "-" for none.
        choices: words, of which one is given.
        minimum: least value; a condition with neither unit nor choices is a count and needs it.
        maximum: largest value; of a count too, beyond which a program neither compiles in time nor fits into memory.
        torque: the load whose measured range decides whether a measured level holds.
        columns: SI unit of each column of a table, which a study gives as tables of the condition's name; the value
            is a tuple of rows.

    Raises:
        ValueError: a condition that no study file could give.
    """
    for name in (unit, *(columns or {}).values()):
        if name is not None and name != "-" and name not in KNOWN:
            raise ValueError(f"condition {meaning!r}: unit {name!r} is none of {', '.join(KNOWN)}")
    if unit is None and choices is None and columns is None and (minimum is None or maximum is None):
        raise ValueError(f"condition {meaning!r}: needs a unit, choices, or a minimum and a maximum for a count")
    about = dict(
        meaning=meaning, unit=unit, choices=choices, minimum=minimum, maximum=maximum, torque=torque, columns=columns
    )
    return dataclasses.field(default=default, metadata=about)


@dataclass(frozen=True)
class Reading:
    """An `evaluate` that reads results which other outputs may read too: a question computes each of them once.

    Attributes:
        sources: what is computed, as named functions: outputs that share a result name the same function.
        take: (*results, design, conditions) -> (value, status).
        chosen: (conditions) -> the sources that are read under these conditions; None: all.
    """

    sources: tuple[Source, ...]
    take: Callable[..., Solved]
    chosen: Callable[[Any], tuple[Source, ...]] | None = None

    def read(self, given: object) -> tuple[Source, ...]:
        """Sources that are read.

        Args:
            given: conditions.
        """
        return self.sources if self.chosen is None else self.chosen(given)

    def __call__(self, design: Design, errors: object, given: object) -> Solved:
        """The output without the results that it shares."""
        return self.within({}, design, errors, given)

    def within(self, found: dict[Source, object], design: Design, errors: object, given: object) -> Solved:
        """The output among others of the same question.

        Args:
            found: results so far of this design, these errors and conditions; new ones are put here.
            design: the reducer.
            errors: of its parts.
            given: conditions.
        """
        sources = self.read(given)
        for source in sources:
            if source not in found:
                found[source] = source(design, errors, given)
        return self.take(*(found[source] for source in sources), design, given)


def number_of(name: str) -> Callable[..., Solved]:
    """`take` of a `Reading` of one result: a number of it by name, and its status.

    Args:
        name: field of the result.
    """
    both: Callable[..., Solved] = operator.attrgetter(name, "info.status")
    return lambda result, design, conditions: both(result)


@dataclass(frozen=True)
class Joint:
    """One computation of several results, in the place of one for each where a question needs them all.

    Attributes:
        sources: of the results.
        evaluate: (design, errors, conditions) -> the results, in the order of the sources.
    """

    sources: tuple[Source, ...]
    evaluate: Callable[[Any, Any, Any], tuple[Any, ...]]


@dataclass(frozen=True)
class Output:
    """One scalar of one unit.

    Attributes:
        unit: SI unit.
        meaning: one line.
        evaluate: (design, errors, conditions) -> (value, status); a `Reading` shares what it computes.
        needs: conditions without a default that it needs, by name.
        read_in: unit in which a person reads it; by default that of `rvjax.units`.
        below_zero: what a negative value of a real unit means, where it is no ordinary one.
        rejects: verb for units with a negative value, such as "jam".
        refuse: (design, conditions) -> None; raises ValueError, one line that names the key, where these conditions
            cannot give it.
        exact: output of a costlier model that is the same quantity of the whole reducer, or None.
        least: smallest value of known reducers, SI; a study is warned of a limit far below it. 0 for none.
    """

    unit: str
    meaning: str
    evaluate: Callable[[Any, Any, Any], Solved]
    needs: tuple[str, ...] = ()
    read_in: str | None = None
    below_zero: str = ""
    rejects: str = ""
    refuse: Callable[[Any, Any], None] | None = None
    exact: str | None = None
    least: float = 0.0

    @property
    def shown(self) -> tuple[str, float]:
        """Name and SI size of the unit in which a person reads it."""
        return readable(self.unit, self.read_in)

    def text(self, value: float, form: str = ".4g") -> str:
        """A value in the unit in which a person reads it.

        Args:
            value: SI.
            form: format of the number.
        """
        unit, size = self.shown
        return with_unit(value / size, unit, form)


@dataclass(frozen=True)
class Usual:
    """Usual limit of an output: a study that does not limit the output is compared with it.

    Attributes:
        limits: design -> (lower, upper) limit, SI, infinite where there is none; None where the design lacks parts.
        meaning: where the limit comes from, one line.
    """

    limits: Callable[[Any], tuple[float, float] | None]
    meaning: str


@dataclass(frozen=True)
class Curve:
    """Curve over one cycle of one unit, for plots.

    Attributes:
        title: of a plot.
        unit: SI unit of the values.
        evaluate: (design, errors, conditions) -> (angle in rad (n,), values (n,)).
        turns: (design, conditions) -> turns of the output in the cycle, by which its orders are counted; None where
            they mean nothing.
        source: a result that outputs read too, and what of it are the values; None where there is none.
        angles: (conditions) -> angle in rad (n,), where there is a source.
        outputs: values of the curve; their error budget is that of the curve. Empty: all outputs of the model.
    """

    title: str
    unit: str
    evaluate: Callable[[Any, Any, Any], tuple[Any, Any]]
    turns: Callable[[Any, Any], float] | None = None
    source: tuple[Source, Callable[[Any], Any]] | None = None
    angles: Callable[[Any], Any] | None = None
    outputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Extremes:
    """Extremes of curves along a span, found at few of its angles: a study chooses them for each unit.

    Attributes:
        source: result that is read; it takes angles (m,) after the conditions.
        outputs: that read nothing but extremes of it, each with the number of its curve, None for one without.
        angles: (design, conditions) -> all angles of the span, (n,) rad.
        curves: (design, errors, conditions, angle) -> numbers (c,), whose curves have the extremes: of the first one
            the lowest and highest places count, of others the highest.
        solved: (conditions) -> angles that are solved in each unit, None for all.
    """

    source: Source
    outputs: Mapping[str, int | None]
    angles: Callable[[Any, Any], Any]
    curves: Callable[[Any, Any, Any, Any], Any]
    solved: Callable[[Any], int | None]


def _once(_: object) -> int:
    """One period in a turn of the output."""
    return 1


@dataclass(frozen=True)
class Observation:
    """Observation of a model on a bench, as `[identify]` of a study compares it with data.

    Attributes:
        kind: of data, a key of `rvjax.measured.KINDS`.
        predict: measurement of one unit; arguments and value by kind:
            "curve": (design, errors, conditions, torques (t,) N m or None for no load, orders of the output turn,
            whether one turn of the cranks is like the next, where there are parts the part) -> (mean (t,), complex
            amplitudes (t, orders)), rad;
            "loop": (design, errors, conditions, torques (n,) N m) -> angle (n,) rad;
            "frequencies": (design, errors, conditions) -> (frequency (n,) Hz ascending, shapes (n, n) in columns).
        needs: optional parts of the design that it needs.
        samples: of a curve, the condition with the number of angles in a period.
        period: of a curve, (design) -> its periods in a turn of the output while all of them are alike.
        sided: without load its value depends on the side of the backlash.
        head: of a curve, (design, conditions, torques, orders) -> effect of an encoder head per element of the nuisance
            "reading", (torques, orders, 6, 2) rad; None without such a nuisance.
        parts: of a curve, (design, conditions, orders, alike) -> into how many parts its angles divide, each of which
            `predict` evaluates with part = (its number, their count); their mean is the curve. None: it does not.
        compiler_options: of programs that compute it, such as `rvjax._jax.programs.QUICK`.
    """

    kind: str
    predict: Callable[..., Any]
    needs: tuple[str, ...] = ()
    samples: str = ""
    period: Callable[[Any], int] = _once
    sided: bool = False
    head: Callable[..., Any] | None = None
    parts: Callable[[Any, Any, tuple[int, ...], bool], int] | None = None
    compiler_options: tuple[tuple[str, bool | int], ...] = ()


@dataclass(frozen=True)
class Way:
    """One level before it is measured.

    Attributes:
        name: for a person; its precision is added.
        settings: conditions that select it.
        precisions: in which it is measured.
        instead: substitute output of another model, by the replaced output; other outputs have no value here.
        without: physics that the reference has and this leaves out, for a person.
    """

    name: str
    settings: Mapping[str, Any]
    precisions: tuple[str, ...] = ("float64", "float32")
    instead: Mapping[str, str] = dataclasses.field(default_factory=dict)
    without: str = ""


@dataclass(frozen=True)
class Cases:
    """Random units on which the levels of some outputs are measured.

    Attributes:
        name: in the table of levels.
        case: what one case is, for a person.
        outputs: units by name; those of the model where `evaluate` is None.
        design: nominal; designs are sampled around it.
        errors: of the sampled errors, by field: (lower, upper) limits, normal with 3 sigma at the limits, or
            the arguments of a `Tolerance` by name; None where the outputs have none.
        conditions: of every case, by name.
        torque: smallest and largest, N m; None where it does not matter.
        ways: the levels; the last one, in float64, is the reference.
        batch: cases in one call.
        calls: of each error size.
        sizes: factors on the errors, ascending.
        evaluate: (settings, design, errors, extra) -> (values of all outputs, status), where a level is no output of
            the model.
        extra: (rng, cases, size) -> what a case has besides design and errors, for `evaluate`.
        question: further conditions of every case; with others it is another question, of which nothing is known.
        others: errors, and paths of numbers of the design, that some level reads and no case has: with one of them
            nothing is known either.
        bounds: errors without a place that follow from those with one, see `RVErrors.bounded`.
        timed: units of one design in one call, as studies solve them, where those take much less time; 0: the batch.
    """

    name: str
    case: str
    outputs: Mapping[str, str]
    design: Any
    errors: Mapping[str, tuple[float, float] | Mapping[str, Any]] | None
    conditions: Mapping[str, Any]
    torque: tuple[float, float] | None
    ways: tuple[Way, ...]
    batch: int
    calls: int
    sizes: tuple[float, ...] = (0.3, 1.0, 3.0)
    evaluate: Callable[..., Any] | None = None
    extra: Callable[..., Any] | None = None
    question: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    others: tuple[str, ...] = ()
    bounds: tuple[str, ...] = ()
    timed: int = 0


@dataclass(frozen=True, eq=False)
class Description:
    """A model as studies see it.

    Attributes:
        name: of the model, as `rvjax.errors.deviation` names it in `read_by`.
        design: class of the designs that it takes, or several of them.
        conditions: frozen dataclass whose fields are made by `condition`.
        outputs: by name.
        curve: to look at, or None.
        cases: quick -> cases by which levels are measured, fewer in a quick run; None where none are.
        unknown: what the model leaves out, one line for a person who reads its results.
        observations: what a bench can measure of it.
        compiler_options: of programs that compute an output of it, such as `rvjax._jax.programs.QUICK`.
        parts: optional parts of a design that no other model reads.
        joints: results, its own and those of models above it, that are cheaper computed together.
        usual: usual limits by output, also those of outputs of models above it.
        work: equilibria that a result of it takes; their measured times are in `rvjax.levels`.
        quick: outputs of a model with such work that take none, but microseconds.
        extremes: results of which a unit needs few angles, or None.
    """

    name: str
    design: type | tuple[type, ...]
    conditions: type
    outputs: Mapping[str, Output]
    curve: Curve | None = None
    cases: Callable[[bool], Sequence[Cases]] | None = None
    unknown: str = ""
    observations: tuple[Observation, ...] = ()
    compiler_options: tuple[tuple[str, bool | int], ...] = ()
    parts: tuple[str, ...] = ()
    joints: tuple[Joint, ...] = ()
    usual: Mapping[str, Usual] = dataclasses.field(default_factory=dict)
    work: Mapping[Source, Work] = dataclasses.field(default_factory=dict)
    quick: tuple[str, ...] = ()
    extremes: Extremes | None = None

    @property
    def designs(self) -> tuple[type, ...]:
        """Classes of the designs that it takes."""
        return self.design if isinstance(self.design, tuple) else (self.design,)
