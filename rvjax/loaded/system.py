"""What one equilibrium depends on: numbers of one angle, of the springs and of the gaps, and the order of the unknowns.

Unknowns q are lengths, deviations from the ideal motion in the frame of the ideal carrier:

    disc k      x, y, R beta                    rows 3 k ..
    crank i     x, y, r_b rho                   rows 3 nd + 3 i ..
    carrier     R alpha, then x, y if it floats
    sun         x, y, r_s rotation if it floats
"""

from typing import Any, NamedTuple

import numpy as np


class Layout(NamedTuple):
    """Counts and methods: what is compiled in."""

    discs: int
    cranks: int
    pins: int
    law: str  # of the pins
    carrier: str
    sun: str

    @property
    def inner(self) -> int:
        """Unknowns of the discs."""
        return 3 * self.discs

    @property
    def carried(self) -> int:
        """Row of the carrier rotation."""
        return 3 * (self.discs + self.cranks)

    @property
    def tail(self) -> int:
        """Unknowns of carrier and sun."""
        return 1 + 2 * (self.carrier == "floating") + 3 * (self.sun == "floating")

    @property
    def unknowns(self) -> int:
        """Their number."""
        return self.carried + self.tail


class System(NamedTuple):
    """Numbers of one case, lengths in m, forces in N. d discs, c cranks, p pins."""

    rows: Any  # (3, d, p) pin depth per displacement of its disc: -n_x, -n_y, lever / R; Eq. 9
    level: Any  # (d, p) A of the hertz law, else None
    compliance: Any  # () of the pin law
    swing: Any  # (d, 2) motion of a journal per r_b rho: e / r_b J u(b_k)
    flank: Any  # (c, 2, 2) [driving, coasting] flank, normal x, y; Eq. 10
    arm_stiffness: Any  # (d, c)
    seat_stiffness: Any  # (c,)
    mesh_stiffness: Any  # (c,)
    centring: Any  # () k0
    carrier_support: Any  # () where it floats, else None
    sun_support: Any  # () where it floats, else None
    sun_torsion: Any  # () over r_s^2 where it floats, else None
    gap: Any  # (d, p) depth of a pin at q = 0
    gear_gap: Any  # (c, 2)
    arm: Any  # (d, c, 2) disc bore against journal at q = 0
    seat: Any  # (c, 2) crank against carrier bore at q = 0
    arm_clearance: Any  # ()
    seat_clearance: Any  # ()
    load: Any  # () T / R


def directions(cranks: int) -> tuple[np.ndarray, np.ndarray]:
    """Radial and tangential unit vectors of the crank axes, (c, 2): crank i stands at pi + 2 pi i / c. Eq. 3.

    Args:
        cranks: c.
    """
    angle = np.pi + 2 * np.pi * np.arange(cranks) / cranks
    radial = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return radial, np.stack([-radial[:, 1], radial[:, 0]], axis=1)
