"""A study file to begin with: every number of a reducer with its unit and meaning, and a question to change."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from rvjax.commands.init.inputs import Inputs
from rvjax.commands.init.numbers import known, lines
from rvjax.study import EMBEDDED, Assumed, Known, Start, StudyError, load, parse_study

ABOUT = """[about] # for the head of reports; every line may go
revision = "A"
# title = "..."
# author = "..."

"""


@dataclass(frozen=True)
class Written:
    """A new study.

    Attributes:
        text: of the file.
        model: "loaded" or "four-bar", "" for another kind of reducer.
        of: name of the reducer, or of the file of its drawing.
        warnings: assumed numbers outside the interval of their scaling law, and tables not taken over, a line each.
    """

    text: str
    model: str
    of: str
    warnings: tuple[str, ...] = ()


def compute(inputs: Inputs) -> Written:
    """Text of the new study."""
    return Written(with_variables(), "four-bar", inputs.base) if inputs.design else written(inputs.base, inputs.model)


def with_variables() -> str:
    """Write the text of a study for `rvjax design`, with comments."""
    text = (EMBEDDED / "rv-40e-design-four-bar.toml").read_text("utf-8")
    head = (
        "# A study to change, with the numbers of an RV-40E: replace them by those of your drawing, then run\n"
        "# rvjax design on this file. Tolerances, costs, prices, limits, stiffnesses and masses are assumed.\n\n"
    )
    return head + ABOUT + text[text.index("[design]") :]


def written(base: str, model: str = "loaded") -> Written:
    """Write a study of a reducer, with all its values.

    Args:
        base: a known reducer, or a TOML file with the table [design].
        model: "loaded" or "four-bar"; an oscillatory roller reducer has a single one.

    Raises:
        ValueError: an unknown name, or a file that gives no reducer.
    """
    given = known(base)
    starts = given.kind.starts
    model = model if model in starts else next(iter(starts))
    start = starts[model]
    own, more = start.complete(given, load(start.study, solve=False).design)
    given = replace(given, numbers=own)
    text = (EMBEDDED / f"{start.study}.toml").read_text("utf-8")
    numbers = {**own, **{path: item.value for path, item in more.items()}}
    rest = start.tables(text[text.index("[conditions]") :], numbers, given.torque)
    return Written(_joined(given, more, start, rest), model, given.name, _warnings(given, more))


def _joined(given: Known, more: Mapping[str, Assumed], start: Start, rest: str) -> str:
    """Text of the study; of a reducer whose published values contradict each other by its name."""
    named = f'kind = "{given.kind.word}"\n' + "\n".join(lines(given, more, start.parts))
    head = start.head.format(name=given.name) + ABOUT + "[design]\n"
    try:
        parse_study(head + named + "\n\n" + rest, name=given.name, solve=False)
    except StudyError as contradiction:  # published so: possible by name alone
        if given.drawing:
            raise
        own = "\n".join(lines(given, more, start.parts, only=True)).lstrip("\n")
        named = f'base = "{given.name}" # its published values contradict each other: {contradiction}\n'
        named += start.unread(given.numbers) + own
    return head + named + "\n\n" + rest


def _warnings(given: Known, more: Mapping[str, Assumed]) -> tuple[str, ...]:
    far = dict.fromkeys(line for item in (*more.values(), given.torque) if item is not None for line in item.outside)
    unread = (
        [f"{given.name}: not taken over: {', '.join(f'[{name}]' for name in given.unread)}"] if given.unread else []
    )
    return (*far, *unread)
