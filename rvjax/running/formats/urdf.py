"""A joint model as URDF: one continuous joint with friction and damping, and its transmission."""

import xml.etree.ElementTree as ElementTree

from rvjax.records import PyTree
from rvjax.running.formats.head import MISSING, Header, digits, numbers

ABSENT = ("backlash", "stiffness", "rotor inertia", "friction in proportion to the load")
LINK = 1e-3  # mass in kg, and inertia in kg m2 where none is given, of a link to be replaced
INTERFACE = "hardware_interface/EffortJointInterface"


def as_urdf(joint: PyTree, header: Header) -> str:
    """Text of the file.

    Args:
        joint: the model.
        header: its origin.

    Raises:
        ValueError: a number is not finite.
    """
    found = {name: value or 0.0 for name, value in numbers(joint).items()}
    given = numbers(joint)["output_inertia"]
    inertia = LINK if given is None else given

    root = ElementTree.Element("robot", name=header.study)
    _add(root, "link", name="base")
    link = _add(_add(root, "link", name="output_link"), "inertial")
    _add(link, "mass", value=digits(LINK))
    moments = {"ixx": inertia, "iyy": inertia, "izz": inertia, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
    _add(link, "inertia", **{name: digits(value) for name, value in moments.items()})

    hinge = _add(root, "joint", name="output", type="continuous")
    _add(hinge, "parent", link="base")
    _add(hinge, "child", link="output_link")
    _add(hinge, "axis", xyz="0 0 1")
    friction, damping = (found[f"input_{name}"] + found[f"output_{name}"] for name in ("friction", "viscous"))
    _add(hinge, "dynamics", friction=digits(friction), damping=digits(damping))

    train = _add(root, "transmission", name="train")
    _add(train, "type").text = "transmission_interface/SimpleTransmission"
    _add(_add(train, "joint", name="output"), "hardwareInterface").text = INTERFACE
    motor = _add(train, "actuator", name="motor")
    _add(motor, "hardwareInterface").text = INTERFACE
    _add(motor, "mechanicalReduction").text = digits(found["ratio"])
    ElementTree.indent(root)
    said = "Replace the mass of output_link" + (" and its inertia" if given is None else "")
    said += " by the values of the driven link: they are placeholders."
    return header.xml((*ABSENT, *MISSING), (said,)) + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)
