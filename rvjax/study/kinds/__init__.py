"""Descriptions of the kinds of reducers, one file or folder for each."""

from collections.abc import Collection, Iterable, Mapping

from rvjax.records import PyTree, Scalar
from rvjax.study.kinds import cam_roller, cycloidal, rv
from rvjax.study.kinds.following import (
    Law as Law,
    fields_of as fields_of,
    fields_of_kind as fields_of_kind,
    number_at as number_at,
    outside as outside,
    split as split,
)
from rvjax.study.kinds.kind import Assumed as Assumed, Drawing as Drawing, Kind as Kind, Known as Known, Start as Start

__all__ = ["KINDS", "Kind", "changed", "facts_of", "kind_of", "orders_of"]

KINDS: dict[type, Kind] = {kind.design: kind for kind in (rv.KIND, cam_roller.KIND, cycloidal.KIND)}
"""By the class of the design. A new kind of reducer is a module here, and its `KIND` in this tuple."""


def kind_of(design: object) -> Kind:
    """The kind of a design; one without facts, scaling laws or drawing for a class that is not in `KINDS`."""
    cls = type(design)
    return next((KINDS[base] for base in cls.__mro__ if base in KINDS), Kind(cls, f"a {cls.__name__}"))


def facts_of(design: object) -> Iterable[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design; nothing for a class that is not in `KINDS`."""
    return kind_of(design).facts(design)


def orders_of(design: object) -> Mapping[str, float]:
    """{part: order of the output revolution that it causes}; empty where no bench measures the curve of a design."""
    orders = kind_of(design).orders
    return orders(design) if orders else {}


def changed(
    design: PyTree,
    values: Mapping[str, Scalar],
    given: Collection[str] = (),
    *,
    similar: bool = True,
    whole: bool = False,
) -> PyTree:
    """The design with other numbers, and with all that follows.

    Args:
        design: before.
        values: {path: new value}, SI; they may be traced.
        given: paths of numbers that the study gives: they do not follow.
        similar: False: without scaling laws; only what follows exactly.
        whole: a reducer of another size; also with the scaling laws that hold only there.
    """
    return kind_of(design).following.changed(design, values, given, similar=similar, whole=whole)
