"""The table [assembly] of a study."""

import dataclasses
from collections.abc import Mapping

from rvjax.assembly import OBJECTIVES
from rvjax.records import PyTree
from rvjax.study import Study, choice, integer, known, quantity, subtable


@dataclasses.dataclass(frozen=True)
class Assembly:
    """Options for matching measured parts: the table [assembly].

    Attributes:
        response: that decides; None: the only requirement.
        objective: "mean", "bottleneck" or "yield".
        turned: discs may be turned over and carriers turned.
        draws: samples of the unmeasured errors, for the choice.
        certificate_draws: independent samples, for the statistics of the result.
        sd: standard deviation of the measurement by error, SI.
    """

    response: str | None = None
    objective: str = "mean"
    turned: bool = True
    draws: int = 64
    certificate_draws: int = 1024
    sd: Mapping[str, float] = dataclasses.field(default_factory=dict)


def table_of(study: Study) -> Assembly:
    """The table [assembly] of a study, or what holds without it."""
    found = study.sections.get("assembly")
    return found if isinstance(found, Assembly) else Assembly()


def section(table: Mapping[str, object], loaded: Study) -> Assembly:
    """The table [assembly] of a study.

    Args:
        table: as written.
        loaded: the study.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    known(table, {f.name for f in dataclasses.fields(Assembly)}, "assembly")
    found: dict[str, PyTree] = {}
    if "response" in table:
        found["response"] = choice(table["response"], loaded.requirements, "assembly.response")
    if "objective" in table:
        found["objective"] = choice(table["objective"], OBJECTIVES, "assembly.objective")
    if "turned" in table:
        if not isinstance(table["turned"], bool):
            raise ValueError(f"assembly.turned = {table['turned']!r}: must be true or false")
        found["turned"] = table["turned"]
    for key, most in (("draws", 4096), ("certificate_draws", 1_000_000)):
        if key in table:
            found[key] = integer(table[key], f"assembly.{key}", 1, most)
    sd = subtable(table, "sd")
    units = {f.name: f.metadata["unit"] for f in dataclasses.fields(loaded.design.error_record)}
    known(sd, units, "assembly.sd")
    found["sd"] = {name: quantity(value, units[name], f"assembly.sd.{name}") for name, value in sd.items()}
    for name, value in found["sd"].items():
        if value < 0:
            raise ValueError(f"assembly.sd.{name} = {sd[name]!r}: must be zero or positive")
    return Assembly(**found)
