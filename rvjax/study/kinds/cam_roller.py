"""Oscillatory roller reducers."""

from rvjax.catalogue import shown
from rvjax.designs import CamRollerReducer
from rvjax.mesh_force import largest_roller_radius, undercut_margin
from rvjax.study.kinds.kind import Kind, Start


def _doubts(design: CamRollerReducer) -> list[str]:
    """A line for rollers that cut into the flank of the inner gear."""
    if undercut_margin(design) > 0:
        return []
    radius, limit = (shown(float(r), "m") for r in (design.roller_radius, largest_roller_radius(design)))
    return [f"design.roller_radius = {radius}: rollers from {limit} on cut into the flank of the inner gear (undercut)"]


KIND = Kind(
    design=CamRollerReducer,
    name="an oscillatory roller reducer",
    facts=lambda design: [("rollers", str(design.gear_teeth + 1))],
    doubts=_doubts,
    starts={"": Start("corr")},
)
