"""Result of a study, computed or read from a results folder."""

from dataclasses import dataclass

from rvjax.commands.allocate import answer
from rvjax.commands.allocate.answer import Answer
from rvjax.commands.allocate.figures import figures
from rvjax.commands.allocate.forecast import phases_of, seconds_of_units
from rvjax.commands.allocate.inputs import Inputs
from rvjax.commands.speak import READING, WRITING, tell, units_placed
from rvjax.render import FORM, Figure


@dataclass(frozen=True)
class Computed:
    """A result and its figures, begun.

    Attributes:
        answer: result of the study.
        drawn: its figures.
    """

    answer: Answer
    drawn: tuple[Figure, ...]


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return phases_of(READING, WRITING) if inputs.kept is None else ()


def compute(inputs: Inputs) -> Computed | None:
    """Compute the result and solve the unit without errors; None if the result is stored."""
    if inputs.kept is not None:
        return None
    begun = dict[str, Figure]()

    def draw(sampled: Answer) -> None:
        """Draw figures of the sample units while the rest is computed."""
        for figure in figures(sampled):
            figure.begin(FORM)
            begun[figure.name] = figure

    with units_placed(lambda: seconds_of_units(inputs.study)) as device:
        tell(device)
        found = answer.answer(
            inputs.study, progress=not inputs.quiet, memo=inputs.memo, measure=inputs.measure, sampled=draw
        )
    return Computed(found, tuple(begun.get(figure.name, figure) for figure in figures(found)))
