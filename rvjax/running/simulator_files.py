"""Joint models as text of the files that simulators read: JSON, MJCF, Modelica, URDF.

Each format is a function from a joint model and the origin of the file to text, and an entry of `FORMATS`.
"""

import dataclasses
import json
import math
import re
import textwrap
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

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


def numbers(joint: object) -> dict[str, float | None]:
    """Numbers of a joint model by field, None where it has none.

    Raises:
        ValueError: one of them is not finite.
    """
    given: dict[str, Any] = {name: getattr(joint, name) for name in units(joint)}
    values = {name: None if value is None else float(value) for name, value in given.items()}
    bad = [name for name, value in values.items() if value is not None and not math.isfinite(value)]
    if bad:
        raise ValueError(f"{bad[0]} = {values[bad[0]]}: must be finite; the file is not written")
    return values


def with_inertia(joint: object, form: str) -> dict[str, float]:
    """Numbers of a joint model that has both inertias; a damping that is not given is 0.

    Args:
        joint: the model.
        form: name of the format, for the message.

    Raises:
        ValueError: an inertia is missing, or a number is not finite.
    """
    values = numbers(joint)
    options = {"rotor_inertia": "--input-inertia", "output_inertia": "--output-inertia"}
    for name, option in options.items():
        value = values[name]
        if value is None:
            raise ValueError(f"design.inertia is missing: {form} needs {name}; give [design.inertia] or {option}")
        if value <= 0:
            raise ValueError(f"{name} = {value:g} kg m2: must be positive")
    return {name: 0.0 if value is None else value for name, value in values.items()}


def digits(value: float) -> str:
    """A number with all its bits."""
    return repr(float(value))


FORMAT, VERSION = "rvjax-joint", 1


def as_json(joint: object, header: Header) -> str:
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


NOTHING = 1e-7  # inertia of a body over the armature of its joint
STEPS = 0.1  # timestep times the natural frequency of the train, rad
NUMBERS = ("mu_avg", "mu_dif", "forward_loss", "backward_loss")
PROPORTIONAL = "friction in proportion to the load (its numbers are in <custom>)"


SOFT_STEP = 1e-3  # s
SOFT = f"{2 * SOFT_STEP:g} 1"  # time constant, at least two timesteps, and damping ratio of the constraint
SOFT_REMARK = f"The timestep is {SOFT_STEP:g} s: a soft constraint keeps the backlash in place of the elastic train."


def as_mjcf(joint: object, header: Header, *, soft: bool = False) -> str:
    """Text of the file.

    Args:
        joint: the model, with both inertias.
        header: its origin.
        soft: whether a constraint of the simulator is in place of the elastic train.

    Raises:
        ValueError: an inertia is missing, or a number is not finite.
    """
    values = with_inertia(joint, "MJCF")
    rotor, output = values["rotor_inertia"], values["output_inertia"]
    step = SOFT_STEP if soft else STEPS / _frequency(values)

    root = ElementTree.Element("mujoco", model=header.study)
    _add(root, "compiler", angle="radian", boundmass="0", boundinertia="0")
    _add(root, "option", gravity="0 0 0", timestep=digits(step), integrator="implicitfast")
    custom = _add(root, "custom")
    for name in NUMBERS:
        _add(custom, "numeric", name=name, data=digits(values[name]))
    world = _add(root, "worldbody")
    _body(world, "rotor", rotor, values["input_viscous"], values["input_friction"])
    _body(world, "output", output, values["output_viscous"], values["output_friction"])

    half = digits(values["half_backlash"])
    spring = {name: digits(values[name]) for name in ("stiffness", "damping")} | {"springlength": f"-{half} {half}"}
    if soft:
        spring = dict(limited="true", range=f"-{half} {half}", solreflimit=SOFT) if values["half_backlash"] > 0 else {}
    train = _add(_add(root, "tendon"), "fixed", name="train", **spring)
    _add(train, "joint", joint="output", coef="1")
    _add(train, "joint", joint="rotor", coef="-1")
    if not spring:  # without backlash the rotor holds the output
        _add(_add(root, "equality"), "tendon", tendon1="train", solref=SOFT)
    _add(_add(root, "actuator"), "motor", name="motor", joint="rotor", gear=digits(values["ratio"]))
    ElementTree.indent(root)
    said = (
        "The control of the motor is the torque of the motor shaft in N m.",
        SOFT_REMARK if soft else remark(joint),
    )
    missing = (*MISSING, PROPORTIONAL, *(("stiffness and damping of the train",) if soft else ()))
    return header.xml(missing, said) + ElementTree.tostring(root, encoding="unicode") + "\n"


def remark(joint: object) -> str:
    """A sentence on the timestep of the file, which the train sets.

    Args:
        joint: the model, with both inertias.
    """
    natural = _frequency(with_inertia(joint, "MJCF"))
    why = f"{STEPS} over the natural frequency of the train, {natural:.3g} rad/s"
    return f"The timestep is {STEPS / natural:.2g} s: {why}. A larger one does not resolve its vibration."


def _frequency(values: dict[str, float]) -> float:
    """Of rotor and output on the stiffness of the train, rad/s."""
    return math.sqrt(values["stiffness"] * (1 / values["rotor_inertia"] + 1 / values["output_inertia"]))


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _body(world: ElementTree.Element, name: str, inertia: float, viscous: float, friction: float) -> None:
    """A body on a hinge; its inertia is the armature of the joint."""
    body, mass = _add(world, "body", name=name), digits(NOTHING * inertia)
    _add(body, "inertial", pos="0 0 0", mass=mass, diaginertia=f"{mass} {mass} {mass}")
    moving = dict(armature=digits(inertia), damping=digits(viscous), frictionloss=digits(friction))
    _add(body, "joint", name=name, type="hinge", axis="0 0 1", **moving)


LIBRARY = "4.0.0"

MODEL = """\
{comment}
model {name} "Reducer with friction, backlash and elasticity"
  Modelica.Mechanics.Rotational.Interfaces.Flange_a flange_a "Input shaft";
  Modelica.Mechanics.Rotational.Interfaces.Flange_b flange_b "Output";
  Modelica.Mechanics.Rotational.Components.Inertia rotor(J={rotor});
  Modelica.Mechanics.Rotational.Components.LossyGear gear(
    ratio={ratio},
    lossTable={table});
  Modelica.Mechanics.Rotational.Components.ElastoBacklash train(
    c={stiffness},
    d={damping},
    b={backlash});
  Modelica.Mechanics.Rotational.Components.Inertia output_side(J={output});
  Modelica.Mechanics.Rotational.Components.Damper damper(d={viscous});
  Modelica.Mechanics.Rotational.Components.BearingFriction bearing(tau_pos=[0, {friction}]);
  Modelica.Mechanics.Rotational.Components.Fixed ground;
equation
  connect(flange_a, rotor.flange_a);
  connect(rotor.flange_b, gear.flange_a);
  connect(gear.flange_b, train.flange_a);
  connect(train.flange_b, output_side.flange_a);
  connect(output_side.flange_b, bearing.flange_a);
  connect(bearing.flange_b, flange_b);
  connect(flange_b, damper.flange_a);
  connect(damper.flange_b, ground.flange);
  annotation(uses(Modelica(version="{library}")));
end {name};
"""


def as_modelica(joint: object, header: Header) -> str:
    """Text of the file.

    Args:
        joint: the model, with both inertias.
        header: its origin.

    Raises:
        ValueError: an inertia is missing, a number is not finite, or the reducer is self-locking under load.
    """
    values = with_inertia(joint, "Modelica")
    rows = loss_table(values)
    written = ";\n      ".join(", ".join(digits(number) for number in row) for row in rows)
    return MODEL.format(
        comment="\n".join(f"// {line}" for line in header.lines(MISSING)),
        name="Reducer_" + re.sub(r"\W", "_", header.study, flags=re.ASCII),
        rotor=digits(values["rotor_inertia"] / values["ratio"] ** 2),
        ratio=digits(values["ratio"]),
        table=f"[{written}]",
        stiffness=digits(values["stiffness"]),
        damping=digits(values["damping"]),
        backlash=digits(2 * values["half_backlash"]),
        output=digits(values["output_inertia"]),
        viscous=digits(values["output_viscous"]),
        friction=digits(values["output_friction"]),
        library=LIBRARY,
    )


def loss_table(values: dict[str, float]) -> list[list[float]]:
    """Rows of the table of losses: speed of the input, two efficiencies, two friction torques at the input.

    The input torque of the gear is (T + D + L |T|)/i, with L of the direction of the power. The friction D at the
    output grows with the speed; two rows give its line.

    Args:
        values: numbers of the joint model.

    Raises:
        ValueError: no torque on the output turns the input.
    """
    ratio, forward, backward = abs(values["ratio"]), values["forward_loss"], values["backward_loss"]
    if backward >= 1:
        raise ValueError(
            f"backward_loss = {backward:.4g}: must be below 1; LossyGear of Modelica has no self-locking reducer"
        )
    driving, driven = 1 / (1 + forward), 1 - backward
    rows = []
    for speed in (0.0, 1.0):  # of the output, rad/s
        friction = (values["input_friction"] + values["input_viscous"] * speed) / ratio
        rows.append([speed * ratio, driving, driven, driving * friction, friction / driven])
    return rows


ABSENT = ("backlash", "stiffness", "rotor inertia", "friction in proportion to the load")
LINK = 1e-3  # mass in kg, and inertia in kg m2 where none is given, of a link to be replaced
INTERFACE = "hardware_interface/EffortJointInterface"


def as_urdf(joint: object, header: Header) -> str:
    """Text of the file.

    Args:
        joint: the model.
        header: its origin.

    Raises:
        ValueError: a number is not finite.
    """
    values = {name: value or 0.0 for name, value in numbers(joint).items()}
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
    friction, damping = (values[f"input_{name}"] + values[f"output_{name}"] for name in ("friction", "viscous"))
    _add(hinge, "dynamics", friction=digits(friction), damping=digits(damping))

    train = _add(root, "transmission", name="train")
    _add(train, "type").text = "transmission_interface/SimpleTransmission"
    _add(_add(train, "joint", name="output"), "hardwareInterface").text = INTERFACE
    motor = _add(train, "actuator", name="motor")
    _add(motor, "hardwareInterface").text = INTERFACE
    _add(motor, "mechanicalReduction").text = digits(values["ratio"])
    ElementTree.indent(root)
    said = "Replace the mass of output_link" + (" and its inertia" if given is None else "")
    said += " by the values of the driven link: they are placeholders."
    return header.xml((*ABSENT, *MISSING), (said,)) + ElementTree.tostring(root, encoding="unicode") + "\n"


class Form(NamedTuple):
    """A format of a joint model."""

    ending: str  # of file names
    write: Callable[[PyTree, Header], str]
    inertias: bool  # whether it needs both inertias
    remark: Callable[[PyTree], str] = lambda _: ""  # a sentence on the file of a model


FORMATS = {
    "mjcf": Form(".xml", as_mjcf, True, remark),
    "mjcf-soft": Form(".xml", partial(as_mjcf, soft=True), True, lambda _: SOFT_REMARK),
    "modelica": Form(".mo", as_modelica, True),
    "urdf": Form(".urdf", as_urdf, False),
    "json": Form(".json", as_json, False),
}
