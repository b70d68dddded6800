"""Figures of `rvjax design`: the section to scale before and after, the trade front."""

from collections.abc import Iterator
from typing import Any

from rvjax.commands.design.compute import Designed
from rvjax.designs import RVReducer
from rvjax.render import Figure
from rvjax.study import Study


def figures(study: Study, found: Designed) -> Iterator[Figure]:
    """Draw the figures of a result.

    Args:
        study: with variables.
        found: result of the command.
    """
    if isinstance(study.design, RVReducer):

        def section() -> Any:
            from rvjax.plotting import drawings

            return drawings.before_and_after(study.design, found.joint.design)

        yield Figure("section", "Section of the second stage, drawn to scale, before and after", section)
    if found.front:

        def front() -> Any:
            from rvjax import plotting

            points = [*found.front, found.joint]
            others = [("geometry first", found.two_step)] if found.two_step else []
            return plotting.trade_front(
                [(point.priced(study), point.of_tolerances(study)) for point in points],
                chosen=(found.joint.priced(study), found.joint.of_tolerances(study)),
                others={name: (point.priced(study), point.of_tolerances(study)) for name, point in others},
                start=(sum(price(found.start[name]) for name, price in study.objective.items()), _start(study)),
                label=", ".join(name.replace("_", " ") for name in study.objective),
            )

        yield Figure("front", "Cost of the tolerances against the priced outputs, at the prices of the study", front)


def _start(study: Study) -> float:
    """Cost of the tolerances of the study."""
    return sum(float(cost(getattr(study.tolerances, name).half_width)) for name, cost in study.costs.items())
