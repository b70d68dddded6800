"""Outputs of the geometry for studies: figures of the design, the same for every unit."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.geometry.figures import Figures, figures
from rvjax.outputs import Description, Output, Reading, Solved, condition
from rvjax.status import Status


@dataclass(frozen=True)
class GeometryConditions:
    """Load of the nominal contact pressure."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)


@dataclass(frozen=True)
class DriveGeometryConditions:
    """Load of the nominal contact pressures of a single-stage drive."""

    output_torque: float = condition(0.0, "torque of the discs on the output", unit="N m", torque=True)


def of_design(design: RVReducer, errors: RVErrors, conditions: Any) -> Figures:
    """Figures of the design; errors are not read."""
    return figures(design, conditions.output_torque)


def _taking(name: str) -> Callable[..., Solved]:
    def take(values: Figures, design: RVReducer, conditions: object) -> Solved:
        status = jnp.asarray(values.info.status)
        if name not in ("pin_pressure", "hole_pressure"):  # the other figures hold for an undercut flank too
            status = jnp.where(status == Status.UNDERCUT, Status.CONVERGED, status)
        return getattr(values, name), status

    return take


def _needing(part: str) -> Callable[[Any, Any], None]:
    def refuse(design: RVReducer, conditions: object) -> None:
        if design.cycloid.pin_count != design.cycloid.disc_teeth + 1:
            raise ValueError(
                f"design.cycloid.pin_count = {design.cycloid.pin_count}: must be disc_teeth + 1 = "
                f"{design.cycloid.disc_teeth + 1}"
            )
        if part and getattr(design, part) is None:
            raise ValueError(f"design.{part} is missing: the required response reads it")

    return refuse


def _figure(unit: str, meaning: str, name: str, read_in: str | None = None, part: str = "") -> Output:
    return Output(unit, meaning, Reading((of_design,), _taking(name)), read_in=read_in, refuse=_needing(part))


DESCRIPTION = Description(
    name="geometry",
    design=RVReducer,
    conditions=GeometryConditions,
    outputs={
        "shortening": _figure("-", "shortening coefficient K1", "shortening"),
        "convex_radius": _figure("m", "least radius of the convex flank, <= 0: undercut", "convex_radius", "mm"),
        "pin_gap": _figure("m", "gap between neighbouring pins", "pin_gap", "mm"),
        "crank_room": _figure("m", "from the crank axes to the roots of the disc teeth", "crank_room", "mm"),
        "flank_slope": _figure("-", "largest slope of the harmonics of the profile modification", "flank_slope"),
        "envelope_diameter": _figure("m", "diameter over the pins of the ring", "envelope_diameter", "mm"),
        "contact_ratio": _figure("-", "transverse contact ratio of sun and planet, no profile shift", "contact_ratio"),
        "envelope_volume": _figure("m3", "over the pins, along all discs", "envelope_volume", part="contact"),
        "nominal_pin_pressure": _figure(
            "Pa", "largest contact pressure of a pin, rigid discs, no errors", "pin_pressure", part="contact"
        ),
        "mass": _figure("kg", "of all parts that turn", "mass", part="inertia"),
    },
    unknown="housing, pins and bearings in the mass; elastic sharing of the nominal pin pressure",
)

_SHARED = ("shortening", "convex_radius", "pin_gap", "flank_slope", "envelope_diameter", "envelope_volume")
OTHERS = (
    Description(
        name="geometry",
        design=CycloidalReducer,
        conditions=DriveGeometryConditions,
        outputs={name: DESCRIPTION.outputs[name] for name in (*_SHARED, "nominal_pin_pressure")}
        | {
            "nominal_hole_pressure": _figure(
                "Pa",
                "largest contact pressure of an output pin, rigid discs, no errors",
                "hole_pressure",
                None,
                "contact",
            ),
            "hole_gap": _figure("m", "gap between neighbouring holes of a disc", "hole_gap", "mm"),
            "hole_wall": _figure("m", "from the holes to the roots of the disc teeth", "hole_wall", "mm"),
            "eccentric_force": _figure("N", "mean force of an eccentric bearing, rigid discs", "eccentric_force"),
        },
        unknown="elastic sharing and clearances in the nominal contact pressures and the force of an eccentric bearing",
    ),
)
"""Of single-stage drives."""
