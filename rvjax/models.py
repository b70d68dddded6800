"""Models of studies. A new model is a package with an `outputs.py`, and a line here."""

import dataclasses
import importlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

from rvjax.outputs import Curve, Description, Extremes, Joint, Observation, Output, Source, Usual, Work
from rvjax.records import Design, PyTree

MODELS = (
    "rvjax.four_bar",
    "rvjax.lost_motion",
    "rvjax.mesh_force",
    "rvjax.dynamics",
    "rvjax.loaded",
    "rvjax.life",
    "rvjax.running",
    "rvjax.geometry",
)
"""Packages, each with `outputs.DESCRIPTION`, and with `outputs.OTHERS` where another kind of design has other outputs.

The first required output whose model has a curve gives the plot.
"""


SPAN, WHOLE = "the span", "a turn of the output"
"""In the meaning of an output: the part of a turn of the output along which it is read; the longest span."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """Conditions and outputs of one kind of design.

    Attributes:
        conditions: class of all conditions of its models, as one.
        outputs: by name.
        described: description of the model that has an output, by its name.
        observed: descriptions of the models that a bench can measure, by the name of the model.
        joints: results that are cheaper computed together.
        usual: usual limits by output.
        work: equilibria that a result takes.
    """

    conditions: type
    outputs: Mapping[str, Output]
    described: Mapping[str, Description]
    observed: Mapping[str, Description]
    joints: tuple[Joint, ...] = ()
    usual: Mapping[str, Usual] = dataclasses.field(default_factory=dict)
    work: Mapping[Source, Work] = dataclasses.field(default_factory=dict)

    def observations(self, model: str) -> dict[str, Observation]:
        """Observations of a model on a bench, by kind of data."""
        return {observation.kind: observation for observation in self.observed[model].observations}

    def curve(self, outputs: tuple[str, ...]) -> Curve | None:
        """Curve of the first required output that has one; other curves may need what the design lacks."""
        asked = [self.described[name].curve for name in outputs]
        return next((c for c in asked if c is not None), None)

    def extremes(self, outputs: Iterable[str]) -> Extremes | None:
        """Extremes of the first required output that has some."""
        asked = [self.described[name].extremes for name in outputs]
        return next((extremes for extremes in asked if extremes is not None), None)

    def conditions_of(self, outputs: tuple[str, ...]) -> list[str]:
        """Names of the conditions that the models of some outputs read."""
        read = {f.name for name in outputs for f in dataclasses.fields(self.described[name].conditions)}
        return [f.name for f in dataclasses.fields(self.conditions) if f.name in read]

    def costly(self, outputs: Iterable[str]) -> bool:
        """True if one of these takes equilibria: a unit takes so long that only the units that decide are solved."""
        return any(self.described[name].work and name not in self.described[name].quick for name in outputs)

    def compiler_options(self, outputs: Iterable[str]) -> tuple[tuple[str, bool | int], ...]:
        """Compiler options of a program of some outputs: the options of all their models."""
        return tuple(dict.fromkeys(o for name in outputs for o in self.described[name].compiler_options))


def descriptions() -> tuple[Description, ...]:
    """Descriptions of all models."""
    modules = [importlib.import_module(f"{name}.outputs") for name in MODELS]
    return tuple(one for module in modules for one in (module.DESCRIPTION, *getattr(module, "OTHERS", ())))


def tables() -> set[str]:
    """Names of the conditions that a study gives as tables."""
    return {f.name for one in descriptions() for f in dataclasses.fields(one.conditions) if f.metadata["columns"]}


def kinds() -> dict[str, type]:
    """Classes of designs by the name that study files give them."""
    return {design.kind: design for one in descriptions() for design in one.designs}  # type: ignore[attr-defined]


def kind(design: object) -> Kind:
    """Conditions and outputs of a design.

    Raises:
        ValueError: no model takes it.
    """
    return kind_of(type(design))


def kind_of(design: type) -> Kind:
    """Conditions and outputs of a class of designs.

    Raises:
        ValueError: no model takes it.
    """
    return _kind(design, descriptions())


@lru_cache(maxsize=16)
def _kind(design: type, known: tuple[Description, ...]) -> Kind:
    mine = [description for description in known if issubclass(design, description.designs)]
    if not mine:
        raise ValueError(f"no model takes a {design.__name__}")
    described: dict[str, Description] = {}
    for description in mine:
        for name in description.outputs:
            if name in described:
                raise ValueError(f"output {name!r} is described twice")
            described[name] = description
    outputs = {name: description.outputs[name] for name, description in described.items()}
    observed = {one.name: one for one in mine if one.observations}
    joints = tuple(joint for one in mine for joint in one.joints)
    usual = {name: limit for one in mine for name, limit in one.usual.items()}
    work = {source: own for one in mine for source, own in one.work.items()}
    return Kind(_joined(mine), outputs, described, observed, joints, usual, work)


def _joined(known: list[Description]) -> type:
    """One class of all conditions; a condition that two models read is declared alike by both."""
    fields: dict[str, dataclasses.Field[Any]] = {}
    for f in (f for description in known for f in dataclasses.fields(description.conditions)):
        first = fields.setdefault(f.name, f)
        if (first.default, first.metadata) != (f.default, f.metadata):
            raise ValueError(f"condition {f.name!r} is declared in two ways")
    items: Any = [(name, Any, dataclasses.field(default=f.default, metadata=f.metadata)) for name, f in fields.items()]
    return dataclasses.make_dataclass("Conditions", items, frozen=True)


def _turns(design: Design, conditions: object, name: str) -> float | None:
    curve = kind(design).described[name].curve
    return None if curve is None or curve.turns is None else curve.turns(design, conditions)


def span_of(design: Design, conditions: object, name: str) -> str:
    """Part of a turn of the output over which a response is read, in words; "" for a response of no curve.

    Args:
        design: the reducer.
        conditions: of the study.
        name: of the response.
    """
    turns = _turns(design, conditions, name)
    return "" if turns is None else WHOLE if turns == 1 else f"{360 * turns:.3g} deg of the output"


def over_a_turn(design: Design, conditions: PyTree, name: str, times: int = 1) -> PyTree:
    """Conditions of a whole turn of the output at angles as dense as the given ones, or `times` as dense.

    With one angle more, the angles of each crank turn differ, and no order of pins or holes looks like the mean.

    Args:
        design: the reducer.
        conditions: of the study.
        name: of a response with a span.
        times: angles over those of the study, in a part of a turn.
    """
    turns = _turns(design, conditions, name)
    assert turns is not None
    return dataclasses.replace(conditions, span="output_turn", samples=times * round(conditions.samples / turns) + 1)
