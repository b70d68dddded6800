"""A study file to begin with: every number of a reducer with its unit and meaning, and a question to change."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from rvjax import models
from rvjax.catalogue import ASSUMED, RV_40E_WHOLE
from rvjax.commands.init.inputs import Inputs
from rvjax.commands.init.numbers import Known, in_unit, known, lines
from rvjax.commands.init.question import question
from rvjax.designs import RollerBearing, RVReducer
from rvjax.records import PyTree
from rvjax.study import EMBEDDED, MODIFICATIONS, Assumed, StudyError, completed, load, number_at, parse_study, walk

FOUR_BAR, LOADED = "four-bar", "loaded"
MODELS = (LOADED, FOUR_BAR)
QUESTIONS = {"rv": "rv-40e", "oscillatory-roller": "corr"}
KINEMATIC = ("involute", "cycloid", "cranks")
PARTS = {FOUR_BAR: KINEMATIC, LOADED: (*KINEMATIC, "stiffness", "contact", "bearings")}
UNREAD = """# The loaded model uses teeth, base circles and pressure angle of the gears, and K1 = e zp / rp = {k1:.4g}.
# It does not use module, centre distance, radius of the sun and a published K1, so that no contradiction remains.
"""
BEARING = "cranks.bearing_stiffness"
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
    return Written(with_variables(), FOUR_BAR, inputs.base) if inputs.design else written(inputs.base, inputs.model)


def with_variables() -> str:
    """Write the text of a study for `rvjax design`, with comments."""
    text = (EMBEDDED / "rv-40e-design-four-bar.toml").read_text("utf-8")
    head = (
        "# A study to change, with the numbers of an RV-40E: replace them by those of your drawing, then run\n"
        "# rvjax design on this file. Tolerances, costs, prices, limits, stiffnesses and masses are assumed.\n\n"
    )
    return head + ABOUT + text[text.index("[design]") :]


def written(base: str, model: str = LOADED) -> Written:
    """Write a study of a reducer, with all its values.

    Args:
        base: a known reducer, or a TOML file with the table [design].
        model: "loaded" or "four-bar"; an oscillatory roller reducer has a single one.

    Raises:
        ValueError: an unknown name, or a file that gives no reducer.
    """
    given = known(base)
    return _loaded(given) if model == LOADED and given.kind == RVReducer.kind else _four_bar(given)


def _four_bar(given: Known) -> Written:
    more = _assumed_for_four_bar(given) if given.kind == RVReducer.kind else {}
    text = (EMBEDDED / f"{QUESTIONS[given.kind]}.toml").read_text("utf-8")
    rest = text[text.index("[conditions]") :]
    if given.torque is not None:
        rest = re.sub(r'output_torque = "[^"]*"', f'output_torque = "{in_unit(given.torque.value, "N m")}"', rest)
    head = (
        f"# A study to change, with the numbers of the {given.name}: replace them by those of your drawing, then run\n"
        "# rvjax check on this file. Tolerances, costs and limits are assumed.\n\n"
    )
    model = FOUR_BAR if given.kind == RVReducer.kind else ""
    return Written(_joined(given, more, head, rest, FOUR_BAR), model, given.name, _warnings(given, more))


def _assumed_for_four_bar(given: Known) -> dict[str, Assumed]:
    """Unpublished values that the study requires, assumed as in the study of the RV-40E."""
    example = load("rv-40e", solve=False).design
    found = {
        path: item for path, item in completed(given.numbers).items() if given.drawing and path != MODIFICATIONS[0]
    }
    if not any(given.numbers.get(path) for path in MODIFICATIONS):
        found |= {path: Assumed(number_at(example, path), "assumed") for path in MODIFICATIONS}
    if given.numbers.get(BEARING) is None:
        found[BEARING] = Assumed(number_at(example, BEARING), "assumed")
    return found


def _loaded(given: Known) -> Written:
    # Modifications that a four-bar study assumes take up its bearing clearance; here they would press the pins.
    own = {
        path: x
        for path, x in given.numbers.items()
        if path not in MODIFICATIONS or not ASSUMED.search(given.said.get(path, ""))
    }
    given = replace(given, numbers=own)
    more = completed(own)
    numbers = {**own, **{path: item.value for path, item in more.items()}}
    assert given.torque is not None
    whole = {path: value for path, value, _ in walk(RV_40E_WHOLE)}
    arm = {path.rpartition(".")[2]: x for path, x in numbers.items() if path.startswith("bearings.arm.")}
    rest = question(numbers, RollerBearing(**arm), given.torque, whole)
    head = (
        f"# A study of the loaded reducer to change, with the numbers of the {given.name}: replace them by those of\n"
        '# your drawing, then run rvjax check on this file. A line with "assumed" has no published value. It has that\n'
        "# of the nearest known reducer, by a scaling law of rvjax/study/scaling.toml where sizes differ.\n\n"
    )
    return Written(_joined(given, more, head, rest, LOADED), LOADED, given.name, _warnings(given, more))


def _joined(given: Known, more: Mapping[str, Assumed], head: str, rest: str, model: str) -> str:
    """Text of the study; of a reducer whose published values contradict each other by its name."""
    cls, parts = models.kinds()[given.kind], PARTS[model]
    named = f'kind = "{given.kind}"\n' + "\n".join(lines(cls, given, more, parts))
    head = head + ABOUT + "[design]\n"
    try:
        parse_study(head + named + "\n\n" + rest, name=given.name, solve=False)
    except StudyError as contradiction:  # published so: possible by name alone
        if given.drawing:
            raise
        own = "\n".join(lines(cls, given, more, parts, only=True)).lstrip("\n")
        named = f'base = "{given.name}" # its published values contradict each other: {contradiction}\n'
        named += UNREAD.format(k1=_k1(given.numbers)) if model == LOADED else ""
        named += own
    return head + named + "\n\n" + rest


def _k1(numbers: Mapping[str, PyTree]) -> float:
    e, pins, ring = (numbers[f"cycloid.{name}"] for name in ("eccentricity", "pin_count", "pin_circle_radius"))
    return float(e * pins / ring)


def _warnings(given: Known, more: Mapping[str, Assumed]) -> tuple[str, ...]:
    far = dict.fromkeys(line for item in (*more.values(), given.torque) if item is not None for line in item.outside)
    unread = (
        [f"{given.name}: not taken over: {', '.join(f'[{name}]' for name in given.unread)}"] if given.unread else []
    )
    return (*far, *unread)
