"""A joint model as MJCF: rotor and output on hinges about one axis, with a tendon between them as the elastic train.

The dead band of the spring of the tendon is the backlash: `springlength` has two lengths.
"""

import math
import xml.etree.ElementTree as ElementTree

from rvjax.records import PyTree
from rvjax.running.formats.head import MISSING, Header, digits, with_inertia

NOTHING = 1e-7  # inertia of a body over the armature of its joint
STEPS = 0.1  # timestep times the natural frequency of the train, rad
NUMBERS = ("mu_avg", "mu_dif", "forward_loss", "backward_loss")
PROPORTIONAL = "friction in proportion to the load (its numbers are in <custom>)"


def as_mjcf(joint: PyTree, header: Header) -> str:
    """Text of the file.

    Args:
        joint: the model, with both inertias.
        header: its origin.

    Raises:
        ValueError: an inertia is missing, or a number is not finite.
    """
    found = with_inertia(joint, "MJCF")
    rotor, output = found["rotor_inertia"], found["output_inertia"]
    step = STEPS / _frequency(found)

    root = ElementTree.Element("mujoco", model=header.study)
    _add(root, "compiler", angle="radian", boundmass="0", boundinertia="0")
    _add(root, "option", gravity="0 0 0", timestep=digits(step), integrator="implicitfast")
    custom = _add(root, "custom")
    for name in NUMBERS:
        _add(custom, "numeric", name=name, data=digits(found[name]))
    world = _add(root, "worldbody")
    _body(world, "rotor", rotor, found["input_viscous"], found["input_friction"])
    _body(world, "output", output, found["output_viscous"], found["output_friction"])

    half = digits(found["half_backlash"])
    spring = dict(stiffness=digits(found["stiffness"]), damping=digits(found["damping"]))
    train = _add(_add(root, "tendon"), "fixed", name="train", springlength=f"-{half} {half}", **spring)
    _add(train, "joint", joint="output", coef="1")
    _add(train, "joint", joint="rotor", coef="-1")
    _add(_add(root, "actuator"), "motor", name="motor", joint="rotor", gear=digits(found["ratio"]))
    ElementTree.indent(root)
    said = ("The control of the motor is the torque of the motor shaft in N m.", remark(joint))
    return header.xml((*MISSING, PROPORTIONAL), said) + ElementTree.tostring(root, encoding="unicode") + "\n"


def remark(joint: PyTree) -> str:
    """A sentence on the timestep of the file, which the train sets.

    Args:
        joint: the model, with both inertias.
    """
    natural = _frequency(with_inertia(joint, "MJCF"))
    why = f"{STEPS} over the natural frequency of the train, {natural:.3g} rad/s"
    return f"The timestep is {STEPS / natural:.2g} s: {why}. A larger one does not resolve its vibration."


def _frequency(found: dict[str, float]) -> float:
    """Of rotor and output on the stiffness of the train, rad/s."""
    return math.sqrt(found["stiffness"] * (1 / found["rotor_inertia"] + 1 / found["output_inertia"]))


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _body(world: ElementTree.Element, name: str, inertia: float, viscous: float, friction: float) -> None:
    """A body on a hinge; its inertia is the armature of the joint."""
    body, own = _add(world, "body", name=name), digits(NOTHING * inertia)
    _add(body, "inertial", pos="0 0 0", mass=own, diaginertia=f"{own} {own} {own}")
    moving = dict(armature=digits(inertia), damping=digits(viscous), frictionloss=digits(friction))
    _add(body, "joint", name=name, type="hinge", axis="0 0 1", **moving)
