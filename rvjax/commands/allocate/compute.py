"""Result of a study, computed or read from a results folder."""

from rvjax.commands import forecast
from rvjax.commands.allocate import answer
from rvjax.commands.allocate.answer import Answer
from rvjax.commands.allocate.inputs import Inputs
from rvjax.commands.speak import READING, WRITING


def phases(asked: Inputs) -> dict[str, float]:
    """Phases of the command with their seconds.

    Args:
        asked: what is computed.
    """
    return forecast.phases_of(asked.study, READING, WRITING) if asked.kept is None else {}


def compute(asked: Inputs) -> Answer | None:
    """Compute the result and solve the unit without errors; None if the result is stored."""
    if asked.kept is not None:
        return None
    return answer.answer(asked.study, progress=not asked.quiet, memo=asked.memo, measure=asked.measure)
