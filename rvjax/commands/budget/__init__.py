"""`rvjax budget`: the contribution of every error to the variance of a curve, by error, part, stage and order."""

from dataclasses import dataclass

from rvjax import study
from rvjax.base import progress as phase
from rvjax.commands import READING, WRITING
from rvjax.commands.budget.budgets import (
    Budget as Budget,
    ScalarBudget,
    budget_if_any as budget_if_any,
    curve_of,
    error_budget as error_budget,
    scalar_budget,
)
from rvjax.commands.budget.tables import report_on as report_on, report_on_scalar, section_on as section_on
from rvjax.commands.forecast import forewarn
from rvjax.commands.inputs import Inputs, option, quiet_option, results_option, study_argument, whole_number
from rvjax.render import Report, results_folder
from rvjax.study import quantity

__all__ = ["Budget", "budget_if_any", "error_budget", "report_on", "section_on"]


@dataclass(kw_only=True)
class BudgetInputs(Inputs):
    """Compute the share of every error, part and stage in the variance of the transmission error along the output, by
    order of the output revolution and for two torques. Tables and a plot go to a results folder. A response without
    a curve, such as a bearing life, has shares of its variance over the units, and slopes.

    examples:
      rvjax budget rv-40e-whole
      rvjax budget rv-40e-whole --output life
      rvjax budget my-study.toml --torque "412 N m" --torque "12.4 N m" --samples 1000

    The tolerances are those of the study. A share is the mean change of a harmonic, or of the response, when one
    error is sampled again, not a derivative. The report also bounds what errors cause together. The folder contains
    summary.txt, shares.csv, budget.csv (every order), result.json (SI units), budget.png and study.toml.
    """

    source: str = study_argument(": rv-40e-whole (default), rv-40e", default="rv-40e-whole")
    output: str | None = option(
        "response of the study: its curve if it is a value of one, else the response itself (default: the first curve)",
        "RESPONSE",
    )
    torque: list[str] | None = option(
        "output torque such as '412 N m', may be repeated (default: the torque of the study, and a thousandth of it)",
        "TORQUE",
        action="append",
    )
    samples: int = option(
        "units, each solved twice and once for every error (default: 256)", "N", default=256, type=whole_number
    )
    seed: int | None = option("seed of the random numbers (default: the study's)", type=int)
    results: str | None = results_option("STUDY-budget")
    quiet: bool = quiet_option()

    def __post_init__(self) -> None:
        """Read the study; each torque is given once."""
        self.study = study.load(self.source, solve=False)
        self.loads = {torque: quantity(torque, "N m", "--torque") for torque in self.torque or ()}
        if len(set(self.loads.values())) < len(self.torque or ()):
            raise ValueError(f"--torque {', '.join(self.torque or ())}: each torque once")
        self.folder = results_folder(self.results, f"{self.study.name}-budget")
        forewarn(self.study)


COUNTED = "error budget"
"""Phase whose part done is known."""


def phases(inputs: BudgetInputs) -> tuple[str, ...]:
    """Phases of the command.

    Args:
        inputs: what is computed.
    """
    return (READING, COUNTED, WRITING)


def compute(inputs: BudgetInputs) -> Budget | ScalarBudget:
    """The budget of the tolerances of the study."""
    inputs.study.check_nominal()
    phase.begin(COUNTED)
    named = tuple(inputs.study.requirements) if inputs.output is None else (inputs.output,)
    if set(named) <= set(inputs.study.requirements) and curve_of(inputs.study, inputs.output) is None:
        if inputs.loads:
            raise ValueError(f"--torque: {named[0]} has no curve along the output; its torque is that of the study")
        return scalar_budget(inputs.study, named[0], samples=inputs.samples, seed=inputs.seed)
    return error_budget(
        inputs.study, output=inputs.output, loads=inputs.loads or None, samples=inputs.samples, seed=inputs.seed
    )


def report(inputs: BudgetInputs, found: Budget | ScalarBudget) -> Report:
    """The report on a budget.

    Args:
        inputs: inputs of the command.
        found: its result.
    """
    return report_on_scalar(found, inputs.study) if isinstance(found, ScalarBudget) else report_on(found, inputs.study)
