"""Friction of a reducer as built: losses, efficiency, starting and back-driving torque, hysteresis, joint models.

Losses follow from the forces of the loaded equilibrium and exact sliding speeds: docs/models/running.md.
"""

from rvjax.running.back_driving import BackDriving, back_driving
from rvjax.running.drag import DragFit, fit_drag
from rvjax.running.hysteresis import Hysteresis, hysteresis
from rvjax.running.joint import Joint, joint
from rvjax.running.losses import Losses, losses

__all__ = [
    "BackDriving",
    "DragFit",
    "Hysteresis",
    "Joint",
    "Losses",
    "back_driving",
    "fit_drag",
    "hysteresis",
    "joint",
    "losses",
]
