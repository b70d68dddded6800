"""Both sides of a requirement, and the size of a limit."""

import dataclasses
import math

from rvjax.tolerances.requirements.limits import Limits


def sides(item: Limits) -> list[Limits]:
    """The limits one by one, where the margin of both has a corner."""
    if math.isinf(item.lower) or math.isinf(item.upper):
        return [item]
    return [dataclasses.replace(item, lower=-math.inf), dataclasses.replace(item, upper=math.inf)]


def size(item: Limits) -> float:
    """Size of a limit."""
    return abs(item.lower if math.isinf(item.upper) else item.upper)
