"""Torque on the output that starts a reducer backwards."""

from rvjax.records import Array, Record, field, record
from rvjax.status import SolveInfo


@record
class BackDriving(Record):
    """Torque on the output that turns a reducer from every angle, input free."""

    torque: Array = field("N m", "on the output, >= 0; inf: none up to 1000 times the friction without load")
    info: SolveInfo = field("-", "steps: of all equilibria; residual: of the root over the torque", kind="record")
