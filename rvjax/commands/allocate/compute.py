"""The answer to a study, unless a folder holds it."""

from rvjax.commands import forecast
from rvjax.commands.allocate.inputs import Inputs
from rvjax.commands.speak import READING, WRITING
from rvjax.study import Answer, answer


def phases(asked: Inputs) -> dict[str, float]:
    """Phases of the command with their seconds.

    Args:
        asked: what is computed.
    """
    return forecast.phases_of(asked.study, READING, WRITING) if asked.kept is None else {}


def compute(asked: Inputs) -> Answer | None:
    """The answer, which also solves the unit without errors; None where it is kept."""
    return answer.answer(asked.study, progress=not asked.quiet, memo=asked.memo) if asked.kept is None else None
