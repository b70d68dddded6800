"""Joint model of a reducer for simulators."""

from rvjax.records import Array, Record, Scalar, field, record
from rvjax.status import SolveInfo


@record
class Joint(Record):
    """A reducer as one joint. Every number refers to the coordinate of the output."""

    ratio: Array = field("-", "turns of the input for one of the output")
    half_backlash: Array = field("rad", "half of the play")
    stiffness: Array = field("N m/rad", "secant between half and full rated torque")
    damping: Scalar | None = field("N m s/rad", "of the elastic train, as given; None: not given")
    input_friction: Array = field("N m", "Coulomb friction of input and train without load")
    output_friction: Array = field("N m", "Coulomb friction of the output")
    input_viscous: Array = field("N m s/rad", "of the input")
    output_viscous: Array = field("N m s/rad", "of the output")
    forward_loss: Array = field("-", "rise of the loss with the torque, input drives")
    backward_loss: Array = field("-", "rise of the loss with the torque, output drives")
    mu_avg: Array = field("-", "friction over motor torque, mean of both directions")
    mu_dif: Array = field("-", "half of the difference of both directions")
    rotor_inertia: Array | None = field("kg m2", "of all that turns with the input; None: not known")
    output_inertia: Array | None = field("kg m2", "of all that turns with the output; None: not known")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")
