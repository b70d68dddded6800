"""Arguments of the loaded model for a single-stage drive: what must be given, and what must fit together."""

import dataclasses

from rvjax._ground.axes import fit
from rvjax._ground.choices import choose
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.loaded import laws
from rvjax.loaded.inputs import SUPPORTS
from rvjax.records import Record


def check_drive(
    design: CycloidalReducer, errors: CycloidalErrors, contact: str, carrier: str, sun: str = "fixed"
) -> None:
    """Raise an error for what no equilibrium can be computed of.

    Args:
        design: the drive.
        errors: of its parts.
        contact: "hertz", "linear" or "palmgren".
        carrier: "fixed" or "floating".
        sun: "fixed".

    Raises:
        ValueError: names the argument or the field.
    """
    for name, value, known in (("contact", contact, laws.CONTACTS), ("carrier", carrier, SUPPORTS)):
        choose(name, value, known)
    if sun != "fixed":
        raise ValueError(
            f"sun = {sun!r}: a single-stage drive has none; a floating shaft is CycloidalStiffness.shaft_support"
        )
    for name in ("stiffness", "contact"):
        if getattr(design, name) is None:
            raise ValueError(f"CycloidalReducer.{name} = None: the loaded equilibrium needs it")
    assert design.stiffness is not None and design.contact is not None
    for part in (design.contact, design.output):
        if contact == "linear" and part.pin_stiffness is None:
            raise ValueError(f"{type(part).__name__}.pin_stiffness = None: contact = 'linear' needs it")
    check_shapes(design, design.cycloid, design.output, design.stiffness, design.contact)
    check_shapes(design, errors)


def check_shapes(design: CycloidalReducer, *parts: Record) -> None:
    """Raise an error for an array that does not fit the counts of a design.

    Args:
        design: gives the counts.
        *parts: records of numbers.
    """
    for part in parts:
        for f in dataclasses.fields(part):
            value = getattr(part, f.name)
            if f.metadata["kind"] == "real" and value is not None:
                fit(f"{type(part).__name__}.{f.name}", value, f.metadata["shape"], design.counts)
