"""Inputs of `rvjax assemble`: the table [assembly] of a study and a list of measured parts."""

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path

from rvjax import study
from rvjax.assembly import OBJECTIVES
from rvjax.records import PyTree
from rvjax.render import results_folder
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


@dataclasses.dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: design, tolerances, requirements and [assembly].
        source: path of the list of parts.
        prices: also compare the costs of random and matched assembly.
        folder: of the results.
        encoding: of the list; None: guessed.
    """

    study: Study
    source: str
    prices: bool
    folder: Path
    encoding: str | None = None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name; the unit without errors is solved with the parts."""
    loaded = study.load(options.study, solve=False)
    folder = results_folder(options.results, f"{loaded.name}-assembly")
    return Inputs(loaded, options.parts, options.prices, folder, options.encoding)


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
