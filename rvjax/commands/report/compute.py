"""Content of a page beyond the result: the surrogate behind the sliders, error budget, bearing lives, friction."""

from dataclasses import dataclass

from rvjax.base import progress
from rvjax.commands.allocate import Answer, answer, phases_of, seconds_of_units
from rvjax.commands.budget import budget_if_any, section_on
from rvjax.commands.report import surrogate as behind
from rvjax.commands.report.bearings import bearing_section
from rvjax.commands.report.friction import friction_section
from rvjax.commands.report.inputs import Inputs
from rvjax.commands.report.lives import lives_if_any
from rvjax.commands.report.losses import losses_if_any
from rvjax.commands.speak import READING, tell, units_placed
from rvjax.records import PyTree
from rvjax.render import Section
from rvjax.study import Study

SLIDERS, SECTIONS, WRITING = "numbers behind the sliders", "sections of the page", "the page"


@dataclass(frozen=True)
class Shown:
    """Result with the surrogate, the error budget, the bearing lives and the friction of its page.

    Attributes:
        answer: result of the study.
        surrogate: behind the sliders, None where nothing can move, or without sliders.
        budget: on that of the allocated tolerances, None where the study has none.
        bearings: on their lives with the allocated tolerances, None where the study requires none.
        friction: on losses with the allocated tolerances, None where the study requires none.
    """

    answer: Answer
    surrogate: behind.Surrogate | None = None
    budget: Section | None = None
    bearings: Section | None = None
    friction: Section | None = None


def phases(inputs: Inputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    if inputs.shown:
        return ()
    after = SLIDERS if inputs.sliders else SECTIONS, WRITING
    return phases_of(READING, *after) if inputs.answer is None else (READING, *after)


def compute(inputs: Inputs) -> Shown | None:
    """Compute or read the result; compute surrogate, budget, lives and losses. None if the page shows all that."""
    if inputs.shown:
        return None
    with units_placed(lambda: seconds_of_units(inputs.study) if inputs.answer is None else 0.0) as device:
        tell(device)
        found = inputs.answer or answer.answer(inputs.study, progress=not inputs.quiet)
        progress.begin(SLIDERS if inputs.sliders else SECTIONS)
        moved = behind.surrogate(found) if inputs.sliders else None
        bearings, friction, budget = _sections(inputs.study, found.allocation.tolerances)
        progress.begin(WRITING)
    return Shown(found, moved, budget, bearings, friction)


def _sections(study: Study, tolerances: PyTree) -> tuple[Section | None, ...]:
    """Sections on bearing lives, friction and the error budget."""
    lives, losses = lives_if_any(study, tolerances), losses_if_any(study, tolerances)
    budget = budget_if_any(study, tolerances)
    return (
        bearing_section(lives, study) if lives else None,
        friction_section(losses, study) if losses else None,
        section_on(budget) if budget else None,
    )
