"""Figures of Liu et al. 2022 (Mech. Sci. 13, 855) on the lost motion of the RV-20E.

The printed total, 0.5467 arcmin, follows only from Eq. 16 and 21 to the letter, where nine terms in radians
are added to others in arcminutes; with one unit throughout the same input gives 1.757 arcmin.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import jax

from rvjax.catalogue import RV_20E, RV_20E_ERRORS
from rvjax.designs import InvoluteStage
from rvjax.lost_motion import geometric, shaft_tilt
from rvjax.lost_motion.terms import Teeth
from rvjax.units import arcmin, deg, mm, um

RATIO = Teeth(
    float(RV_20E.involute.sun_teeth),
    float(RV_20E.involute.planet_teeth),
    float(RV_20E.cycloid.disc_teeth),
    float(RV_20E.cycloid.pin_count),
).ratio
FROM_MODULE = InvoluteStage.from_teeth(12, 42, module=1.5 * mm)  # what Table 8 would be by its own module
SHAFT_LENGTHS = (160 * mm, 120 * mm)  # Section 2: output, input shaft

# Table 5: output torque (N m), deflection of the output shaft and of the input shaft (mm).
TABLE_5 = (
    (200, 0.0042626, 0.000072051),
    (190, 0.0040486, 0.000067906),
    (180, 0.0038346, 0.000064796),
    (170, 0.0036207, 0.000060649),
    (160, 0.0034067, 0.000057021),
    (150, 0.0031927, 0.000053393),
    (140, 0.0029788, 0.000049765),
    (130, 0.0027648, 0.000046136),
    (120, 0.0025508, 0.000042508),
    (110, 0.0023369, 0.000038879),
    (100, 0.0021229, 0.000034733),
    (90, 0.0019089, 0.000031105),
    (80, 0.0016945, 0.000027477),
    (70, 0.00148105, 0.000023848),
    (60, 0.0012665, 0.000020215),
    (50, 0.0010531, 0.000016074),
    (40, 0.00083909, 0.000012446),
    (30, 0.00062512, 0.0000088175),
    (20, 0.00041115, 0.0000051894),
    (10, 0.00019718, 0.0000015612),
)
TABLE_10 = (0.5462, 0.5976, 0.5982, 0.6018, 0.6029, 0.6032, 0.6063)  # printed totals, arcmin
TABLE_10_TORQUES = (50, 80, 110, 140, 170, 200)  # N m, rows 2 to 7


def _total(**options: Any) -> float:
    return float(geometric(RV_20E, RV_20E_ERRORS, **options).total) / arcmin


_printed_total = partial(_total, reading="as_printed")


def _tilts(row: tuple[float, float, float]) -> list[float]:
    return [float(shaft_tilt(deflection * mm, length)) / deg for deflection, length in zip(row[1:], SHAFT_LENGTHS)]


def _tilt_effect() -> float:
    """Largest input tilt of Table 10 and largest displacement of Section 3.2 against none, arcmin."""
    return _printed_total(tilt=3.44e-5 * deg, centre_shift=4.5 * um) - _printed_total()


def _eccentricity_coefficient() -> float:
    """K_n of Eq. 17, 1/mm: the eccentricity term is -2 K_n delta e."""
    term = geometric(RV_20E, RV_20E_ERRORS).terms.eccentricity
    return float(term) / (-2 * RV_20E_ERRORS.eccentricity) * mm


def _pressure_angle_exists() -> bool:
    """With the force that returns 0.5467 arcmin, the cosine of Eq. 11 exceeds 1."""
    return bool(geometric(RV_20E, RV_20E_ERRORS, reading="as_printed", normal_force=0.5075).valid)


def _planet_radius_as_printed() -> bool:
    centre_distance, z1, z2 = 27.5, 12, 42
    return math.isclose(centre_distance * z2 * (z1 + z2), centre_distance * z2 / (z1 + z2))


def _printed_terms_have_one_unit() -> bool:
    printed, consistent = (geometric(RV_20E, RV_20E_ERRORS, reading=r).terms for r in ("as_printed", "consistent"))
    pairs = zip(jax.tree.leaves(printed), jax.tree.leaves(consistent))
    return all(math.isclose(float(a), float(b), rel_tol=1e-9, abs_tol=1e-18) for a, b in pairs)


def _terms_add_up() -> bool:
    result = geometric(RV_20E, RV_20E_ERRORS)
    return math.isclose(sum(float(t) for t in jax.tree.leaves(result.terms)), float(result.total), rel_tol=1e-12)


def _contact_stiffness() -> float:
    """Eq. 22 with its minus sign as printed, N/mm^1.5; no part of the model (an external pair needs plus)."""
    radius, modulus = 1 / (1 / 9 - 1 / 31.5), 206e3 / (2 * (1 - 0.3**2))
    return 4 / 3 * math.sqrt(radius) * modulus


def _steps_are_irregular() -> bool:
    steps = [b - a for a, b in pairwise(TABLE_10)]
    return steps not in (sorted(steps), sorted(steps, reverse=True))


COMPUTED: dict[str, Callable[[], Any]] = {
    "rv20e.table8.ratio": lambda: RATIO,
    "rv20e.eq3.cycloid_ratio": lambda: math.isclose(1 + 1 / 39, 40 / 39),  # carrier held: crank +1, disc -1/39
    "rv20e.sec5_1.speeds": lambda: RATIO * 1.0,
    "rv20e.table8.curtate_ratio": lambda: RV_20E.cycloid.replace(shortening=None).shortening_coefficient,
    "rv20e.table8.centre_distance": lambda: FROM_MODULE.centre_distance / mm,
    "rv20e.table8.sun_radius": lambda: FROM_MODULE.sun_radius / mm,
    "rv20e.eq6.planet_radius": _planet_radius_as_printed,
    "rv20e.eq11.pressure_angle": _pressure_angle_exists,
    "rv20e.eq16.single_unit": _printed_terms_have_one_unit,
    "rv20e.eq17.coefficient": _eccentricity_coefficient,
    "rv20e.eq21.bearing_once": _terms_add_up,
    "rv20e.table7.contact_stiffness": _contact_stiffness,
    "rv20e.abstract.total": _printed_total,
    "rv20e.sec5_2.total": _printed_total,
    "rv20e.abstract.model_verified": _total,
    **{f"rv20e.table5.row{n:02d}": partial(_tilts, row) for n, row in enumerate(TABLE_5, 1)},
    "rv20e.table5.input_torque": lambda: [row[0] / RATIO for row in TABLE_5],
    "rv20e.table10.row1": _printed_total,
    **{
        f"rv20e.table10.row{n}_tilt": partial(_tilts, next(row for row in TABLE_5 if row[0] == torque))
        for n, torque in enumerate(TABLE_10_TORQUES, 2)
    },
    "rv20e.table10.tilt_effect": _tilt_effect,
    "rv20e.table10.increasing": lambda: list(TABLE_10) == sorted(set(TABLE_10)),
    "rv20e.table10.irregular": _steps_are_irregular,
    "rv20e.conclusion.main_factor": lambda: abs(_tilt_effect()) > 0.01 * abs(_total()),
}

RIGHT: dict[str, Callable[[], Any]] = {
    "rv20e.abstract.total": _total,
    "rv20e.sec5_2.total": _total,
}
