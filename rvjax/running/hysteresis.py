"""Width of the loop of torque and angle, input held."""

from rvjax.records import Array, Record, field, record
from rvjax.status import SolveInfo


@record
class Hysteresis(Record):
    """Loop of torque and angle of a reducer whose input is held."""

    width: Array = field("rad", "of the loop at zero torque; with play it contains the backlash")
    friction_torque: Array = field("N m", "friction of the output in parallel with the elastic train")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")
