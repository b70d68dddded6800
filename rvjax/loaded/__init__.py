"""Quasi-static equilibrium of a whole RV reducer: sun to carrier, every pin and every bearing, all errors at once.

One convex energy; its minimum gives transmission error, torque-angle curve, backlash, stiffness and every force.
Derived in this project: docs/models/loaded.md.
"""

from rvjax.loaded.balance import compliance as compliance, forces as forces
from rvjax.loaded.bench import Reading, Torsion, housing_orders, reading, torsion
from rvjax.loaded.case import (
    SUPPORTS as SUPPORTS,
    Case as Case,
    Read as Read,
    output_rotation as output_rotation,
    unchecked as unchecked,
)
from rvjax.loaded.cases import MACHINE as MACHINE, RATED as RATED, WHOLE as WHOLE
from rvjax.loaded.equilibrium import (
    Loaded,
    admit as admit,
    check_input as check_input,
    equilibria as equilibria,
    equilibrium,
    named_forces as named_forces,
)
from rvjax.loaded.laws import CONTACTS as CONTACTS
from rvjax.loaded.observation import (
    HEAD_PARTS as HEAD_PARTS,
    DriveConditions as DriveConditions,
    LoadedConditions as LoadedConditions,
    check_carrying as check_carrying,
    input_angles as input_angles,
    turn as turn,
    turns_of as turns_of,
    ways as ways,
)
from rvjax.loaded.revolution import (
    BearingForces as BearingForces,
    Clearance,
    Revolution,
    bearing_forces as bearing_forces,
    clearance,
    instants as instants,
    revolution,
    summary as summary,
)
from rvjax.loaded.system import Layout as Layout

__all__ = ["Clearance", "Loaded", "Reading", "Revolution", "Torsion", "clearance", "equilibrium", "housing_orders"]
__all__ += ["reading", "revolution", "torsion"]
