"""Figures of `rvjax design`: the section to scale before and after, the trade front."""

from collections.abc import Iterator
from typing import Any

from rvjax.commands.design.compute import Designed, Point
from rvjax.render import Figure
from rvjax.study import Study, kind_of


def figures(study: Study, found: Designed) -> Iterator[Figure]:
    """Draw the figures of a result.

    Args:
        study: with variables.
        found: result of the command.
    """
    if drawing := kind_of(study.design).drawing:
        yield Figure("section", drawing.comparison, lambda: drawing.compared(study.design, found.joint.design))
    if found.front:

        def front() -> Any:
            from rvjax import plotting

            def place(point: Point) -> tuple[float, float]:
                return point.priced(study), point.of_tolerances(study)

            points = [*(point for point in found.front if point.certified), found.joint]
            before = sum(price(found.start[name]) for name, price in study.objective.items()), _start(study)
            others = {_named("study, before", found.joint.found.start_cost >= found.joint.found.cost): before}
            if (first := found.two_step) is not None:
                others[_named("geometry first", first.found.feasible)] = place(first)
            return plotting.trade_front(
                [place(point) for point in points],
                uncertified=[place(point) for point in found.front if not point.certified],
                chosen=place(found.joint),
                others=others,
                label=", ".join(name.replace("_", " ") for name in study.objective),
            )

        yield Figure("front", "Cost of the tolerances against the priced outputs, at the prices of the study", front)


def _named(name: str, meets: bool) -> str:
    """A point that costs less than the optimum, or is infeasible, misses a limit: its place shows no gain."""
    return name if meets else f"{name}, misses limits"


def _start(study: Study) -> float:
    """Cost of the tolerances of the study."""
    return sum(float(cost(getattr(study.tolerances, name).half_width)) for name, cost in study.costs.items())
