"""Load sharing between the rollers of an oscillatory roller stage (CORR) with manufacturing errors.

An eccentric cam pushes n = z + 1 rollers in the slots of a cage against an inner gear with z teeth. Half
of the rollers share the torque, and micrometres decide who carries it. `solve` gives the forces on every
roller and the windup for one unit at one angle.

Source: Wei et al. 2021, Chin. J. Mech. Eng. 34:84.
"""

from rvjax.geometry import ToothProfile, largest_roller_radius, tooth_profile, undercut_margin
from rvjax.mesh_force.equilibrium import MeshForces, solve
from rvjax.mesh_force.outputs import (
    ContactPressure,
    CycleStatistics,
    contact_pressure,
    cycle_angles,
    cycle_statistics,
    sweep,
)

__all__ = ["ContactPressure", "CycleStatistics", "MeshForces", "ToothProfile", "contact_pressure", "cycle_angles"]
__all__ += ["cycle_statistics", "largest_roller_radius", "solve", "sweep", "tooth_profile", "undercut_margin"]
