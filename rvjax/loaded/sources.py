"""Results that several outputs read: a revolution of the loaded reducer under one of three torques."""

from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.conditions import Conditions, ways
from rvjax.loaded.revolution import Revolution, revolution
from rvjax.loaded.torsion import SHARES

RATED, HALF, SLIGHT, PROBE = SHARES


def turns_of(design: RVReducer, given: Conditions) -> float:
    """Turns of the output in the span."""
    return 1.0 if given.span == "output_turn" else 1 / design.cycloid.pin_count


def _along(design: RVReducer, errors: RVErrors, given: Conditions, torque: float) -> Revolution:
    turns = turns_of(design, given)
    return revolution(
        errors.stiffened(design), errors, output_torque=torque, turns=turns, samples=given.samples, **ways(given)
    )


def turn(design: RVReducer, errors: RVErrors, given: Conditions) -> Revolution:
    """Along the span under the output torque."""
    return _along(design, errors, given, given.output_torque)


def second_turn(design: RVReducer, errors: RVErrors, given: Conditions) -> Revolution:
    """Along the span under the second torque."""
    return _along(design, errors, given, given.second_torque)


def unloaded_turn(design: RVReducer, errors: RVErrors, given: Conditions) -> Revolution:
    """Along the span at the probe torque: the limit of no load."""
    return _along(design, errors, given, PROBE * given.rated_torque)
