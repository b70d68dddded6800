"""Values of a study next to those of known reducers, and the levels of its responses."""

import dataclasses

from rvjax import models
from rvjax.commands.cells import condition_text
from rvjax.commands.check.inputs import Inputs
from rvjax.commands.forecast import choices
from rvjax.levels import Choice
from rvjax.study import Study, facts_of, kind_of, numbers, shown


@dataclasses.dataclass(frozen=True)
class Checked:
    """Derived values of a study.

    Attributes:
        facts: (name, value) of what follows from the design.
        magnitudes: (number, value, range of known reducers or None), as text in suited units.
        levels: of each response.
    """

    facts: list[tuple[str, str]]
    magnitudes: list[tuple[str, str, str | None]]
    levels: dict[str, Choice]


def compute(inputs: Inputs) -> Checked:
    """Compute the derived values of a study."""
    study = inputs.study
    return Checked(list(facts_of(study.design)), _magnitudes(study), choices(study))


def _magnitudes(study: Study) -> list[tuple[str, str, str | None]]:
    of_kind = kind_of(study.design)
    known = [dict(numbers(one)) for one in of_kind.bases.values()]
    rows: list[tuple[str, str, str | None]] = []
    for name, (value, unit) in numbers(study.design):
        seen = [one[name][0] for one in known if name in one]
        span = f"{shown(min(seen), unit)} to {shown(max(seen), unit)}" if seen else None
        rows.append((name, shown(value, unit), span))
    kind = models.kind(study.design)
    for f in dataclasses.fields(kind.conditions):
        value = getattr(study.conditions, f.name)
        if f.name in kind.conditions_of(tuple(study.requirements)) and value is not None:
            number = condition_text(value, f.metadata)
            rated = f.metadata["torque"] and of_kind.rated
            span = f"up to {shown(of_kind.largest_torque, 'N m')}" if rated else None
            rows.append((f"conditions.{f.name}", number, span))
    return rows
