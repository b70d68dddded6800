"""Oscillatory roller reducers."""

from rvjax.designs import CamRollerReducer
from rvjax.study.kinds.kind import Kind, Start

KIND = Kind(
    design=CamRollerReducer,
    name="an oscillatory roller reducer",
    facts=lambda design: [("rollers", str(design.gear_teeth + 1))],
    starts={"": Start("corr")},
)
