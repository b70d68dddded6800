"""Response of a study: one function of the errors that computes only the required outputs.

Statistics and allocation use only the response `errors -> Outcome`, no gears; models use no statistics.

Where the conditions say so a unit is solved at few angles of its span, where its extremes are expected: a curve of
the reducer at an angle is nearly linear in the errors of its parts, so that mean slopes predict the curve of any unit.
Gain: 16 of 481 angles of a turn of the output lose 3 % of the peak to peak of an RV-40E; 97 equal ones take three times
as long and lose 4.5 % (`benchmarks/chosen_angles.py`).
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax._jax.kernels import in_blocks
from rvjax._jax.programs import ONCE
from rvjax.base.words import unknown
from rvjax.errors import Errors, described
from rvjax.levels import Choice
from rvjax.outputs import Extremes, Joint, Reading, Solved, Source
from rvjax.population import Population, drawn, root_key
from rvjax.records import Array, Design, PyTree, Record, Scalar, field, record, text
from rvjax.response import elements, per_response
from rvjax.status import SUCCESS, Status, worst
from rvjax.study.kinds import changed
from rvjax.study.tolerances import by_error
from rvjax.tolerances import Outcome

Settings = tuple[tuple[str, PyTree], ...]
Level = tuple[Settings, str, str | None] | None  # settings, precision, output of another model

CURVE = "curve"
"""Of the names of its numbers among the values of a response."""
LONGEST = 256
"""Most of these numbers: each is an output of the program, and 961 of them take 9 s to compile."""
UNITS, AT_ONCE = 32, 8
"""Units whose slopes are averaged, and at once. Of the variance of the error of a drive 16 units predict 87 %, 64 units
89 %; the loss of 24 angles falls from 6.3 to 4.8 %."""


@record
class Expected(Record):
    """Curves along a span, linear in the errors of a unit, and what is read off them."""

    angles: Array = field("rad", "of the input", shape=("n",))
    middle: Array = field("as the curves", "of a unit without errors", shape=("curves", "n"))
    slopes: Array = field("as the curves", "to the elements of the errors", shape=("curves", "n", "elements"))
    fields: tuple[tuple[str, tuple[int, ...]], ...] = text("errors of the elements in turn, with shapes")
    places: tuple[tuple[int, int, int], ...] = text("curve, 1 for highest or -1 for lowest, their number")

    def angles_of(self, errors: PyTree) -> jax.Array:
        """Input angles (m,) at which a unit is solved, rad: in each part of the span those of the expected extremes.

        Args:
            errors: of the unit.
        """
        each = (jnp.broadcast_to(getattr(errors, name), shape) for name, shape in self.fields)
        vector = jnp.concatenate([jnp.ravel(error) for error in each])
        curves = self.middle + self.slopes @ jax.lax.stop_gradient(vector)
        places = jnp.concatenate([_highest(sign * curves[k], parts) for k, sign, parts in self.places])
        return jnp.asarray(self.angles)[places]


def _highest(curve: jax.Array, parts: int) -> jax.Array:
    """Number of the highest place in each part of a curve (n,)."""
    ends = np.round(np.linspace(0, len(curve), parts + 1)).astype(int)
    return jnp.stack([low + jnp.argmax(curve[low:high]) for low, high in itertools.pairwise(ends)])


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
    expected: PyTree = field("-", "curves that choose the angles of each unit", kind="record", default=None)

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
        if self.curve:  # which a program of the outputs computes anyway
            described = models.kind(self.design).curve(self.outputs)
            assert described is not None and described.source is not None
            source, take = described.source
            row = take(shared[None][source])
            values |= {f"{CURVE}[{k}]": row[k] for k in range(row.shape[0])}
        return Outcome(values, worst(statuses))

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
        short = shown is not None and shown.angles is not None and len(shown.angles(self.conditions)) <= LONGEST
        curve = shown.source if shown is not None and short and few is None else None
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


def takes_few(response: Response, tolerances: PyTree) -> bool:
    """True where the conditions let units choose their angles, and the outputs need no others.

    Args:
        response: of a study.
        tolerances: of its units.
    """
    few = models.kind(response.design).extremes(response.outputs)
    if few is None or few.solved(response.conditions) is None or not Population.of(tolerances).active:
        return False
    reading = {name for name in response.outputs if (None, few.source) in response.read(name)}
    return bool(reading) and reading <= set(few.outputs)


def learned(response: Response, population: Population, seed: int) -> Expected:
    """Expected curves of the units of a study.

    Args:
        response: that `takes_few`.
        population: of the units; a response to others may keep what these teach.
        seed: of the units whose slopes are averaged; those that fail are left out.
    """
    few = models.kind(response.design).extremes(response.outputs)
    assert few is not None
    z = np.asarray(drawn(population, root_key(seed), np.uint32(0), count=UNITS))
    errors = np.asarray(elements(population, jnp.asarray(z)))
    values, slopes = in_blocks(lambda some: _slopes(response, population, some.T), AT_ONCE, errors.T)
    at_zero = values - np.einsum("unce,eu->unc", slopes, errors)  # (units, n, c)
    good = np.isfinite(at_zero)  # not where a slope is NaN either
    share = good / np.maximum(good.sum(axis=0), 1)
    return Expected(
        angles=few.angles(response.design, response.conditions),
        middle=np.einsum("unc,unc->cn", share, np.where(good, at_zero, 0)),
        slopes=np.einsum("unc,unce->cne", share, np.where(good[..., None], slopes, 0)),
        fields=tuple((name, tolerance.shape) for name, tolerance in population.active.items()),
        places=_places(few.solved(response.conditions) or 0, at_zero.shape[2]),
    )


def _places(solved: int, curves: int) -> tuple[tuple[int, int, int], ...]:
    """Curve, 1 for its highest or -1 for its lowest places, and their number; one of six is for all further curves."""
    others = curves - 1
    first = (solved - max(others, solved // 6)) // 2 if others else solved // 2
    rest = solved - 2 * first if others else 0
    return (0, 1, first), (0, -1, first), *((k + 1, 1, rest // others + (k < rest % others)) for k in range(others))


@per_response(options=ONCE)
def _slopes(response: Response, population: Population, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Curves (units, n, c) at all angles of the span and their slopes to the errors (elements, units)."""
    few = models.kind(response.design).extremes(response.outputs)
    assert few is not None
    angles = jnp.asarray(few.angles(response.design, response.conditions), errors.dtype)

    def one(vector: jax.Array, angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        def curves(vector: jax.Array) -> jax.Array:
            own = response.bounded(population.fill(population.by_field(vector)))
            return few.curves(response.design, own, response.conditions, angle)

        values, pull = jax.vjp(curves, vector)
        return values, jax.vmap(lambda cotangent: pull(cotangent)[0])(jnp.eye(len(values), dtype=values.dtype))

    return jax.vmap(jax.vmap(one, (None, 0)), (-1, None))(errors, angles)
