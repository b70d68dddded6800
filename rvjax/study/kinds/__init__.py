"""Descriptions of the kinds of reducers: of RV and of oscillatory roller reducers here, of each other in one file."""

from collections.abc import Collection, Iterable, Mapping
from operator import attrgetter

from rvjax.catalogue import shown
from rvjax.designs import CamRollerReducer, RVReducer
from rvjax.mesh_force import largest_roller_radius, undercut_margin
from rvjax.mounting import unit_errors
from rvjax.records import PyTree, Record, Scalar
from rvjax.study.kinds import cycloidal, rv_facts, rv_starts
from rvjax.study.kinds.kind import (
    Assumed as Assumed,
    Choices,
    Drawing as Drawing,
    Kind as Kind,
    Known as Known,
    Start as Start,
    drawn,
    features,
    variable_tables as variable_tables,
)
from rvjax.study.kinds.scaling import (
    Law as Law,
    number_at as number_at,
    outside as outside,
    replaced as replaced,
    split as split,
)

__all__ = ["KINDS", "Kind", "changed", "facts_of", "kind_of", "orders_of"]


def _rv_caption(design: RVReducer) -> str:
    cycloid = design.cycloid
    return (
        f"Second stage along its axis, to scale; diameters: {cycloid.pin_count} pins of "
        f"{shown(2 * cycloid.pin_radius, 'm')} on a circle of {shown(2 * cycloid.pin_circle_radius, 'm')}, one of "
        f"{cycloid.disc_count} discs, {design.cranks.count} cranks on a circle of "
        f"{shown(2 * design.cranks.circle_radius, 'm')}"
    )


_RV = Kind(
    design=RVReducer,
    name="an RV reducer",
    facts=rv_facts.facts,
    derivation=rv_facts.derivation,
    derived_from=rv_facts.DERIVED_FROM,
    followed=rv_facts.followed,
    implied=rv_facts.implied,
    following=rv_facts.FOLLOWING,
    refuse=rv_facts.refuse,
    doubts=rv_facts.doubts,
    rated=rv_facts.RATED,
    speed=rv_facts.SPEED,
    of_another_size=rv_facts.of_another_size,
    remedies=("contact.face_width", "stiffness.turning_arm_bearing", "stiffness.support_bearing"),
    orders=attrgetter("orders"),
    unit_errors=unit_errors,
    drawing=Drawing(
        drawn("drawings.reducer"),
        _rv_caption,
        drawn("drawings.before_and_after"),
        "Section of the second stage, drawn to scale, before and after",
    ),
    starts=rv_starts.STARTS,
    needed=rv_starts.NEEDED,
    torque=rv_starts.rated_torque,
    features=features("ring", "rv"),
)


def _roller_doubts(design: CamRollerReducer) -> list[str]:
    """A line for rollers that cut into the flank of the inner gear."""
    if undercut_margin(design) > 0:
        return []
    radius, limit = (shown(float(r), "m") for r in (design.roller_radius, largest_roller_radius(design)))
    return [f"design.roller_radius = {radius}: rollers from {limit} on cut into the flank of the inner gear (undercut)"]


_ROLLER_CHOICES = Choices(
    {"cam_radius": (0.9, 1.1), "eccentricity": (0.9, 1.1), "roller_radius": (0.8, 1.1), "roller_length": (0.8, 1.5)},
    prices={"cam_radius": 10.0, "roller_length": 5.0},
)
_CAM_ROLLER = Kind(
    design=CamRollerReducer,
    name="an oscillatory roller reducer",
    facts=lambda design: [("rollers", str(design.gear_teeth + 1))],
    doubts=_roller_doubts,
    starts={"": Start("corr", choices=_ROLLER_CHOICES)},
    features=features("oscillatory-roller"),
)

KINDS: dict[type, Kind] = {kind.design: kind for kind in (_RV, _CAM_ROLLER, cycloidal.KIND)}
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
    design: Record,
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
