"""Result of a study, computed or read from a results folder."""

from rvjax.commands.allocate import answer
from rvjax.commands.allocate.answer import Answer
from rvjax.commands.allocate.forecast import phases_of, seconds_of_units
from rvjax.commands.allocate.inputs import Inputs
from rvjax.commands.speak import READING, WRITING, tell, units_placed


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return phases_of(READING, WRITING) if inputs.kept is None else ()


def compute(inputs: Inputs) -> Answer | None:
    """Compute the result and solve the unit without errors; None if the result is stored."""
    if inputs.kept is not None:
        return None
    with units_placed(lambda: seconds_of_units(inputs.study)) as device:
        tell(device)
        return answer.answer(inputs.study, progress=not inputs.quiet, memo=inputs.memo, measure=inputs.measure)
