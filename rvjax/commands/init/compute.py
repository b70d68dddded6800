"""A study file to begin with: every number of a known reducer with its unit and meaning, and a question to change."""

import dataclasses
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rvjax import catalogue
from rvjax.commands.init.inputs import Inputs
from rvjax.designs import InvoluteStage, RVReducer
from rvjax.records import PyTree
from rvjax.study import BASES, EMBEDDED, RATED, StudyError, choice, load, parse_study, shown
from rvjax.units import KNOWN

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FOLLOWS = ("centre_distance", "sun_radius", "sun_base_radius", "planet_base_radius")  # of standard gears
QUESTIONS = {"rv": "rv-40e", "oscillatory-roller": "corr"}
UNASKED = ("inertia", "stiffness", "mesh_variation", "damping", "contact", "bearings")  # its question reads none


def compute(inputs: Inputs) -> str:
    """Text of the new study."""
    return with_variables() if inputs.design else written(inputs.base)


def with_variables() -> str:
    """Write the text of a study for `rvjax design`, with comments."""
    question = (EMBEDDED / "rv-40e-design-four-bar.toml").read_text("utf-8")
    head = (
        "# A study to change, with the numbers of an RV-40E: replace them by those of your drawing, then run\n"
        "# rvjax design on this file. Tolerances, costs, prices, limits, stiffnesses and masses are assumed.\n\n"
        '[about] # for the head of reports; every line may go\nrevision = "A"\n'
        '# title = "..."\n# author = "..."\n\n'
    )
    return head + question[question.index("[design]") :]


def written(base: str) -> str:
    """Write the text of a study of a known reducer, with all its values.

    Raises:
        ValueError: an unknown name.
    """
    known: PyTree = BASES[choice(base, BASES, "--base")]
    design = _completed(known) if isinstance(known, RVReducer) else known
    question = (EMBEDDED / f"{QUESTIONS[design.kind]}.toml").read_text("utf-8")
    rest = question[question.index("[conditions]") :]
    if base in RATED:
        rest = re.sub(r'output_torque = "[^"]*"', f'output_torque = "{shown(RATED[base], "N m")}"', rest)
    unprinted = frozenset(catalogue.assumed(base))
    named = f'kind = "{design.kind}"\n' + "\n".join(_lines(design, known, unprinted))
    head = (
        f"# A study to change, with the numbers of the {base}: replace them by those of your drawing, then run\n"
        "# rvjax check on this file. Tolerances, costs and limits are assumed.\n\n"
        '[about] # for the head of reports; every line may go\nrevision = "A"\n'
        '# title = "..."\n# author = "..."\n\n[design]\n'
    )
    try:
        parse_study(head + named + "\n\n" + rest, name=base, solve=False)
    except StudyError as contradiction:  # published so: possible by name alone
        own = "\n".join(_lines(design.cranks, known.cranks, unprinted, "cranks."))
        named = f'base = "{base}" # its published values contradict each other: {contradiction}\n{own}'
    return head + named + "\n\n" + rest


def _completed(design: RVReducer) -> RVReducer:
    """Add the unpublished values that the study requires, assumed as in the study of the RV-40E."""
    example = load("rv-40e", solve=False).design
    cycloid, cranks = design.cycloid, design.cranks
    if not cycloid.equidistant_modification and not cycloid.shift_modification:
        names = ("equidistant_modification", "shift_modification")
        cycloid = cycloid.replace(**{name: getattr(example.cycloid, name) for name in names})
    if cranks.bearing_stiffness is None:
        cranks = cranks.replace(bearing_stiffness=example.cranks.bearing_stiffness)
    return design.replace(cycloid=cycloid, cranks=cranks)


def _lines(record: "DataclassInstance", known: PyTree, unprinted: frozenset[str], prefix: str = "") -> Iterator[str]:
    """`key = value # meaning` of every given value; unpublished values are marked."""
    standard = _standard(record)
    for f in dataclasses.fields(record):
        value, about, name = getattr(record, f.name), f.metadata, prefix + f.name
        if about["kind"] == "record":
            if value is not None and f.name not in UNASKED:
                yield ""
                yield from _lines(value, getattr(known, f.name), unprinted, f"{name}.")
        elif value is not None and not (standard and f.name in FOLLOWS):
            text = (
                str(value) if about["kind"] == "count" or about["unit"] == "-" else f'"{_exact(value, about["unit"])}"'
            )
            published = value == getattr(known, f.name) and name not in unprinted
            assumed = "" if published else "; assumed"
            yield f"{name} = {text} # {about['meaning']}{assumed}"


def _standard(record: object) -> bool:
    """True if the radii of these gears follow from teeth and module."""
    if not isinstance(record, InvoluteStage):
        return False
    due = InvoluteStage.from_teeth(
        record.sun_teeth, record.planet_teeth, module=record.module, pressure_angle=record.pressure_angle
    )
    return all(abs(getattr(record, name) / getattr(due, name) - 1) < 1e-3 for name in FOLLOWS)


def _exact(value: float, unit: str) -> str:
    """In the unit in which it is at least one, with all digits that matter."""
    _, name = shown(value, unit).split(" ", 1)
    return f"{value / KNOWN.get(unit, {}).get(name, 1.0):.12g} {name}"
