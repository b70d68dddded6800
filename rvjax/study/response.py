"""Response of a study: one function of the errors that computes only the required outputs.

Statistics and allocation use only the response `errors -> Outcome`, no gears; models use no statistics.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import jax
import jax.numpy as jnp

from rvjax import models
from rvjax._jax.programs import ONCE
from rvjax.base.words import unknown
from rvjax.errors import Errors, described
from rvjax.levels import Choice
from rvjax.outputs import Extremes, Joint, Reading, Solved, Source
from rvjax.population import Population
from rvjax.records import Design, PyTree, Record, Scalar, field, record, text
from rvjax.response import per_response
from rvjax.status import SUCCESS, Status, worst
from rvjax.study.kinds import changed
from rvjax.study.tolerances import by_error
from rvjax.tolerances import Outcome

Settings = tuple[tuple[str, PyTree], ...]
Level = tuple[Settings, str, str | None] | None  # settings, precision, output of another model


@record
class Response(Record):
    """errors -> Outcome({output: value}, status) of one unit, with the required outputs only.

    Its numbers are those of the design: a program that was compiled for one study serves every design of its kind.
    """

    design: PyTree = field("-", "the reducer", kind="record")
    outputs: tuple[str, ...] = text("names")
    conditions: PyTree = text("how the reducer runs")
    levels: tuple[tuple[str, Settings, str, str | None], ...] = text(
        "(output, settings, precision, output of another model) where a level was chosen"
    )
    bounds: tuple[str, ...] = text("errors without a place that follow from those with one", default=())
    curve: bool = text("whether the numbers of the curve that its outputs read are wanted too", default=False)
    expected: PyTree = field("-", "curves that choose the angles of a unit", kind="record", default=None)

    @classmethod
    def of(
        cls,
        design: Design,
        outputs: Sequence[str],
        conditions: object,
        choices: Mapping[str, Choice] | None = None,
        bounds: Sequence[str] = (),
    ) -> Self:
        """The response of a study.

        Args:
            design: the reducer.
            outputs: names of outputs of this kind of design.
            conditions: how the reducer runs.
            choices: levels from `levels.choose`, by output; an output without one is computed as `conditions` say.
            bounds: errors without a place that follow from those with one, see `RVErrors.bounded`.

        Raises:
            ValueError: an output that does not exist, that needs a condition which is not given, or that these
                conditions cannot give.
        """
        known = models.kind(design).outputs
        for name in outputs:
            if name not in known:
                raise unknown(f"unknown response {name!r}", name, known, "; there are")
            for missing in (need for need in known[name].needs if getattr(conditions, need) is None):
                raise ValueError(f"conditions.{missing} is missing: {name} needs it")
            if (refuse := known[name].refuse) is not None:
                refuse(design, conditions)
        chosen = tuple((c.output, c.settings, c.precision, c.instead) for c in (choices or {}).values())
        return cls(design, tuple(outputs), conditions, chosen, tuple(bounds))

    def __call__(self, errors: PyTree) -> Outcome:
        """Values and the worst status of one unit."""
        errors = self.bounded(errors)
        shared: dict[Level, dict[Source, PyTree]] = {}  # by level; outputs of one level read the same results
        if (few := self._extremes()) is not None:
            angles = self.expected.angles_of(errors)
            shared[None] = {few.source: few.source(self.design, errors, self.conditions, angles)}
        for joint in self._joints():
            results = joint.evaluate(self.design, errors, self.conditions)
            shared.setdefault(None, {}).update(zip(joint.sources, results))
        found = {name: self._one(name, errors, shared) for name in self.outputs}
        statuses = jnp.stack([jnp.asarray(status) for _, status in found.values()])
        values = {name: value for name, (value, _) in found.items()}
        if few is not None:
            values |= {name: values[name] * factor for name, factor in self._factors(few).items()}
        if self.curve:  # which a program of the outputs computes anyway
            described = models.kind(self.design).curve(self.outputs)
            assert described is not None and described.source is not None
            source, take = described.source
            return Outcome(values, worst(statuses), curve=take(shared[None][source]))
        return Outcome(values, worst(statuses))

    def among(self, population: Population) -> Self:
        """The response of units of this population; its gradients are those of the same population.

        Args:
            population: of the units.
        """
        return self if self.expected is None else self.replace(expected=self.expected.among(population))

    @property
    def central(self) -> Self:
        """The response of a unit without errors or at the mid-points: chosen angles lose nothing of its curves."""
        return self if self.expected is None else self.replace(expected=self.expected.central)

    def near(self, population: Population) -> Self:
        """The response with curves of units of this population.

        Args:
            population: near the one whose units will be solved.
        """
        if self.expected is None:
            return self
        return self.replace(expected=self.expected.near(self.replace(expected=None), population))

    def bounded(self, errors: Errors) -> Errors:
        """Errors with the bounds that follow from them."""
        return errors.bounded(self.bounds) if self.bounds else errors

    @property
    def compiler_options(self) -> Settings:
        """Compiler options of the required models."""
        return models.kind(self.design).compiler_options(self._sources().values())

    @property
    def costly(self) -> bool:
        """True if a unit is so expensive that only the decisive units are solved."""
        return models.kind(self.design).costly(self._sources().values())

    def parts(self) -> list[Self]:
        """Outputs in groups that share no result, each as a separate response, one with the curve."""
        joints = [{(None, source) for source in joint.sources} for joint in self._joints()]
        few, shown = self._extremes(), models.kind(self.design).curve(self.outputs)
        curve = shown.source if shown is not None and shown.angles is not None and few is None else None
        groups: list[tuple[set[object], list[str]]] = []
        for name in self.outputs:
            own = self.read(name) or {name}
            own = own.union(*(joint for joint in joints if joint & own))
            joined = [group for group in groups if group[0] & own]
            groups = [group for group in groups if not group[0] & own]
            groups.append((own.union(*(g[0] for g in joined)), [n for g in joined for n in g[1]] + [name]))
        return [
            self.replace(
                outputs=tuple(names),
                levels=tuple(level for level in self.levels if level[0] in names),
                curve=curve is not None and (None, curve[0]) in own,
                expected=None if few is None or (None, few.source) not in own else self.expected,
            )
            for own, names in groups
        ]

    def read(self, name: str) -> set[object]:
        """Results, each with its level, that an output shares with others."""
        evaluate = models.kind(self.design).outputs[self._sources()[name]].evaluate
        level = next((level[1:] for level in self.levels if level[0] == name), None)
        read = evaluate.read(self.conditions) if isinstance(evaluate, Reading) else ()
        return {(level, source) for source in read}

    def _extremes(self) -> Extremes | None:
        """Results that are read at few angles of each unit."""
        return None if self.expected is None else models.kind(self.design).extremes(self.outputs)

    def _factors(self, few: Extremes) -> dict[str, Scalar]:
        """Factors on the values at the chosen angles, by output with a curve."""
        curves = {name: few.outputs.get(name) for name in self.outputs if (None, few.source) in self.read(name)}
        return {name: self.expected.factors[curve] for name, curve in curves.items() if curve is not None}

    def _joints(self) -> list[Joint]:
        """Results without a level that are computed together, of overlapping ways the largest.

        Units at few angles have angles of their own. In one loop all others would have a geometry for each unit, too.
        """
        needed = set().union(*(self.read(name) for name in self.outputs))
        few = self._extremes()
        joints = [j for j in models.kind(self.design).joints if few is None or few.source not in j.sources]
        able = [(j, set(j.sources)) for j in joints if all((None, source) in needed for source in j.sources)]
        return [j for j, own in able if not any(own < other for _, other in able)]

    def _sources(self) -> dict[str, str]:
        """The output that is computed for each that is wanted."""
        instead = {level[0]: level[3] for level in self.levels if level[3] is not None}
        return {name: instead.get(name, name) for name in self.outputs}

    def _one(self, name: str, errors: Errors, shared: dict[Level, dict[Source, object]]) -> Solved:
        level = next((level[1:] for level in self.levels if level[0] == name), None)
        source = name if level is None or level[2] is None else level[2]
        evaluate = models.kind(self.design).outputs[source].evaluate
        design, used, given = self.design, errors, self.conditions
        if level is not None:
            settings, precision, _ = level
            given = replace(given, **dict(settings))
            design, used = jax.tree.map(lambda leaf: jnp.asarray(leaf, precision), (design, errors))
        if isinstance(evaluate, Reading):
            value, status = evaluate.within(shared.setdefault(level, {}), design, used, given)
        else:
            value, status = evaluate(design, used, given)
        if level is not None:
            value = value.astype(jnp.result_type(float, *jax.tree.leaves(errors)))
        return value, status


@record
class DesignResponse(Record):
    """(errors, {path: value}) -> Outcome of one unit of the design with other numbers."""

    response: Response = field("-", "with the design of the study", kind="record")
    given: tuple[str, ...] = text("paths of the numbers that do not follow")
    similar: bool = text("whether scaling laws hold", default=True)

    def __call__(self, errors: object, values: Mapping[str, Scalar] | None = None) -> Outcome:
        """Values and the worst status of one unit."""
        design = changed(self.response.design, values or {}, self.given, similar=self.similar)
        return self.response.replace(design=design)(errors)

    def among(self, population: Population) -> Self:
        """The response of units of this population, as `Response.among`."""
        return self.replace(response=self.response.among(population))

    @property
    def central(self) -> Self:
        """The response of a unit without errors or at the mid-points, as `Response.central`."""
        return self.replace(response=self.response.central)

    def near(self, population: Population) -> Self:
        """The response with curves of units of this population, as `Response.near`."""
        design = changed(self.response.design, population.values or {}, self.given, similar=self.similar)
        near = self.response.replace(design=design).near(population.replace(values=None))
        return self.replace(response=self.response.replace(expected=near.expected))

    @property
    def compiler_options(self) -> Settings:
        """Compiler options of the required models."""
        return self.response.compiler_options

    @property
    def costly(self) -> bool:
        """True if a unit is so expensive that only the decisive units are solved."""
        return self.response.costly

    def parts(self) -> list[Self]:
        """Outputs in groups that share no result, each as a separate response."""
        return [self.replace(response=part) for part in self.response.parts()]


def followed_bounds(tolerances: Record) -> tuple[str, ...]:
    """Errors without a place that have no tolerance of their own and follow from an error with one."""
    given = by_error(tolerances)
    bounds = described(tolerances, "bounds")
    return tuple(name for name, bound in bounds.items() if bound.placed in given and name not in given)


@per_response(options=ONCE)
def outcome_of(response: Response, errors: Errors) -> Outcome:
    """Required outputs of one unit.

    Args:
        response: of the study.
        errors: of the unit.
    """
    return response(errors)


def refuse(status: int) -> None:
    """Raise an error if the unit without errors has a status other than success.

    Raises:
        ValueError: names the status.
    """
    if status not in SUCCESS:
        raise ValueError(f"the unit without errors cannot be solved: {Status(status).name}")
