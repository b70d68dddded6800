"""A joint model as a Modelica model of the standard library: rotor, lossy gear, elastic train with backlash, output."""

import re

from rvjax.records import PyTree
from rvjax.running.formats.head import MISSING, Header, digits, with_inertia

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


def as_modelica(joint: PyTree, header: Header) -> str:
    """Text of the file.

    Args:
        joint: the model, with both inertias.
        header: its origin.

    Raises:
        ValueError: an inertia is missing, a number is not finite, or the reducer is self-locking under load.
    """
    found = with_inertia(joint, "Modelica")
    rows = loss_table(found)
    written = ";\n      ".join(", ".join(digits(number) for number in row) for row in rows)
    return MODEL.format(
        comment="\n".join(f"// {line}" for line in header.lines(MISSING)),
        name="Reducer_" + re.sub(r"\W", "_", header.study, flags=re.ASCII),
        rotor=digits(found["rotor_inertia"] / found["ratio"] ** 2),
        ratio=digits(found["ratio"]),
        table=f"[{written}]",
        stiffness=digits(found["stiffness"]),
        damping=digits(found["damping"]),
        backlash=digits(2 * found["half_backlash"]),
        output=digits(found["output_inertia"]),
        viscous=digits(found["output_viscous"]),
        friction=digits(found["output_friction"]),
        library=LIBRARY,
    )


def loss_table(found: dict[str, float]) -> list[list[float]]:
    """Rows of the table of losses: speed of the input, two efficiencies, two friction torques at the input.

    The input torque of the gear is (T + D + L |T|)/i, with L of the direction of the power. The friction D at the
    output grows with the speed; two rows give its line.

    Args:
        found: numbers of the joint model.

    Raises:
        ValueError: no torque on the output turns the input.
    """
    ratio, forward, backward = abs(found["ratio"]), found["forward_loss"], found["backward_loss"]
    if backward >= 1:
        raise ValueError(
            f"backward_loss = {backward:.4g}: must be below 1; LossyGear of Modelica has no self-locking reducer"
        )
    driving, driven = 1 / (1 + forward), 1 - backward
    rows = []
    for speed in (0.0, 1.0):  # of the output, rad/s
        friction = (found["input_friction"] + found["input_viscous"] * speed) / ratio
        rows.append([speed * ratio, driving, driven, driving * friction, friction / driven])
    return rows
