"""Contact laws of pins and holes of a single-stage drive: coefficients, levels and relative radii.

An output pin lies in a hollow, the hole: 1/R* = 1/rw - 1/(rw + e + clearance/2), nominal. Near conformity the theory of
line contact ends.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import Contact
from rvjax.loaded import material
from rvjax.loaded.cycloidal_gaps import Drive
from rvjax.loaded.gaps import flank_rounding
from rvjax.records import Scalar


class Law(NamedTuple):
    """Numbers of the contact law of one group of contacts, one for each or one for all."""

    compliance: jax.Array  # c of hertz, k of linear, C of palmgren
    level: jax.Array | None  # A of hertz
    radius: jax.Array  # R*, m


class DriveLaws(NamedTuple):
    """Contact laws of both groups."""

    pins: Law  # (d, p)
    holes: Law  # (d, n) or shorter


def drive_laws(law: str, design: CycloidalReducer, at: Drive) -> DriveLaws:
    """Numbers of the contact laws at an angle.

    Args:
        law: "hertz", "linear" or "palmgren".
        design: radii and contact are read.
        at: directions of the angle.
    """
    contact, output, cycloid = design.contact, design.output, design.cycloid
    assert contact is not None
    pin, sleeve = jnp.asarray(cycloid.pin_radius), jnp.asarray(output.pin_radius)
    room = jnp.asarray(cycloid.eccentricity + output.hole_clearance / 2)  # hole radius less pin radius
    groups = (
        (flank_rounding(cycloid, at.ring), pin, contact.pin_stiffness, contact.pin_support),
        (sleeve * room / (sleeve + room), sleeve, output.pin_stiffness, output.pin_support),
    )
    return DriveLaws(*(_law(law, contact, *numbers) for numbers in groups))


def _law(
    law: str, contact: Contact, rounding: jax.Array, pin: jax.Array, stiffness: Scalar | None, support: Scalar | None
) -> Law:
    """Eqs. 8 to 10; `rounding` is r^2/R* of a pin of radius r."""
    plane = material.plane(contact)
    radius = pin * pin / rounding
    soft = None if support is None else jnp.atleast_2d(1 / jnp.asarray(support))  # a row for every disc
    if law == "linear":
        assert stiffness is not None
        free = jnp.asarray(1 / jnp.asarray(stiffness))
        return Law(1 / (free if soft is None else free + soft), None, radius)
    if law == "palmgren":
        return Law(3.81 * plane**0.9 / contact.face_width**0.8, None, radius)
    c = plane / contact.face_width
    level = material.level(contact, rounding)
    return Law(c, level if soft is None else level + soft / c, radius)
