"""Numbers of a joint model for a file, and the comment at the head of the file."""

import dataclasses
import math
import re
import textwrap
from typing import Any

from rvjax.records import PyTree

MISSING = ("transmission error", "dependence on the angle", "curved stiffness", "temperature")
"""Not represented in any format."""
LINE = 100  # characters of a line of the comment


@dataclasses.dataclass(frozen=True)
class Header:
    """Origin of a joint model.

    Attributes:
        study: name.
        unit: which unit of the study, a line.
        rvjax: version.
    """

    study: str
    unit: str
    rvjax: str

    def lines(self, missing: tuple[str, ...], more: tuple[str, ...] = ()) -> list[str]:
        """Text of the comment.

        Args:
            missing: what the format does not represent.
            more: further sentences.
        """
        first = f"Joint model of a reducer: study {self.study}, unit: {self.unit}, rvjax {self.rvjax}."
        about = "Angles, torques and speeds are those of the output, SI units."
        texts = (first, about, *more, f"Not represented: {', '.join(missing)}.")
        return [line for text in texts for line in textwrap.wrap(" ".join(text.split()), LINE)]

    def xml(self, missing: tuple[str, ...], more: tuple[str, ...] = ()) -> str:
        """The comment of an XML file; a comment there holds no double hyphen."""
        text = "\n".join(f"  {line}" for line in self.lines(missing, more))
        return f"<!--\n{re.sub('-(?=-)', '- ', text)}\n-->\n"


def units(joint: PyTree) -> dict[str, str]:
    """SI unit of each number of a joint model, by its field."""
    return {f.name: f.metadata["unit"] for f in dataclasses.fields(joint) if f.name != "info"}


def numbers(joint: PyTree) -> dict[str, float | None]:
    """Numbers of a joint model by field, None where it has none.

    Raises:
        ValueError: one of them is not finite.
    """
    given: dict[str, Any] = {name: getattr(joint, name) for name in units(joint)}
    found = {name: None if value is None else float(value) for name, value in given.items()}
    bad = [name for name, value in found.items() if value is not None and not math.isfinite(value)]
    if bad:
        raise ValueError(f"{bad[0]} = {found[bad[0]]}: must be finite; the file is not written")
    return found


def with_inertia(joint: PyTree, form: str) -> dict[str, float]:
    """Numbers of a joint model that has both inertias; a damping that is not given is 0.

    Args:
        joint: the model.
        form: name of the format, for the message.

    Raises:
        ValueError: an inertia is missing, or a number is not finite.
    """
    found = numbers(joint)
    options = {"rotor_inertia": "--input-inertia", "output_inertia": "--output-inertia"}
    for name, option in options.items():
        value = found[name]
        if value is None:
            raise ValueError(f"design.inertia is missing: {form} needs {name}; give [design.inertia] or {option}")
        if value <= 0:
            raise ValueError(f"{name} = {value:g} kg m2: must be positive")
    return {name: 0.0 if value is None else value for name, value in found.items()}


def digits(value: float) -> str:
    """A number with all its bits."""
    return repr(float(value))
