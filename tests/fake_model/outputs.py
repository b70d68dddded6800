"""Design, errors, model and description of a keyed shaft: twist = (slot - key) / r + T / (k r^2)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp

from rvjax.errors import Errors
from rvjax.outputs import Curve, Description, Output, condition
from rvjax.records import Record, count, field, record
from rvjax.status import Status


@record
class KeyJointErrors(Errors):
    """Manufacturing errors of a key joint."""

    of_design: ClassVar[str] = "KeyJoint"

    key_width: Any = field("m", "width of the key; < 0 is play", default=0.0)
    slot_width: Any = field("m", "width of the slots; > 0 is play", shape=("keys",), default=0.0)


@record
class KeyJoint(Record):
    """A shaft with keys."""

    kind: ClassVar[str] = "key-joint"

    keys: int = count("keys")
    radius: Any = field("m", "of the shaft", sign="positive")
    stiffness: Any = field("N/m", "of a key", sign="positive")

    @property
    def counts(self):
        return {"keys": self.keys}

    @property
    def error_record(self):
        return KeyJointErrors


@dataclass(frozen=True)
class Conditions:
    """How the joint is judged."""

    torque: float = condition(0.0, "on the shaft", unit="N m", torque=True)
    turns: int = condition(1, "of the curve", minimum=1, maximum=10)
    side: str = condition("drive", "flank that bears", choices=("drive", "coast"))


def _twist(design, errors, given):
    play = jnp.mean(errors.slot_width - errors.key_width * jnp.ones(design.keys))
    angle = play / design.radius + given.torque / (design.keys * design.stiffness * design.radius**2)
    angle = angle if given.side == "drive" else -angle
    return angle, jnp.int32(int(Status.CONVERGED))


def _curve(design, errors, given):
    angle = jnp.linspace(0.0, 2 * jnp.pi * given.turns, 16)
    return angle, _twist(design, errors, given)[0] * jnp.cos(angle)


DESCRIPTION = Description(
    name="key_joint",
    design=KeyJoint,
    conditions=Conditions,
    outputs={"twist": Output("rad", "twist under load, play included", _twist, read_in="arcsec")},
    curve=Curve("Twist over a turn", "rad", _curve),
    unknown="bending of the key",
)
