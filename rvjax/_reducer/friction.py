"""Coefficients of friction of a reducer by place, and its drags. No maker publishes them."""

from typing import Any

import numpy as np

from rvjax.records import Record, concrete, field, quantity, record


@record
class Friction(Record):
    """Friction of a reducer by place (`rvjax.running`). Coefficients are assumed or measured."""

    ring_pins: Any = field(
        "-",
        "coefficient of a disc on a ring pin that does not turn; a sleeve on a pin: times pin radius / sleeve radius",
        default=0.0,
        sign="nonnegative",
    )
    output_pins: Any = field(
        "-", "coefficient of an output pin in its hole, single-stage drives only", default=None, sign="nonnegative"
    )
    arm_bearings: Any = field(
        "-",
        "moment of an arm or eccentric bearing over load x pitch diameter / 2; None: no such loss",
        default=None,
        sign="nonnegative",
    )
    support_bearings: Any = field(
        "-",
        "moment of a support bearing over load x pitch diameter / 2; None: no such loss",
        default=None,
        sign="nonnegative",
    )
    gear_meshes: Any = field(
        "-", "lost share of the power of a mesh, seen from the carrier; below 1", default=0.0, sign="nonnegative"
    )
    arm_bearing_moment: Any = field(
        "N m", "of one arm bearing without load: preload, cage, seal", default=0.0, sign="nonnegative"
    )
    support_bearing_moment: Any = field(
        "N m", "of one support bearing without load: preload, cage, seal", default=0.0, sign="nonnegative"
    )
    input_drag: Any = field("N m", "torque of seals and bearings on the input", default=0.0, sign="nonnegative")
    output_drag: Any = field("N m", "torque of seals and main bearings on the output", default=0.0, sign="nonnegative")
    input_viscous: Any = field("N m s/rad", "torque per speed on the input", default=0.0, sign="nonnegative")
    output_viscous: Any = field("N m s/rad", "torque per speed on the output", default=0.0, sign="nonnegative")
    static_factor: Any = field("-", "all friction at rest over that in motion", default=1.0, sign="positive")

    def _check(self) -> None:
        share = self.gear_meshes
        if concrete(share) and np.any(np.asarray(share) >= 1):
            raise ValueError(f"Friction.gear_meshes = {quantity(share, '-')}: must be below 1, a share of the power")
