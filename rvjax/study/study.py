"""A study: design, conditions, tolerances, costs and requirements."""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from rvjax import models
from rvjax.base.words import unknown
from rvjax.catalogue import accept, fields_of
from rvjax.levels import Choice, choose
from rvjax.outputs import Curve, Output
from rvjax.population import Population
from rvjax.records import PyTree, Record, Scalar
from rvjax.status import Status, worst
from rvjax.study.chosen_angles import Expected, learned, takes_few
from rvjax.study.design import (
    Number,
    comments,
    design_numbers,
    doubtful_costs,
    doubtful_limits,
    doubts,
    given_paths,
    is_assumed,
)
from rvjax.study.goals import Price
from rvjax.study.identification import Identification
from rvjax.study.kinds import changed, kind_of
from rvjax.study.response import DesignResponse, Response, followed_bounds, outcome_of, refuse
from rvjax.study.tolerances import Form, by_error, forms, metadata, mid_points
from rvjax.study.values import (
    About,
    StudyError as StudyError,  # other modules take it from here
    is_initial,
    naming,
    tables_of,
)
from rvjax.tolerances import Cost, Limits, Middle, Nominal, QuadraticLoss, Variable


@dataclass(frozen=True)
class Study:
    """A study of one design.

    Attributes:
        name: short name, from the file.
        text: the TOML that defines the study.
        design: the reducer.
        conditions: how it runs.
        tolerances: record of the design's errors with a Tolerance or None in each field.
        costs: cost model of each field that may change, by name.
        requirements: limits by response name.
        seed: of all random numbers.
        samples: units that the optimiser sees.
        certificate_samples: fresh units on which the result is certified.
        joint_target: share of units that must meet all requirements at once; None: each has a target of its own.
        accuracy: largest error of computation allowed, by response name; without one the conditions decide.
        middles: ranges in which the limits of an error may move as a whole, by name.
        identification: content of the table [identify], or None.
        columns: table [columns], foreign names of the columns of measured data.
        read_in: unit in which a response is reported, by its name: that of its limit; without one the usual one.
        about: title, author and revision, if the file says them.
        sections: what further tables of the file hold, by the name of the table; each belongs to a command.
        variables: numbers of the design that `rvjax design` may choose, by path.
        objective: prices of outputs without errors, by name.
        nominal: limits of outputs without errors, by name.
        losses: quality losses by response name.
        to_solve: whether the first `response` checks that the unit without errors can be solved.
    """

    name: str
    text: str
    design: PyTree
    conditions: PyTree
    tolerances: PyTree
    costs: dict[str, Cost]
    requirements: dict[str, Limits]
    seed: int = 0
    samples: int = 16384
    certificate_samples: int = 1_000_000
    joint_target: float | None = None
    accuracy: dict[str, float] = dataclasses.field(default_factory=dict)
    middles: dict[str, Middle] = dataclasses.field(default_factory=dict)
    identification: Identification | None = None
    columns: Mapping[str, object] = dataclasses.field(default_factory=dict)
    read_in: dict[str, str] = dataclasses.field(default_factory=dict)
    about: About = dataclasses.field(default_factory=About)
    sections: dict[str, object] = dataclasses.field(default_factory=dict)
    variables: dict[str, Variable] = dataclasses.field(default_factory=dict)
    objective: dict[str, Price] = dataclasses.field(default_factory=dict)
    nominal: dict[str, Nominal] = dataclasses.field(default_factory=dict)
    losses: dict[str, QuadraticLoss] = dataclasses.field(default_factory=dict)
    to_solve: bool = dataclasses.field(default=False, compare=False)

    def __post_init__(self) -> None:
        """Keep the models silent about the design, because `doubts` lists its values."""
        accept(self.design)

    def response(self, *, solve: bool = True) -> Response:
        """errors -> Outcome of the responses that requirements and losses name.

        Args:
            solve: also check the unit without errors, if `load` has left that to the first call.

        Raises:
            StudyError: there are none, as in a study that only identifies, or the unit without errors fails.
        """
        if not self.requirements:
            raise StudyError(f"{self.name}: [requirement] is missing or empty")
        if solve and self.to_solve:
            self._solved  # noqa: B018  (once)
        return self._response((*self.requirements, *self.losses))

    @property
    def units(self) -> Response:
        """The response of many units, each solved at the angles that the conditions let it choose."""
        return self.at_few(self.response())

    @property
    def chooses_angles(self) -> bool:
        """True where a unit is solved at few angles of the span."""
        return takes_few(self._response((*self.requirements, *self.losses)), self.tolerances)

    def at_few(self, response: Response, tolerances: PyTree | None = None) -> Response:
        """A response of the study, solved at few angles of each unit where its conditions and outputs allow it.

        Args:
            response: of units.
            tolerances: of the units; by default those of the study.
        """
        own = self.tolerances if tolerances is None else tolerances
        if not takes_few(response, own):
            return response
        return response.replace(expected=self._expected if own is self.tolerances else self._learned(own))

    @functools.cached_property
    def _expected(self) -> Expected:
        return self._learned(self.tolerances)

    def _learned(self, tolerances: PyTree) -> Expected:
        return learned(self._response((*self.requirements, *self.losses)), Population.of(tolerances))

    def _response(self, outputs: Iterable[str]) -> Response:
        """errors -> Outcome of some outputs, each at its level."""
        names, bounds = tuple(dict.fromkeys(outputs)), followed_bounds(self.tolerances)
        return Response.of(self.design, names, self.conditions, self.choices(), bounds)

    def design_response(self, *, similar: bool = True) -> DesignResponse:
        """(errors, values of the variables) -> Outcome of all limited and priced outputs.

        Args:
            similar: False: without scaling laws.

        Raises:
            StudyError: no unit is required to keep a limit.
        """
        if not self.requirements:
            raise StudyError(f"{self.name}: [requirement] limits no response of the units")
        response = self._response((*self.requirements, *self.losses, *self.without_errors))
        return DesignResponse(self.at_few(response), tuple(sorted(self.given)), similar)

    @property
    def without_errors(self) -> tuple[str, ...]:
        """Outputs that are limited or priced without errors."""
        return tuple(dict.fromkeys((*self.nominal, *self.objective)))

    def nominal_response(self, *, similar: bool = True) -> DesignResponse:
        """(errors, values of the variables) -> Outcome of the outputs that are limited or priced without errors.

        Args:
            similar: False: without scaling laws.
        """
        response = Response.of(self.design, self.without_errors, self.conditions)
        return DesignResponse(response, tuple(sorted(self.given)), similar)

    def check_nominal(self) -> None:
        """Solve the unit without errors.

        Raises:
            StudyError: it has no solution.
        """
        with naming(self.name):
            refuse(int(outcome_of(self.response(solve=False), self.design.error_record()).status))

    @property
    def further(self) -> tuple[str, ...]:
        """Usual outputs of such a reducer that the study does not limit, and that its numbers allow."""
        return tuple(name for name in kind_of(self.design).usual if name not in self.requirements and self.allows(name))

    def allows(self, name: str) -> bool:
        """True if design and conditions allow an output."""
        try:
            Response.of(self.design, (name,), self.conditions)
        except ValueError:
            return False
        return True

    def at_mid_points(self, further: Sequence[str] = ()) -> tuple[dict[str, float], Status]:
        """Outputs, SI, of the unit whose errors are the mid-points of their tolerances, and its status.

        Args:
            further: outputs beyond the required ones.
        """
        response = self.response(solve=False)
        if further:
            response = self._response((*response.outputs, *further))
        found = outcome_of(response, mid_points(self.tolerances, self.design.error_record))
        return {name: float(value) for name, value in found.value.items()}, Status(int(worst(found.status)))

    @functools.cached_property
    def _solved(self) -> None:
        self.check_nominal()

    @property
    def costly(self) -> bool:
        """True if a unit is so expensive that only the decisive units are solved."""
        return bool(self.requirements) and self.response(solve=False).costly

    def response_of(self, name: str) -> Response:
        """errors -> Outcome of one response that the requirements name."""
        return Response.of(
            self.design, (name,), self.conditions, {k: c for k, c in self.choices().items() if k == name}
        )

    def choices(self) -> dict[str, Choice]:
        """The level of each response with an accuracy, for tolerances as wide as the costs let them become."""
        if not self.accuracy:
            return {}
        widest = {
            name: getattr(self.tolerances, name).with_half_width(
                max(cost.coarsest, getattr(self.tolerances, name).half_width)
            )
            for name, cost in self.costs.items()
        }
        return choose(
            self.design,
            tuple(self.requirements),
            self.conditions,
            tolerances=self.tolerances.replace(**widest),
            accuracy=self.accuracy,
        )

    @property
    def fields(self) -> list[str]:
        """Names of the errors with a tolerance, in the order of the error record."""
        return list(by_error(self.tolerances))

    def unit(self, field: str) -> str:
        """SI unit of an error."""
        unit: str = metadata(type(self.tolerances), field)["unit"]
        return unit

    @property
    def doubts(self) -> list[str]:
        """Numbers, process ranges and limits far from those of every known reducer, a line each."""
        outputs = {name: self.output(name) for name in self.requirements}
        return [
            *doubts(self.design, self.conditions, self.tolerances, self.forms),
            *kind_of(self.design).coarse(self.design, self.conditions, tuple(self.requirements)),
            *doubtful_costs(self.costs, self.tolerances),
            *doubtful_limits(self.requirements, outputs),
        ]

    def inaccurate(self, tolerances: Record | None = None, *, angles: bool = True) -> list[str]:
        """Errors of the results of a model that these numbers bring, a line each: where a result is read, it has them.

        Args:
            tolerances: of the result; by default those of the study.
            angles: also the error of chosen angles, which is no fault of the numbers.
        """
        lines = kind_of(self.design).inaccurate(self.design, self.tolerances if tolerances is None else tolerances)
        if not (angles and self.chooses_angles):
            return lines
        some = f"{self.conditions.chosen_angles} of {self.conditions.samples} angles of the span"
        return [
            *lines,
            f"each unit is solved at {some}: errors and pressures are estimates, other largest values may be larger",
        ]

    @property
    def assumed(self) -> list[str]:
        """Paths of the unpublished values of the design, as marked in the base or in the study."""
        return [number.path for number in self.numbers if number.assumed]

    @property
    def assumed_limits(self) -> set[str]:
        """Responses whose limit the study marks as assumed."""
        entries = self.tables.get("requirement", {})
        found = set()
        for path, note in comments(self.text, "requirement").items():
            key, _, limit = path.partition(".")
            if is_assumed(note) and is_initial(entries[key].get(limit), note):
                found.add(entries[key].get("response", key))
        return found

    def design_with(self, values: Mapping[str, Scalar], *, similar: bool = True) -> PyTree:
        """The design with other numbers, and with all that follows from them.

        Args:
            values: {path: value}, such as {"cycloid.eccentricity": 1.4e-3}, SI; they may be traced.
            similar: False: without scaling laws; only gears, crank circle and K1 follow.

        Raises:
            ValueError: an unknown path, or a number that no such design has.
        """
        known = dict(fields_of(self.design))
        for path in values:
            if (plain := path.partition("[")[0]) not in known:
                raise unknown("unknown number of the design", plain, sorted(known), "; known here:")
        return changed(self.design, values, self.given, similar=similar)

    @property
    def tables(self) -> Mapping[str, PyTree]:
        """Tables of the file, as written; read only."""
        return tables_of(self.text)

    @functools.cached_property
    def given(self) -> frozenset[str]:
        """Paths of the numbers of the design that the study gives; they do not follow others."""
        return frozenset(given_paths(self.tables["design"]))

    @functools.cached_property
    def forms(self) -> dict[str, Form]:
        """Forms of the tolerances that the file states in the words of drawings, by error."""
        return forms(self.tables["tolerances"])

    @property
    def base(self) -> str:
        """The published reducer that the design begins with, "" without one."""
        return str(self.tables["design"].get("base", ""))

    @property
    def numbers(self) -> list[Number]:
        """Numbers of the design, with where each comes from; without parts that only responses not required read."""
        described = models.kind(self.design).described
        unread = {part for one in described.values() for part in one.parts}
        unread -= {part for name in self.requirements for part in described[name].parts}
        found = design_numbers(self.design, self.tables["design"], self.text)
        return [number for number in found if number.path.partition(".")[0] not in unread]

    @property
    def left_out(self) -> list[str]:
        """List what the required models do not include, a line each; of several models, each with its responses."""
        described = models.kind(self.design).described
        lines: dict[str, list[str]] = {}
        for name in self.requirements:
            lines.setdefault(described[name].unknown, []).append(name)
        lines.pop("", None)
        said = [f"{line} (for {', '.join(names)})" if len(lines) > 1 else line for line, names in lines.items()]
        parts: dict[str, list[str]] = {}
        for name, span in self.spans.items():
            if span != models.WHOLE:
                parts.setdefault(span, []).append(name)
        return said + [f"more than {span} (for {', '.join(names)})" for span, names in parts.items()]

    @property
    def spans(self) -> dict[str, str]:
        """Part of a turn of the output in words, by limited response whose value is read along it."""
        spans = {name: models.span_of(self.design, self.conditions, name) for name in self.requirements}
        outputs = models.kind(self.design).outputs
        return {name: span for name, span in spans.items() if span and models.SPAN in outputs[name].meaning}

    @property
    def curve(self) -> Curve | None:
        """Curve for plots, or None."""
        found = models.kind(self.design).curve(tuple(self.requirements))
        name = next((name for name in self.requirements if models.kind(self.design).described[name].curve == found), "")
        return found and self.titled(found, name)

    def titled(self, curve: Curve, name: str) -> Curve:
        """A curve with its span in the title.

        Args:
            curve: of the design.
            name: of an output of its model.
        """
        span = models.span_of(self.design, self.conditions, name) if name else ""
        return dataclasses.replace(curve, title=curve.title.replace(models.SPAN, span or models.SPAN))

    def output(self, name: str) -> Output:
        """Output of a response, shown in the measurement unit of its limit, with its span in words."""
        output = models.kind(self.design).outputs[name]
        meaning = output.meaning.replace(models.SPAN, models.span_of(self.design, self.conditions, name) or models.SPAN)
        return dataclasses.replace(output, read_in=self.read_in.get(name, output.read_in), meaning=meaning)
