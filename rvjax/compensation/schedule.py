"""Corrections over torque and direction: a part of the error grows with the load, and the directions differ."""

import dataclasses
import math
from collections.abc import Hashable, Mapping

import numpy as np

from rvjax._jax.checks import checked
from rvjax.compensation.correction import Correction, rated, saved_by


@dataclasses.dataclass(frozen=True, eq=False)
class Schedule:
    """Corrections measured at some torques in some directions.

    Attributes:
        corrections: {direction: ((torque in N m, correction), ...)}, torques ascending.
    """

    corrections: dict[Hashable, tuple[tuple[float, Correction], ...]]

    def at(self, torque: float, direction: Hashable) -> Correction:
        """The correction at a load: linear in the torque for each complex order, held beyond the measured torques.

        Args:
            torque: N m.
            direction: as given; nothing is taken from another one.

        Raises:
            ValueError: a direction that was not measured, or a torque that is not finite.
        """
        if direction not in self.corrections:
            known = ", ".join(map(repr, self.corrections))
            raise ValueError(f"direction = {direction!r}: must be measured; measured are {known}")
        if not math.isfinite(torque):
            raise ValueError(f"torque = {torque!r} N m: must be finite")
        measured = self.corrections[direction]
        torques = [at for at, _ in measured]
        above = int(np.clip(np.searchsorted(torques, torque), 1, max(len(torques) - 1, 1)))
        if len(torques) == 1 or torque <= torques[0]:
            return measured[0][1]
        if torque >= torques[-1]:
            return measured[-1][1]
        (low, first), (high, second) = measured[above - 1], measured[above]
        return _between(first, second, (torque - low) / (high - low))


def _between(first: Correction, second: Correction, share: float) -> Correction:
    """Weighted mean of two measurements with independent errors. An order that one of them lacks is 0 there."""
    order = np.union1d(first.given_order, second.given_order)
    value, stored, variance = np.zeros(len(order), complex), np.zeros(len(order), complex), np.zeros(len(order))
    for weight, side in ((1 - share, first), (share, second)):
        place = np.searchsorted(order, side.given_order)
        value[place] += weight * side.given_value
        stored[place] += weight * side.stored
        variance[place] += (weight * side.sd) ** 2
    angle_sd = max(first.angle_sd, second.angle_sd)
    chosen = np.flatnonzero(np.isin(order, np.union1d(first.order, second.order)))
    saved = saved_by(value, stored, order, angle_sd)
    return rated(order, value, stored, np.sqrt(variance), angle_sd, first.ratio, chosen, saved)


@checked
def schedule(corrections: Mapping[tuple[float, Hashable], Correction]) -> Schedule:
    """Corrections by torque and direction.

    Args:
        corrections: {(torque in N m, direction): correction}; a direction is any name or sign.

    Raises:
        ValueError: none at all, a torque that is not finite, or different ratios.
    """
    if not corrections:
        raise ValueError("corrections: must hold at least one")
    for key, found in corrections.items():
        if not isinstance(found, Correction):
            raise ValueError(f"corrections: {key!r} = {found!r}: must be a Correction")
    ratios = {found.ratio for found in corrections.values()}
    if len(ratios) > 1:
        raise ValueError(f"ratio: corrections must have one ratio, not {', '.join(f'{r:g}' for r in sorted(ratios))}")
    by_direction: dict[Hashable, list[tuple[float, Correction]]] = {}
    for (torque, direction), found in corrections.items():
        if not math.isfinite(torque):
            raise ValueError(f"torque = {torque!r} N m: must be finite")
        by_direction.setdefault(direction, []).append((float(torque), found))
    return Schedule({direction: tuple(sorted(all_, key=lambda x: x[0])) for direction, all_ in by_direction.items()})
