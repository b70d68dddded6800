"""Friction of a reducer as built: losses, efficiency, starting and back-driving torque, hysteresis, joint models.

Losses follow from the forces of the loaded equilibrium and exact sliding speeds: docs/models/running.md.
"""

from rvjax.running.bench import BackDriving, DragFit, back_driving, fit_drag
from rvjax.running.inputs import SHARES as SHARES
from rvjax.running.joint import OF_JOINT as OF_JOINT, Hysteresis, Joint, hysteresis, joint
from rvjax.running.losses import Losses, losses
from rvjax.running.outputs import Turned as Turned, sign_of as sign_of, turned as turned
from rvjax.running.simulator_files import FORMATS as FORMATS, Header as Header, units as units

__all__ = ["BackDriving", "DragFit", "Hysteresis", "Joint", "Losses", "back_driving", "fit_drag", "hysteresis"]
__all__ += ["joint", "losses"]
