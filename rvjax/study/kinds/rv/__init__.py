"""RV reducers."""

from operator import attrgetter
from typing import Any

from rvjax.catalogue import shown
from rvjax.designs import RVReducer
from rvjax.mounting import unit_errors
from rvjax.study.kinds.kind import Drawing, Kind
from rvjax.study.kinds.rv.facts import (
    DERIVED_FROM,
    FOLLOWING,
    RATED as RATED,
    SPEED,
    TORQUE as TORQUE,
    derivation,
    doubts,
    facts,
    followed,
    implied,
    of_another_size,
    refuse,
)
from rvjax.study.kinds.rv.starts import NEEDED, STARTS, rated_torque


def _caption(design: RVReducer) -> str:
    cycloid = design.cycloid
    return (
        f"Second stage along its axis, to scale; diameters: {cycloid.pin_count} pins of "
        f"{shown(2 * cycloid.pin_radius, 'm')} on a circle of {shown(2 * cycloid.pin_circle_radius, 'm')}, one of "
        f"{cycloid.disc_count} discs, {design.cranks.count} cranks on a circle of "
        f"{shown(2 * design.cranks.circle_radius, 'm')}"
    )


def _drawn(design: RVReducer) -> Any:
    from rvjax.plotting import drawings  # only a drawing needs Matplotlib

    return drawings.reducer(design)


def _compared(before: RVReducer, after: RVReducer) -> Any:
    from rvjax.plotting import drawings

    return drawings.before_and_after(before, after)


KIND = Kind(
    design=RVReducer,
    name="an RV reducer",
    facts=facts,
    derivation=derivation,
    derived_from=DERIVED_FROM,
    followed=followed,
    implied=implied,
    following=FOLLOWING,
    refuse=refuse,
    doubts=doubts,
    rated=RATED,
    speed=SPEED,
    of_another_size=of_another_size,
    orders=attrgetter("orders"),
    unit_errors=unit_errors,
    drawing=Drawing(_drawn, _caption, _compared, "Section of the second stage, drawn to scale, before and after"),
    starts=STARTS,
    needed=NEEDED,
    torque=rated_torque,
)
