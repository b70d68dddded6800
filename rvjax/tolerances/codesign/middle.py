"""Mid-points of limits that may move: they belong to the nominal value, such as a modification of the profile."""

import dataclasses
import math
from collections.abc import Mapping

from rvjax.arguments import number
from rvjax.population import Tolerance


@dataclasses.dataclass(frozen=True)
class Middle:
    """Limits of the mid-point of an error's limits.

    Attributes:
        lower: least mid-point, unit of the error.
        upper: largest mid-point.
        scale: cost of moving by one unit of the error (SI) from the given mid-point, either way; 0 by default.
    """

    lower: float
    upper: float
    scale: float = 0.0

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "scale"):
            number(f"Middle.{name}", getattr(self, name))
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower <= self.upper):
            raise ValueError(f"Middle.lower = {self.lower!r}, upper = {self.upper!r}: must be finite and ascend")
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"Middle.scale = {self.scale!r}: must be finite and not negative")


def check_middles(middles: Mapping[str, Middle], active: Mapping[str, Tolerance]) -> None:
    """Raise ValueError for mid-points that cannot move.

    Raises:
        ValueError: names the field.
    """
    for name, item in middles.items():
        if name not in active:
            raise ValueError(f"middles: {name!r} has no tolerance; these have: {', '.join(active)}")
        if not isinstance(item, Middle):
            raise ValueError(f"middles: {name} = {item!r} must be a Middle")
        law = active[name].law
        if law.of_vectors or law.name == "empirical":
            raise ValueError(f"middles: {name}: the distribution {law.name} does not move with its limits")
