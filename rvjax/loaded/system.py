"""Data of one equilibrium: numbers of one angle, of the springs and of the gaps, and the order of the unknowns.

Unknowns q are lengths, deviations from the ideal motion in the frame of the ideal carrier:

    disc k      x, y, R beta                    rows 3 k ..
    crank i     x, y, r_b rho                   rows 3 nd + 3 i ..
    carrier     R alpha, then x, y if it floats
    sun         x, y, r_s rotation if it floats
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
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
    def bearings(self) -> int:
        """Arm bearings, disc by disc, and after them the seats of the cranks in the carrier."""
        return (self.discs + 1) * self.cranks

    @property
    def carried(self) -> int:
        """Row of the carrier rotation."""
        return 3 * (self.discs + self.cranks)

    @property
    def inner(self) -> int:
        """Unknowns of the discs."""
        return 3 * self.discs

    def crank(self, i: int) -> int:
        """First row of a crank."""
        return 3 * (self.discs + i)

    @property
    def tail(self) -> int:
        """Unknowns of carrier and sun."""
        return 1 + 2 * (self.carrier == "floating") + 3 * (self.sun == "floating")

    @property
    def unknowns(self) -> int:
        """Their number."""
        return self.carried + self.tail


class System(NamedTuple):
    """Numbers of one case, lengths in m, forces in N. d discs, c cranks, p pins, b bearings, n unknowns."""

    rows: Any  # (3, d, p) pin depth per displacement of its disc: -n_x, -n_y, lever / R; Eq. 9
    level: Any  # (d, p) A of the hertz contact law, else None
    compliance: Any  # (1,) of the pin contact law; (p,) where the supports of linear pins differ
    gear_rows: Any  # (c, 2, n) depth of the [driving, coasting] flank per unknown; Eq. 10
    bearing_rows: Any  # (b, 2, n) displacement x, y of a bearing per unknown; Eqs. 11, 12
    gear_stiffness: Any  # (c,)
    bearing_stiffness: Any  # (b,)
    centring: Any  # () k0
    support: Any  # (n,) stiffness of an unknown against the housing: centring, supports of carrier and sun
    gap: Any  # (d, p) depth of a pin at q = 0
    gear_gap: Any  # (c, 2)
    bearing_gap: Any  # (b, 2) bore against journal at q = 0
    clearance: Any  # (b,)
    load: Any  # () T / R


def directions(cranks: int) -> tuple[np.ndarray, np.ndarray]:
    """Radial and tangential unit vectors of the crank axes, (c, 2): crank i is at pi + 2 pi i / c. Eq. 3.

    Args:
        cranks: c.
    """
    angle = np.pi + 2 * np.pi * np.arange(cranks) / cranks
    radial = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return radial, np.stack([-radial[:, 1], radial[:, 0]], axis=1)


def bearing_rows(layout: Layout, swing: jax.Array) -> jax.Array:
    """Displacement of every bearing per unknown, (b, 2, n); Eqs. 11 and 12.

    Args:
        layout: counts and methods.
        swing: (d, 2) motion of a journal per r_b rho: e / r_b J u(b_k).
    """
    discs, cranks = layout.discs, layout.cranks
    arm = np.zeros((discs, cranks, 2, layout.unknowns))
    seat = np.zeros((cranks, 2, layout.unknowns))
    rotation = np.zeros((1, cranks, 1, layout.unknowns))
    tangential = directions(cranks)[1]
    for i in range(cranks):
        crank = layout.crank(i)
        rotation[0, i, 0, crank + 2] = 1
        seat[i, :, crank : crank + 2] = np.eye(2)
        seat[i, :, layout.carried] = -tangential[i]
        if layout.carrier == "floating":
            seat[i, :, layout.carried + 1 : layout.carried + 3] = -np.eye(2)
        for k in range(discs):
            arm[k, i, :, 3 * k : 3 * k + 2] = np.eye(2)
            arm[k, i, :, 3 * k + 2] = tangential[i]
            arm[k, i, :, crank : crank + 2] = -np.eye(2)
    swung = jnp.asarray(arm, swing.dtype) - jnp.asarray(rotation, swing.dtype) * swing[:, None, :, None]
    return jnp.concatenate([swung.reshape(-1, 2, layout.unknowns), jnp.asarray(seat, swing.dtype)])


def gear_rows(layout: Layout, flank: jax.Array) -> jax.Array:
    """Depth of both flanks of every planet per unknown, (c, 2, n); Eq. 10.

    Args:
        layout: counts and methods.
        flank: (c, 2, 2) [driving, coasting] flank, normal x, y.
    """
    spin = np.asarray([1.0, -1.0])
    along = np.zeros((2, layout.cranks, 1, layout.unknowns))  # per x and y of the normal
    turned = np.zeros((layout.cranks, 2, layout.unknowns))
    for i in range(layout.cranks):
        turned[i, :, layout.crank(i) + 2] = spin
        for a in range(2):
            along[a, i, 0, layout.crank(i) + a] = -1
            if layout.sun == "floating":
                along[a, i, 0, a - 3] = 1
    if layout.sun == "floating":
        turned[:, :, -1] = spin
    x, y = (jnp.asarray(part, flank.dtype) for part in along)
    return jnp.asarray(turned, flank.dtype) + flank[:, :, :1] * x + flank[:, :, 1:] * y
