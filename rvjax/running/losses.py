"""Losses of a running reducer by place, efficiency, and the torques at rest."""

from rvjax.records import Array, Record, field, record
from rvjax.status import SolveInfo


@record
class Losses(Record):
    """Losses of one reducer at a torque and a speed, of first order in the friction.

    Their error is 0.33 L^2 of the torque, L = loss_torque without drag over the torque.
    """

    efficiency: Array = field("-", "input drives, at this size of the torque; 0 without torque")
    backward_efficiency: Array = field("-", "output drives, likewise; 0 where it cannot")
    input_torque: Array = field("N m", "on the sun or shaft")
    power_loss: Array = field("W", "at the torque and speed")
    loss_torque: Array = field("N m", "power loss over output speed; at rest its limit")
    ring_pins: Array = field("N m", "part of loss_torque")
    output_pins: Array = field("N m", "part of loss_torque; 0 without output pins")
    arm_bearings: Array = field("N m", "part of loss_torque")
    support_bearings: Array = field("N m", "part of loss_torque")
    gear_meshes: Array = field("N m", "part of loss_torque; 0 without meshes")
    drag: Array = field("N m", "part of loss_torque")
    starting_torque: Array = field("N m", "on the input, from the worst angle, without load")
    no_load_torque: Array = field("N m", "on the input in motion, without load")
    self_locking: Array = field("-", "1: a torque of this size at the output cannot start it, else 0", kind="integer")
    info: SolveInfo = field("-", "the worst equilibrium; steps: all", kind="record")
