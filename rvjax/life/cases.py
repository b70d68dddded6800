"""Random units on which the levels of the bearing life are measured, each method with levels of its own.

Lives of different methods differ by design, so no method is a level of another: a study with another method is another
question. A level is a number of angles round the turn of the output.
"""

from collections.abc import Sequence

from rvjax.catalogue import RV_40E
from rvjax.errors import RVErrors, read_by
from rvjax.life.histories import METHODS
from rvjax.loaded import MACHINE, RATED, WHOLE
from rvjax.outputs import Cases, Way
from rvjax.units import rpm

DUTY = ((RATED, 15 * rpm, 3600.0),)  # the rating point of catalogues
ANGLES = {"basic": (12, 24, 48, 96), "raceway": (24, 96), "slices": (12, 48)}  # the last: the reference
OUTPUTS = {"life": "s", "arm_bearing_life": "s", "static_safety": "-"}


def cases(quick: bool) -> Sequence[Cases]:
    """Units of the RV-40E at its rating point, by method; none in a quick run, where compiling takes longest.

    Args:
        quick: no levels.
    """
    return [] if quick else [_cases(method) for method in METHODS]


def _cases(method: str) -> Cases:
    unread = tuple(field for field in read_by(RVErrors, "loaded") if field not in WHOLE)
    return Cases(
        name=f"life_{method}",
        case=f"unit of the RV-40E at 412 N m, a revolution of the output, {method}",
        outputs=OUTPUTS,
        design=MACHINE.replace(bearings=RV_40E.bearings),
        errors=WHOLE,
        conditions=dict(duty=DUTY, reliability=0.9, pin_contact="hertz", carrier="fixed", sun="fixed"),
        torque=None,
        ways=tuple(Way(f"{method}, {n} angles", {"life_samples": n}, ("float64",)) for n in ANGLES[method]),
        batch=64,
        calls=2,
        question={"life_method": method},
        others=(*unread, "contact.pin_stiffness", "contact.pin_support"),
        timed=256,
    )
