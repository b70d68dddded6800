"""Standard tolerance grades of ISO 286-1: the width of a tolerance zone by grade and nominal size."""

import math

from rvjax._jax.checks import checked
from rvjax.records import Scalar, quantity
from rvjax.units import mm, um

GRADES = tuple(f"IT{number}" for number in ("01", "0", *range(1, 12)))
"""Finest first."""

# ISO 286-1, Table 1, widths in um. The standard rounds its own formula unevenly, so the table counts.
_WIDTHS = {  # sizes up to and including, in mm
    3: (0.3, 0.5, 0.8, 1.2, 2, 3, 4, 6, 10, 14, 25, 40, 60),
    6: (0.4, 0.6, 1, 1.5, 2.5, 4, 5, 8, 12, 18, 30, 48, 75),
    10: (0.4, 0.6, 1, 1.5, 2.5, 4, 6, 9, 15, 22, 36, 58, 90),
    18: (0.5, 0.8, 1.2, 2, 3, 5, 8, 11, 18, 27, 43, 70, 110),
    30: (0.6, 1, 1.5, 2.5, 4, 6, 9, 13, 21, 33, 52, 84, 130),
    50: (0.6, 1, 1.5, 2.5, 4, 7, 11, 16, 25, 39, 62, 100, 160),
    80: (0.8, 1.2, 2, 3, 5, 8, 13, 19, 30, 46, 74, 120, 190),
    120: (1, 1.5, 2.5, 4, 6, 10, 15, 22, 35, 54, 87, 140, 220),
    180: (1.2, 2, 3.5, 5, 8, 12, 18, 25, 40, 63, 100, 160, 250),
    250: (2, 3, 4.5, 7, 10, 14, 20, 29, 46, 72, 115, 185, 290),
    315: (2.5, 4, 6, 8, 12, 16, 23, 32, 52, 81, 130, 210, 320),
    400: (3, 5, 7, 9, 13, 18, 25, 36, 57, 89, 140, 230, 360),
    500: (4, 6, 8, 10, 15, 20, 27, 40, 63, 97, 155, 250, 400),
}


@checked
def it_width(grade: str, size: Scalar) -> float:
    """Width of the tolerance zone, m; the limits of a centred zone are +- half of it.

    ISO 286-1, Table 1.

    Args:
        grade: "IT01", "IT0", "IT1" ... "IT11".
        size: nominal size, m, above 0 and up to 500 mm; a size step includes its upper end.

    Raises:
        ValueError: unknown grade, or a size outside the table.
    """
    if not isinstance(grade, str) or grade not in GRADES:
        raise ValueError(f"grade = {grade!r}: unknown, the table holds {', '.join(GRADES)}")
    in_mm = float(size) / mm
    if not 0 < in_mm <= 500 * (1 + 1e-12):
        raise ValueError(f"size = {quantity(size, 'm')}: the table of grades covers sizes above 0 and up to 0.5 m")
    # 0.03 m / mm is 30.000000000000004 in floating point and still belongs to the step "up to 30 mm".
    step = next(end for end in _WIDTHS if in_mm <= end or math.isclose(in_mm, end, rel_tol=1e-12))
    return _WIDTHS[step][GRADES.index(grade)] * um


def coarsest_grade(width: float, size: float) -> str:
    """Coarsest grade whose tolerance zone is not wider than a width, "" for none or a size outside the table.

    ISO 286-1, Table 1.

    Args:
        width: of the tolerance zone, m.
        size: nominal size, m.
    """
    inside = 0 < size <= 500 * mm
    return next((g for g in reversed(GRADES) if inside and it_width(g, size) <= width * (1 + 1e-9)), "")


def tolerance_unit(diameter: Scalar) -> Scalar:
    """Tolerance unit i of ISO 286-1, m.

    Args:
        diameter: nominal size, m.
    """
    size = diameter / mm
    return um * (0.45 * size ** (1 / 3) + 0.001 * size)
