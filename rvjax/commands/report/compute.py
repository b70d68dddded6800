"""Content of a page beyond the result: the surrogate behind the sliders, error budget, bearing lives, friction."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from rvjax._ground import progress
from rvjax.commands.allocate import Answer, answer, figures, phases_of, seconds_of_units
from rvjax.commands.budget import budget_if_any, section_on
from rvjax.commands.report import surrogate as behind
from rvjax.commands.report.bearings import bearing_section
from rvjax.commands.report.friction import friction_section
from rvjax.commands.report.inputs import Inputs
from rvjax.commands.report.lives import begin_lives, lives_if_any
from rvjax.commands.report.losses import begin_losses, losses_if_any
from rvjax.commands.report.reducer import design_section
from rvjax.commands.speak import READING, tell, units_placed
from rvjax.population import Population
from rvjax.records import PyTree
from rvjax.render import Content, Figure, Report, Section
from rvjax.response import begin_programs, is_costly, parts
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
        design: on the reducer, None: made with the page.
        drawn: figures of the result, none: made with the page.
    """

    answer: Answer
    surrogate: behind.Surrogate | None = None
    budget: Section | None = None
    bearings: Section | None = None
    friction: Section | None = None
    design: Section | None = None
    drawn: tuple[Figure, ...] = ()


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
        return _shown(inputs)


def _shown(inputs: Inputs) -> Shown:
    found = inputs.answer or answer.answer(inputs.study, progress=not inputs.quiet)
    progress.begin(SLIDERS if inputs.sliders else SECTIONS)
    begin_lives(inputs.study, found.allocation.tolerances)
    begin_losses(inputs.study, found.allocation.tolerances)
    response, population = found.study.response(), Population.of(found.after.tolerances)
    needed = inputs.sliders and inputs.answer is not None  # else this process has the programs
    for part in parts(response, population) if needed else ():
        if is_costly(part.response):
            begin_programs(part.response, population, slopes=True)
    design, drawn = design_section(found.study), tuple(figures(found))
    _begin((design, *drawn))
    with ThreadPoolExecutor(1) as other:  # each works on the host while the devices solve units of the other
        sections = other.submit(_sections, inputs.study, found.allocation.tolerances)
        moved = behind.surrogate(found) if inputs.sliders else None
        bearings, friction, budget = sections.result()
    progress.begin(WRITING)
    return Shown(found, moved, budget, bearings, friction, design, drawn)


def _sections(study: Study, tolerances: PyTree) -> tuple[Section | None, ...]:
    """Sections on bearing lives, friction and the error budget, with their figures begun."""
    lives = lives_if_any(study, tolerances)
    bearings = bearing_section(lives, study) if lives else None
    losses = losses_if_any(study, tolerances)
    friction = friction_section(losses, study) if losses else None
    budget = budget_if_any(study, tolerances)
    found = bearings, friction, section_on(budget) if budget else None
    _begin(tuple(filter(None, found)))
    return found


def _begin(content: tuple[Content, ...]) -> None:
    """Draw the figures of the page while the rest is computed."""
    for part in Report("", content).parts():
        if isinstance(part, Figure):
            part.begin("svg")
