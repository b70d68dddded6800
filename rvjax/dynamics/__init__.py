"""Plane vibration of an RV reducer as a lumped model: modes, forced response, stability, sensitivities.

Rigid sun, planets, cranks, discs and output wheel on linear springs; the mesh stiffness of one stage varies
periodically under a constant load torque; every manufacturing error displaces the spring that it sits in. Not modelled:
gyroscopic terms, clearance, loss of contact, the pin ring.

Source: Yang, Chen, Wang, "Response Sensitivity to Design Parameters of RV Reducer", Chin. J. Mech. Eng. 31:49
(2018), doi 10.1186/s10033-018-0249-y. Harmonic balance, periodic solution and derivatives are derived in this project.
"""

from rvjax.dynamics.assembly import Lumped, System, assemble, lump
from rvjax.dynamics.error_excitation import ErrorExcitation, error_excitation
from rvjax.dynamics.error_response import DynamicError, transmission_error
from rvjax.dynamics.error_speeds import SpeedRange, SpeedSweep, speed_range, speed_sweep
from rvjax.dynamics.error_transfer import ErrorStatistics, error_statistics, error_transfer
from rvjax.dynamics.modes import Modes, modes
from rvjax.dynamics.periodic import Floquet, Periodic, floquet, periodic
from rvjax.dynamics.response import Response, constant_forcing, log_sensitivities, response, with_deviations
from rvjax.dynamics.static import Static, static
from rvjax.dynamics.symmetry import Block, Blocks, blocks

__all__ = ["Block", "Blocks", "DynamicError", "ErrorExcitation", "ErrorStatistics", "Floquet", "Lumped", "Modes"]
__all__ += ["Periodic", "Response", "SpeedRange", "SpeedSweep", "Static", "System", "assemble", "blocks"]
__all__ += ["constant_forcing", "error_excitation", "error_statistics", "error_transfer", "floquet"]
__all__ += ["log_sensitivities", "lump", "modes", "periodic", "response", "speed_range", "speed_sweep", "static"]
__all__ += ["transmission_error", "with_deviations"]
