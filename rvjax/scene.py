"""What a question needs: from the outputs asked for to one function of the errors that computes just those.

An output is one scalar of one unit. Statistics and allocation see the resulting response
`errors -> Outcome` and know nothing of gears; the models know nothing of statistics.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp

from rvjax import four_bar
from rvjax.designs import RVReducer
from rvjax.status import Status, worst
from rvjax.tolerances import Outcome


@dataclass(frozen=True)
class Conditions:
    """How the reducer runs while it is judged.

    Attributes:
        output_torque: torque of the discs on the carrier, N m.
        angles: uniform crank angles over one crank turn.
        cranks: "phase_locked", "geared" or "free".
        gear_stiffness_ratio: stiffness of the gears between the cranks, for geared cranks.
    """

    output_torque: float = 0.0
    angles: int = 64
    cranks: str = "phase_locked"
    gear_stiffness_ratio: float | None = None


@dataclass(frozen=True)
class Output:
    """One scalar of one unit.

    Attributes:
        unit: SI unit.
        meaning: one line.
        evaluate: (design, errors, conditions) -> (value, status).
    """

    unit: str
    meaning: str
    evaluate: Callable[[Any, Any, Conditions], tuple[Any, Any]]


def turn(design: RVReducer, errors: Any, conditions: Conditions, *, loaded: bool = True) -> Any:
    """One crank turn of one unit, under the load of `conditions` or without it."""
    return four_bar.revolution(
        design,
        errors,
        angles=conditions.angles,
        output_torque=conditions.output_torque if loaded else 0.0,
        cranks=conditions.cranks,
        gear_stiffness_ratio=conditions.gear_stiffness_ratio,
    )


def _transmission_error(design: RVReducer, errors: Any, conditions: Conditions) -> tuple[Any, Any]:
    result = turn(design, errors, conditions)
    return result.peak_to_peak, result.info.status


def _misfit(design: RVReducer, errors: Any, conditions: Conditions) -> tuple[Any, Any]:
    result = turn(design, errors, conditions, loaded=False)
    return jnp.max(jnp.abs(result.misfit)), result.info.status


OUTPUTS = {
    "transmission_error": Output("rad", "transmission error, peak to peak over a crank turn", _transmission_error),
    "misfit": Output("m", "largest misfit of a disc on the cranks without load (assembly)", _misfit),
}


def response(design: Any, outputs: Sequence[str], conditions: Conditions) -> Callable[[Any], Outcome]:
    """The function errors -> Outcome({output: value}, status) of one unit, with no output but those asked for.

    The same question gives the same function again, so that what was compiled for it is used again.

    Args:
        design: the reducer.
        outputs: names in `OUTPUTS`.
        conditions: how the reducer runs.

    Raises:
        ValueError: an output that does not exist.
    """
    for name in outputs:
        if name not in OUTPUTS:
            raise ValueError(f"unknown response {name!r}; there are {', '.join(OUTPUTS)}")
    return _response(design, tuple(outputs), conditions)


@cache
def _response(design: Any, outputs: tuple[str, ...], conditions: Conditions) -> Callable[[Any], Outcome]:
    def evaluate(errors: Any) -> Outcome:
        found = {name: OUTPUTS[name].evaluate(design, errors, conditions) for name in outputs}
        statuses = jnp.stack([jnp.asarray(status) for _, status in found.values()])
        return Outcome({name: value for name, (value, _) in found.items()}, worst(statuses))

    return evaluate


def check_nominal(response: Callable[[Any], Outcome], errors: Any) -> None:
    """Refuse a question whose error-free unit already fails.

    Raises:
        ValueError: names the status.
    """
    status = Status(int(jax.jit(lambda e: response(e).status)(errors)))
    if status not in (Status.CONVERGED, Status.UNLOADED):
        raise ValueError(f"the linkage without errors cannot be solved: {status.name}")
