"""Differences of two results, and their certificates under the requirements of one study."""

import dataclasses

from rvjax import progress
from rvjax.commands import forecast
from rvjax.commands.compare.crossed import Crossed, crossed
from rvjax.commands.compare.inputs import Inputs
from rvjax.commands.compare.results import Topics, compared


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two results, or one, side by side.

    Attributes:
        topics: what differs by topic and name, as `compared` gives it; empty for one result.
        crossed: certificates under the study of --on, by letter.
    """

    topics: Topics
    crossed: dict[str, Crossed]


def phases(asked: Inputs) -> dict[str, float]:
    """Phases of the command with their seconds.

    Args:
        asked: what is computed.
    """
    if asked.study is None:
        return {}
    seconds = 5.0 + (forecast.unit_seconds(asked.study) or 0.0) * (asked.samples or asked.study.certificate_samples)
    return dict.fromkeys(map(_drawing, asked.answers), seconds)


def _drawing(letter: str) -> str:
    return f"units of {letter}"


def compute(asked: Inputs) -> Comparison:
    """Compare two results; certify each under the study of --on."""
    topics = compared(*asked.results.values()) if len(asked.results) == 2 else {}
    found = {}
    for letter, (_, tolerances) in asked.answers.items():
        progress.begin(_drawing(letter))
        assert asked.study is not None
        found[letter] = crossed(asked.study, tolerances, samples=asked.samples)
    return Comparison(topics, found)
