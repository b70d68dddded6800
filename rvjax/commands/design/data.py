"""Result of `rvjax design` as JSON values, SI."""

from typing import Any

from rvjax.base.files import versions
from rvjax.commands.cells import limits_data
from rvjax.commands.design.compute import Designed, Point
from rvjax.commands.design.prices import slope
from rvjax.study import Study


def data(study: Study, found: Designed) -> dict[str, Any]:
    """The result as JSON values.

    Args:
        study: solved study.
        found: its result.
    """
    joint = found.joint.found
    return {
        "study": study.name,
        "about": study.about,
        "status": joint.status,
        "feasible": joint.feasible,
        "reason": joint.reason,
        "seed": study.seed,
        "samples": study.samples,
        "versions": versions(),
        "cost": {"before": joint.start_cost, "after": joint.cost},
        "values": joint.values,
        "bounds_active": joint.bounds_active,
        "value_prices": joint.value_prices,
        "ranges": joint.ranges,
        "multipliers": joint.multipliers,
        "multiplier_intervals": joint.multiplier_intervals,
        "starts": joint.starts,
        "shortfall": joint.shortfall,
        "tolerances": {
            field: {"unit": study.unit(field), "after": limits_data(study, field, getattr(joint.tolerances, field))}
            | ({"price": -slope(study, found.joint, field)} if field in joint.costs else {})
            for field in study.fields
        },
        "joint": _point(study, found.joint),
        "two_step": _point(study, found.two_step),
        "fixed_in_the_first_step": found.fixed,
        "without_scaling_laws": _point(study, found.unscaled),
        "front": [_point(study, point) for point in found.front],
        "scaling_laws": [
            dict(name=law.name, numbers=followers, follows=law.follows, interval=law.interval, source=law.source)
            for law, followers in found.laws
        ],
        "certificate": joint.certificate,
    }


def _point(study: Study, point: Point | None) -> dict[str, Any] | None:
    if point is None:
        return None
    found = point.found
    return {
        "status": found.status, "cost": found.cost, "tolerance_cost": point.of_tolerances(study),
        "priced_outputs": point.priced(study), "values": found.values, "half_widths": found.half_widths,
        "outputs_without_errors": point.outputs, "price_factor": point.factor,
    }  # fmt: skip
