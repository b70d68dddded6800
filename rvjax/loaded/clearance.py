"""Least clearance between flanks and pins along a turn, without load: does the reducer turn freely, or does it jam?"""

from rvjax._jax.programs import quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import RVReducer, expect
from rvjax.errors import RVErrors
from rvjax.loaded.inputs import check_teeth
from rvjax.loaded.kinds import KINDS, check_kind, kind_of
from rvjax.records import Array, PyTree, Record, field, record
from rvjax.status import SolveInfo


@record
class Clearance(Record):
    """Clearance along a turn."""

    least: Array = field("m", "least clearance of any pin, discs turned to where it is largest; < 0: the reducer jams")
    at: Array = field("m", "the same at each input angle", shape=("n",))
    info: SolveInfo = field("-", "residual: m, between two bounds of the value", kind="record")


@checked
def clearance(
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
    *,
    turns: float | None = None,
    samples: int = 48,
) -> Clearance:
    """Least clearance between flanks and pins along a turn of the output, without load.

    RV reducer: cranks, bearings and bores are ideal; what they take is the `misfit` of the discs. Single-stage drive:
    pins in holes count too, discs sit on their eccentrics, and bearing clearance does not help.

    Args:
        design: involute teeth and cycloid stage are read.
        errors: of pins, ring and discs.
        turns: of the output, by default one crank turn, 1 / pin_count.
        samples: n, angle j at input angle 2 pi ratio turns j / n.

    Returns:
        Clearance. NaN with status NONFINITE (a number that is read is NaN or inf), INVALID_GEOMETRY (K1 outside (0, 1)
        or a radius that is not positive) or UNDERCUT.

    Raises:
        ValueError: another kind of design or of errors, another tooth difference than one, or samples < 1.
    """
    expect(design, "loaded.clearance", *KINDS)
    cycloid = design.cycloid
    check_teeth(cycloid)
    check_kind(design, errors)
    if samples < 1:
        raise ValueError(f"samples = {samples}: must be at least 1")
    return _clearance(samples, 1 / cycloid.pin_count if turns is None else turns, design, errors)


@quick(0, 1)
def _clearance(samples: int, turns: float, design: PyTree, errors: PyTree) -> Clearance:
    (least, found), info = kind_of(design).fit(samples, turns, design, errors)
    return Clearance(least, found, info)
