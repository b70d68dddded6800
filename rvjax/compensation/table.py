"""A correction as equal steps over one output turn, which a controller interpolates linearly."""

import dataclasses
import math

import numpy as np

from rvjax._jax.checks import checked
from rvjax.base.words import choose
from rvjax.compensation.correction import Correction

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
