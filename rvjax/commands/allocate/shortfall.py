"""Limits that cannot be met: the limit that can, and the assumed value that prevents it."""

import dataclasses
import math

from rvjax.commands.sections.cells import limit_text
from rvjax.life import dynamic_rating
from rvjax.outputs import Output
from rvjax.population import deviate_of
from rvjax.study import Study
from rvjax.tolerances import Allocation, Requirement, Statistics
from rvjax.units import with_unit

LIVES = ("life", "arm_bearing_life")
CONFIDENCE = 0.95  # of certificates
EXPONENT = 10 / 3  # of a bearing life in the rating C, ISO 281


def shortfall_text(shortfall: float, output: Output) -> str:
    """Text on a limit that cannot be met, with the distance to the limit that could be met.

    Args:
        shortfall: by how much it is missed, SI.
        output: what is limited.
    """
    if math.isinf(shortfall):
        return "cannot be met: too many units fail"
    unit, size = output.shown
    return f"would have to move by {with_unit(shortfall / size, unit)}"


def shortfalls(study: Study, allocation: Allocation) -> dict[str, str]:
    """Text on each limit that cannot be met at the finest tolerances, or is not certified, by response.

    Args:
        study: solved study.
        allocation: its result.
    """
    missing = {name: found for name, found in allocation.shortfall.items() if found > 0}
    if allocation.feasible and allocation.status == "NOT_CERTIFIED":
        missing = _uncertified(study, allocation.certificate)
    return {name: _text(study, name, found) for name, found in missing.items()}


def _uncertified(study: Study, certificate: Statistics) -> dict[str, float]:
    """Distance by which each limit of a share must move so that the units of a certificate prove its target."""
    found = dict[str, float]()
    for name, verdict in (certificate.verdicts or {}).items():
        limits = study.requirements[name]
        if not verdict.met and isinstance(limits, Requirement) and certificate.values is not None:
            margin = limits.certified_margin(certificate.values[name], deviate_of(CONFIDENCE))
            if 0 < margin < math.inf:
                found[name] = margin
    return found


def _text(study: Study, name: str, missing: float) -> str:
    output, limits = study.output(name), study.requirements[name]
    text = shortfall_text(missing, output)
    if math.isinf(missing) or (math.isfinite(limits.lower) and math.isfinite(limits.upper)):
        return text  # of two limits either may be missed
    moved = limit_text(dataclasses.replace(limits, lower=limits.lower - missing, upper=limits.upper + missing), output)
    text += f": {moved} can be met"
    if name in LIVES and 0 < missing < limits.lower and any(path.startswith("bearings.") for path in study.assumed):
        times = (limits.lower / (limits.lower - missing)) ** (1 / EXPONENT)
        rating = float(dynamic_rating(study.design.bearings.arm)) / 1e3
        return (
            f"{text}; the assumed crank bearings prevent it: {times:.3g} times their rating C would do (bearings.arm: "
            f"{times * rating:.3g} kN instead of {rating:.3g} kN)"
        )
    if name in study.assumed_limits:
        return f"{text}; the assumed limit prevents it: {moved} would do"
    return text
