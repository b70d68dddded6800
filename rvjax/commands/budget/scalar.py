"""Error budget of a response without a curve, such as a bearing life: shares of its variance over units, and slopes."""

from dataclasses import dataclass

import numpy as np

from rvjax.base.files import versions
from rvjax.base.progress import progress_bar
from rvjax.commands.budget.effects import FEWEST, LEVELS, MOST, by_level, parts_of
from rvjax.commands.cells import SHARE_MEANS, UNMOVED_MEANS, influence_share, slope_text, together_text
from rvjax.population import Population
from rvjax.render import Cell, Interval, Note, Number, Quantity, Report, Table, Text
from rvjax.response import BLOCK
from rvjax.study import Study
from rvjax.tolerances import Influence, influences
from rvjax.units import with_unit


@dataclass(frozen=True)
class ScalarBudget:
    """Shares of the variance of one response over units.

    Attributes:
        output: name of the response.
        influence: of the errors, as in the result of an allocation.
        part: {error: part of the reducer}.
    """

    output: str
    influence: Influence
    part: dict[str, str]

    def by(self, level: str) -> dict[str, float]:
        """Variances of the errors, or summed over those of a part or stage, the largest first.

        Args:
            level: "field", "part" or "stage".
        """
        return by_level(level, self.influence.variance, self.part)


def scalar_budget(study: Study, output: str, *, samples: int = 256, seed: int | None = None) -> ScalarBudget:
    """The error budget of a response by total effects: each error of a unit is sampled again.

    Args:
        study: design, conditions and tolerances.
        output: required response of the study.
        samples: units; each is solved once, and once for every error unless the response is linear.
        seed: by default that of the study.

    Raises:
        ValueError: fewer than 16 samples or more than 65536, or none of the units has a value.
    """
    if not FEWEST <= samples <= MOST:
        raise ValueError(f"samples = {samples}: must be at least {FEWEST} and at most {MOST}")
    seed = study.seed if seed is None else seed
    population = Population.of(study.tolerances)
    response, chunk = study.response(), min(samples, BLOCK)
    with progress_bar(False, samples * len(population.active), "solving", "unit") as advance:
        (found,) = influences(
            response, study.tolerances, seed=seed, units=samples, chunk=chunk, names=(output,), advance=advance
        ).values()
    if found.failed == samples:
        raise ValueError(f"none of {samples} units can be solved")
    return ScalarBudget(output, found, parts_of(study, population))


def report_on_scalar(budget: ScalarBudget, study: Study) -> Report:
    """The report on the budget of a response.

    Args:
        budget: the error budget.
        study: that it belongs to.
    """
    output, found = study.output(budget.output), budget.influence
    unit, size = output.shown
    whole = sum(found.variance.values())
    rows: list[list[Cell]] = []
    for level in LEVELS:
        for name, square in budget.by(level).items():
            row: list[Cell] = [name, budget.part[name] if level == "field" else level, np.sqrt(square) / size]
            if level == "field":
                row += [influence_share(found, name), slope_text(found, name, study, output)]
            else:
                row += [Quantity(square / whole if whole > 0 else 0.0, read_in="%", form=".1f"), ""]
            rows.append(row)
    excluded = f"; {found.failed} failed and are excluded" if found.failed else ""
    head = [
        f"Study {study.name}",
        *(f"Inaccurate: {line}" for line in study.inaccurate()),
        f"Error budget: {budget.output}, {output.meaning}",
        f"{found.units} units{excluded}: mean {with_unit(found.mean / size, unit)}, "
        f"standard deviation {with_unit(found.sd / size, unit)}",
        "slope: derivative to one element of the error, mean over the units, root mean square over its elements",
        *filter(None, [UNMOVED_MEANS, SHARE_MEANS, together_text({budget.output: found})]),
    ]
    columns = [Text("owner"), Text("of"), Number(f"sd {unit}", form=".3g"), Interval("share [interval]"), Text("slope")]
    data = {"study": study.name, "seed": study.seed, "versions": versions(), "unit": output.unit}
    return Report(
        title=f"{study.name}: error budget of {budget.output}",
        content=(Note("\n".join(head)), Table("shares", columns, rows)),
        data=data | {"output": budget.output, "part": budget.part} | vars(found),
        files={"study.toml": study.text.encode()},
    )
