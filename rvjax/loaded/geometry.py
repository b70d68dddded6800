"""Geometry of discs and ring at one angle, in the frame of the ideal carrier, without errors but the eccentricity.

Forward is counter-clockwise, and so is the output. Pin 0 and eccentric 0 lie on the x axis at input angle 0.
Derivation and equation numbers: docs/models/loaded.md.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import sin_cos
from rvjax.designs import CycloidStage


class Turn(NamedTuple):
    """Cosine and sine of an angle."""

    cosine: jax.Array
    sine: jax.Array

    def plus(self, angle: np.ndarray) -> "Turn":
        """The angle and a constant one."""
        c, s = (jnp.asarray(x, self.cosine.dtype) for x in (np.cos(angle), np.sin(angle)))
        return Turn(self.cosine * c - self.sine * s, self.sine * c + self.cosine * s)

    def of(self, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The vector (x, y) turned by the angle."""
        return self.cosine * x - self.sine * y, self.sine * x + self.cosine * y

    @property
    def back(self) -> "Turn":
        """The opposite angle."""
        return Turn(self.cosine, -self.sine)


def turn(angle: jax.Array) -> Turn:
    """Cosine and sine of `angle`, () rad."""
    sine, cosine = sin_cos(angle)
    return Turn(cosine, sine)


class Geometry(NamedTuple):
    """Directions at one angle; d discs, p pins."""

    carrier: Turn  # th, (): from the housing to the ideal carrier
    crank: Turn  # -zp th, ()
    eccentric: Turn  # b_k, (d,)
    pin: Turn  # g_j, (p,)
    lobe: Turn  # psi_kj, (d, p)
    size: jax.Array  # S, (d, p)
    shortening: jax.Array  # K1, ()
    lever: jax.Array  # e zc sin(psi) / S, (d, p) m
    normal: tuple[jax.Array, ...]  # n, x and y (d, p): from the pin centre into the disc
    tooth: jax.Array  # tooth of disc k that pin j meets, (d, p) integer


def geometry(cycloid: CycloidStage, eccentricity: jax.Array, th: jax.Array) -> Geometry:
    """Directions and levers at an angle of the carrier against the ring.

    Args:
        cycloid: counts and pin circle radius are read.
        eccentricity: e, nominal and error, () m.
        th: () rad.
    """
    zc, zp, discs = cycloid.disc_teeth, cycloid.pin_count, cycloid.disc_count
    crank = turn(-zp * th)
    places, pins = np.arange(discs) / discs, np.arange(zp) / zp
    eccentric = crank.plus(2 * np.pi * places)  # Eq. 2
    pin = turn(-th).plus(2 * np.pi * pins)
    # psi / 2 = (2 pi j / zp + zc th - 2 pi k / nd) / 2: its sine keeps what is near a tooth space exact
    half = turn(zc * th / 2).plus(np.pi * (pins[None] - places[:, None]))
    lobe = Turn(1 - 2 * half.sine * half.sine, 2 * half.sine * half.cosine)
    k1 = eccentricity * zp / cycloid.pin_circle_radius
    size = jnp.sqrt((1 - k1) ** 2 + 4 * k1 * half.sine * half.sine)  # Eq. 4
    laps = jnp.floor(jax.lax.stop_gradient(zc * th / (2 * np.pi)) + jnp.asarray(pins[None] - places[:, None], th.dtype))
    return Geometry(
        carrier=turn(th),
        crank=crank,
        eccentric=eccentric,
        pin=pin,
        lobe=lobe,
        size=size,
        shortening=k1,
        lever=eccentricity * zc * lobe.sine / size,  # Eq. 5
        normal=tuple(
            (k1 * b[:, None] - g[None]) / size for b, g in ((eccentric.cosine, pin.cosine), (eccentric.sine, pin.sine))
        ),
        tooth=jnp.mod(jnp.arange(zp, dtype=jnp.int32)[None] - laps.astype(jnp.int32), zc),  # Eq. 6
    )
