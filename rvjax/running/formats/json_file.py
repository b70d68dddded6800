"""A joint model as JSON: every number under its name, in SI."""

import json

from rvjax.records import PyTree
from rvjax.running.formats.head import MISSING, Header, numbers, units

FORMAT, VERSION = "rvjax-joint", 1


def as_json(joint: PyTree, header: Header) -> str:
    """Text of the file.

    Args:
        joint: the model.
        header: its origin.

    Raises:
        ValueError: a number is not finite.
    """
    about = {"format": FORMAT, "version": VERSION, "study": header.study, "unit": header.unit, "rvjax": header.rvjax}
    whole = about | {"not_represented": list(MISSING)} | numbers(joint) | {"units": units(joint)}
    return json.dumps(whole, indent=1, allow_nan=False) + "\n"
