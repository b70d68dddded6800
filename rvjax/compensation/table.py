"""Corrections for a controller: equal steps over one output turn, interpolated linearly, and over torque and direction.

A part of the error grows with the load, and the directions differ.
"""

import dataclasses
import math
from collections.abc import Hashable, Mapping

import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.words import choose
from rvjax.compensation.correction import Correction, rated, saved_by

SIDES = ("input", "output")


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """Rows of angle and correction; the last row is the first row, one turn later.

    Attributes:
        angle: of the output, rad, 0 to 2 pi (points + 1,).
        correction: added at the side chosen, rad (points + 1,).
        error_bound: largest error of linear interpolation, rad at that side; nan where a file does not hold it.
        name: in files.
        ratio: input turns per output turn; nan where a file does not hold it.
        orders: stored, per output turn; empty where a file does not hold them.
    """

    angle: np.ndarray
    correction: np.ndarray
    error_bound: float
    name: str = "te_correction"
    ratio: float = math.nan
    orders: tuple[int, ...] = ()


@checked
def table(correction: Correction, points: int = 720, *, side: str = "input") -> Table:
    """Sample a correction.

    Between rows, order k of a line is wrong by at most |v_k| (1 - cos(pi k/points)).

    Args:
        correction: of one unit.
        points: equal steps of the output angle; the row at 2 pi comes on top.
        side: "input" (times the ratio) or "output".

    Raises:
        ValueError: fewer than 2 max(order) + 1 points, or an unknown side.
    """
    least = 2 * int(correction.order.max(initial=0)) + 1
    if points < least:
        raise ValueError(f"points = {points!r}: must be at least {least}, twice the highest order and one")
    choose("side", side, SIDES)
    factor = correction.ratio if side == "input" else 1.0
    # An order turns by 2 pi k i/points; k i is reduced to one turn in integers, so that no digit is lost.
    steps = np.arange(points)
    phase = 2 * math.pi / points * ((correction.order[:, None] * steps) % points)
    value = correction.value[:, None]
    rows = factor * np.sum(value.imag * np.sin(phase) - value.real * np.cos(phase), axis=0)
    bound = np.sum(np.abs(correction.value) * 2 * np.sin(math.pi * correction.order / (2 * points)) ** 2)
    return Table(
        angle=np.append(2 * math.pi / points * steps, 2 * math.pi),
        correction=np.append(rows, rows[0]),
        error_bound=abs(factor) * float(bound),
        ratio=correction.ratio,
        orders=tuple(correction.order.tolist()),
    )


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
    for key, correction in corrections.items():
        if not isinstance(correction, Correction):
            raise ValueError(f"corrections: {key!r} = {correction!r}: must be a Correction")
    ratios = {correction.ratio for correction in corrections.values()}
    if len(ratios) > 1:
        raise ValueError(f"ratio: corrections must have one ratio, not {', '.join(f'{r:g}' for r in sorted(ratios))}")
    by_direction: dict[Hashable, list[tuple[float, Correction]]] = {}
    for (torque, direction), correction in corrections.items():
        if not math.isfinite(torque):
            raise ValueError(f"torque = {torque!r} N m: must be finite")
        by_direction.setdefault(direction, []).append((float(torque), correction))
    return Schedule({direction: tuple(sorted(all_, key=lambda x: x[0])) for direction, all_ in by_direction.items()})
