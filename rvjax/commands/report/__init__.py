"""`rvjax report`: the result of a study as one HTML page with sliders."""

import dataclasses
import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import rvjax
from rvjax import commands
from rvjax.base import progress
from rvjax.base.files import check_writable
from rvjax.commands.allocate import FILE, Answer, answer, headline, report_on, restored_from
from rvjax.commands.budget import budget_if_any, section_on
from rvjax.commands.forecast import ALLOCATING, effort_of, expected, forewarn, read_study, seconds_of_units
from rvjax.commands.report import response_surface
from rvjax.commands.report.bearings import bearing_section, lives_if_any
from rvjax.commands.report.friction import friction_section, losses_if_any
from rvjax.commands.report.page import Shown as Shown, page_of as page_of
from rvjax.commands.report.sliders import cost_data as cost_data, script_of as script_of
from rvjax.render import Report, Section, results_folder
from rvjax.study import Study


@dataclass(kw_only=True)
class ReportInputs(commands.Inputs):
    """Find the cheapest tolerances as `allocate` does and write one HTML page: status, tolerances and cost,
    distributions with Cp and Cpk, the reducer to scale with the source of every value, influence of each error,
    worst units, levels, seed and versions.

    examples:
      rvjax report
      rvjax report my-study.toml --output page.html

    The page contains its plots and needs no network. Sliders for half-widths, mid-points and limits show their
    effect at once, with its error, and write the study file; a loaded study has them with --sliders. Without scripts
    the page shows the rest. For a stored result of an unchanged study the page goes to its folder, unless it is
    there. exit code 1: no tolerances meet the requirements, or the result is not certified.
    """

    source: str = commands.study_argument(
        ": rv-40e-whole (default: loaded reducer, a minute or two), rv-40e (four-bar model, seconds), corr",
        default="rv-40e-whole",
    )
    output: Path | None = commands.option(
        "the page, replaced if it exists (default: report.html in a new folder results/STUDY)",
        "FILE.html",
        type=Path,
        ends=".html",
    )
    sliders: bool = commands.switch(
        "compute sliders for a study of the loaded reducer too, which takes minutes; other studies have them"
    )
    fresh: bool = commands.switch("write the page again, even if it shows the stored result")
    quiet: bool = commands.quiet_option()

    def __post_init__(self) -> None:
        """Read the study, and find its stored result and the page that may show it."""
        self.study = read_study(self.source)
        self.stored: Path | None
        self.answer: Answer | None
        self.stored, self.answer = restored_from(self.study)
        if self.output is None and self.stored is not None:
            self.output = self.stored / "report.html"
        self.folder = results_folder(None, self.study.name) if self.output is None else None
        if self.output is not None:
            check_writable(self.output)
        forewarn(self.study, expected(self.study))
        self.sliders = self.sliders or effort_of(self.study).sliders
        self.shown = False
        if self.stored is not None and self.output is not None and not self.fresh:
            self.shown = shows(self.output, self.stored, self.source, self.sliders)
        if not self.shown:
            before = ALLOCATING if self.answer is None else ()
            self.phases = (commands.READING, *before, SLIDERS if self.sliders else SECTIONS, WRITING)


def mark(result: bytes, source: str, sliders: bool) -> bytes:
    """Last line of a page: which stored result it shows, by which version of rvjax, and whether with sliders.

    Args:
        result: content of the stored result.
        source: of the study, as named.
        sliders: whether it has them.
    """
    digest = hashlib.sha256(result + f"{source} {rvjax.__version__}".encode())
    return f"<!-- result {digest.hexdigest()}{' with sliders' if sliders else ''} -->\n".encode()


def shows(page: Path, folder: Path, source: str, sliders: bool) -> bool:
    """True if a page shows the result that a folder stores.

    Args:
        page: file that may exist.
        folder: of a result.
        source: of the study, as named.
        sliders: whether it must have them.
    """
    try:
        result = (folder / FILE).read_bytes()
        return page.read_bytes().endswith(tuple(mark(result, source, own) for own in {True, sliders}))
    except OSError:
        return False


SLIDERS, SECTIONS, WRITING = "numbers behind the sliders", "sections of the page", "the page"


def compute(inputs: ReportInputs) -> Shown | None:
    """Compute or read the result; compute surrogate, budget, lives and losses. None if the page shows all that."""
    if inputs.shown:
        return None
    with commands.units_placed(lambda: seconds_of_units(inputs.study) if inputs.answer is None else 0.0) as device:
        commands.tell(device)
        found = inputs.answer or answer.answer(inputs.study, progress=not inputs.quiet)
        progress.begin(SLIDERS if inputs.sliders else SECTIONS)
        moved = response_surface.surrogate(found) if inputs.sliders else None
        sections = tuple(_sections(inputs.study, found.allocation.tolerances))
        progress.begin(WRITING)
    return Shown(found, moved, sections)


def _sections(study: Study, tolerances: object) -> Iterator[Section]:
    """Sections on the error budget, bearing lives and friction, if the study has them."""
    if budget := budget_if_any(study, tolerances):
        yield section_on(budget)
    if lives := lives_if_any(study, tolerances):
        yield bearing_section(lives, study)
    if losses := losses_if_any(study, tolerances):
        yield friction_section(losses, study)


def report(inputs: ReportInputs, found: Shown | None) -> Report:
    """The report on a page: on the terminal its headline, and where it is.

    Args:
        inputs: inputs of the command.
        found: its result, None where the page shows it already.
    """
    if found is None:
        assert inputs.answer is not None and inputs.output is not None
        said = f"Unchanged: {inputs.output} shows this result; --fresh writes it again."
        told = {"report": str(inputs.output)}
        return dataclasses.replace(
            report_on(inputs.answer), brief=headline(inputs.answer), files={}, told=told, closing=(said,)
        )
    made = report_on(found.answer)
    content = page_of(found, inputs.source, date=time.strftime("%Y-%m-%d")).encode("utf-8")
    stored = made.files[FILE] if inputs.stored is None else (inputs.stored / FILE).read_bytes()
    content += mark(stored, inputs.source, inputs.sliders)
    brief = headline(found.answer)
    if inputs.output is not None:
        path = inputs.output
        return dataclasses.replace(
            made, brief=brief, exports={path: content}, told={"report": str(path)}, closing=(f"Report: {path}",)
        )
    return dataclasses.replace(made, brief=brief, main="report.html", files={**made.files, "report.html": content})
