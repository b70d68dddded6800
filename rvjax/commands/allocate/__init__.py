"""`rvjax allocate`: the cheapest tolerances that meet the requirements of a study."""

import json
from dataclasses import dataclass

from rvjax import study
from rvjax.commands import READING, WRITING, share_cores, tell, units_placed
from rvjax.commands.allocate import answer
from rvjax.commands.allocate.answer import FILE as FILE, Answer as Answer, Side as Side, restored_from as restored_from
from rvjax.commands.allocate.full_model_check import (
    unlimited_tables as unlimited_tables,
    unlimited_texts as unlimited_texts,
)
from rvjax.commands.allocate.tables import (
    figures as figures,
    report_on as report_on,
    requirement_table as requirement_table,
    tolerance_tables as tolerance_tables,
)
from rvjax.commands.allocate.texts import (
    LIVES as LIVES,
    headline as headline,
    limits_of_the_answer as limits_of_the_answer,
    shortfall_text as shortfall_text,
    shortfalls as shortfalls,
)
from rvjax.commands.check import expected, forewarn, phases_of, seconds_of_units
from rvjax.commands.inputs import Inputs, quiet_option, results_option, study_argument, switch
from rvjax.render import Note, Report, results_folder


@dataclass(kw_only=True)
class AllocateInputs(Inputs):
    """Find the cheapest tolerances for which the required share of units meets every requirement. Independent units
    certify them. Tables and plots go to a results folder.

    examples:
      rvjax allocate
      rvjax allocate my-study.toml --results results/first-try

    The folder contains summary.txt, CSV tables, result.json (SI units, seed, versions), study.toml and plots.
    Existing results are never overwritten. For an unchanged study the stored result is shown at once, unless the
    study reads other files or another version computed the result. exit code 1: no tolerances within the process
    ranges meet the requirements (the summary prints how far the limits would have to move), or the result is not
    certified.
    """

    source: str = study_argument(
        ": rv-40e-whole (default: loaded reducer, a minute or two), rv-40e (four-bar model, seconds), corr",
        default="rv-40e-whole",
    )
    results: str | None = results_option("STUDY")
    fresh: bool = switch("recompute; the new result replaces the stored one of this study")
    no_whole: bool = switch(
        "do not measure the result of a four-bar or lost-motion study on the whole reducer, nor what a loaded "
        "study does not limit"
    )
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the study, and find the folder that holds its result."""
        self.study = study.load(self.source, solve=False)
        if self.study.costly:
            share_cores(1)
        stored = answer.folder(self.study, self.results)
        self.stored = None if self.fresh else stored
        if self.stored is not None:
            self.quiet = True
            return
        self.folder, self.over = results_folder(self.results, self.study.name, stored), stored is not None
        forewarn(self.study, expected(self.study))
        self.memo = answer.memo(self.study, self.folder)


def phases(inputs: AllocateInputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return phases_of(READING, WRITING) if inputs.stored is None else ()


def compute(inputs: AllocateInputs) -> Answer | None:
    """Compute the result and solve the unit without errors; None if the result is stored."""
    if inputs.stored is not None:
        return None
    with units_placed(lambda: seconds_of_units(inputs.study)) as device:
        tell(device)
        return answer.answer(inputs.study, progress=not inputs.quiet, memo=inputs.memo, measure=not inputs.no_whole)


def report(inputs: AllocateInputs, found: Answer | None) -> Report:
    """Report on a result, computed or read from a results folder.

    Args:
        inputs: inputs of the command.
        found: its result, None where a folder keeps it.
    """
    if found is not None:
        return report_on(found)
    place = inputs.stored
    assert place is not None
    said = f"Unchanged since {place} was written: this is its stored result. --fresh replaces it."
    stored = answer.restored(inputs.study, place)  # fits the terminal; the summary has the lines of a file
    shown = report_on(stored).content if stored else (Note((place / "summary.txt").read_text("utf-8").strip()),)
    return Report(
        title=inputs.study.name,
        content=(*shown, Note(said)),
        ok=answer.status(place) == "OPTIMAL",
        data=json.loads((place / "result.json").read_text()) | {"results": str(place)},
    )
