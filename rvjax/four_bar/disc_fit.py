"""Phase-locked cranks, two or more: a disc settles where it fits its crank pins best (planar Procrustes).

A pin lies at R er + D with D = K + A u + B n + d: carrier bore K, crank errors A along and B across the
eccentric direction u, joint shift d. The bore lies at Q = R er + q in the disc, mean removed. The disc
turns by the angle of the vector (C, S), S = sum Q x (R er + D), C = sum Q . (R er + D), whose coefficients
in u belong to the unit: in a batch over shared angles each angle costs a few multiplications.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import arctan2, divide, sin_cos
from rvjax.four_bar.closures import Crank, stretch
from rvjax.four_bar.unit import Unit, Vector
from rvjax.records import Array


class Fit(NamedTuple):
    """Quantities that do not depend on the crank angle; lists run over cranks."""

    seats: list[Vector]  # Q
    bores: list[Vector]  # q, mean included
    carrier: list[Vector]  # K
    along: list[Any]  # A
    across: list[Any]  # B
    still: Array  # C + i S: part of the bores, less the nominal C = c R^2; complex, see `fit`
    turning: Array  # part of the crank errors, times u
    bore_excess: Array  # two cranks: bore distance in the disc less l


def fit(unit: Unit, k: int) -> Fit:
    """Prepare disc k."""
    radius, disc = unit.radius, unit.parts.disc[k]
    bores = [_cartesian(axis, polar) for axis, polar in zip(unit.axes, disc)]
    carrier = [_cartesian(axis, polar) for axis, polar in zip(unit.axes, unit.parts.carrier)]
    mean = _mean(bores)
    seats = [(radius * u + (x - mean[0]), radius * v + (y - mean[1])) for (u, v), (x, y) in zip(unit.axes, bores)]
    along, across = map(list, zip(*_moves(unit, k)))
    excess = bore_excess(unit, k) if len(disc) == 2 else jnp.zeros_like(radius)
    return Fit(
        seats,
        bores,
        carrier,
        along,
        across,
        # Complex numbers, for XLA evaluates everything behind one result in one pass.
        still=_complex(
            _sum_dot(seats, carrier) + radius * sum(radial for radial, _ in disc),
            _sum_cross(seats, carrier) - radius * sum(tangential for _, tangential in disc),
        ),
        turning=_complex(
            sum(a * x + b * y for a, b, (x, y) in zip(along, across, seats)),
            sum(b * x - a * y for a, b, (x, y) in zip(along, across, seats)),
        ),
        bore_excess=excess,
    )


def bore_excess(unit: Unit, k: int) -> Array:
    """Distance of the two bores of disc k less its nominal value."""
    disc = unit.parts.disc[k]
    return stretch(2 * unit.radius, disc[0][0] + disc[1][0], disc[0][1] + disc[1][1])


def apart(unit: Unit, k: int) -> tuple[jax.Array, jax.Array]:
    """Second of two pins less the first without load, less its nominal value: still, and times the direction u."""
    (x, y), (u, v) = (_cartesian(axis, polar) for axis, polar in zip(unit.axes, unit.parts.carrier))
    (a, b), (c, d) = _moves(unit, k)
    return _complex(u - x, v - y), _complex(c - a, d - b)


class Turning(NamedTuple):
    """Inputs of the angles of unloaded discs; vectors are complex, at a crank less those at the last crank.

    Their mean over the cranks does not turn a disc. So few numbers are left that a derivative passes through them
    on its way to the errors, and each error is read once; see `settle` in extremes.py.
    """

    radius: Array
    carrier: list[Array]  # [i] K
    bores: list[list[Array]]  # [k][i] q
    moves: list[list[Array]]  # [k][i] A + i B


def turning(unit: Unit) -> Turning:
    """Inputs of the disc angles of a unit without load."""
    parts, discs = unit.parts, range(len(unit.parts.disc))

    def less_last(vectors: list[Vector]) -> list[Array]:
        x, y = vectors[-1]
        return [_complex(u - x, v - y) for u, v in vectors[:-1]]

    def cartesian(polar: list[Vector]) -> list[Vector]:
        return [_cartesian(axis, vector) for axis, vector in zip(unit.axes, polar)]

    return Turning(
        radius=unit.radius,
        carrier=less_last(cartesian(parts.carrier)),
        bores=[less_last(cartesian(parts.disc[k])) for k in discs],
        moves=[less_last(_moves(unit, k)) for k in discs],
    )


def still_and_turning(axes: list[Vector], of: Turning, k: int) -> tuple[Vector, Vector]:
    """As in `Fit`, over c R^2: with Q and the pins P both less their mean, sum conj(Q) P of differences alone."""
    count = len(axes)
    scale = 1 / (count * of.radius**2)
    bores, carrier, moves = ([(jnp.real(z), jnp.imag(z)) for z in zs] for zs in (of.bores[k], of.carrier, of.moves[k]))
    seats = [(of.radius * u + x, of.radius * v + y) for (u, v), (x, y) in zip(axes, bores)]
    mean = (sum(x for x, _ in bores) / count, sum(y for _, y in bores) / count)
    seats = [(x - mean[0], y - mean[1]) for x, y in seats]
    bore = (of.radius * _sum_dot(bores, axes), of.radius * _sum_cross(bores, axes))
    still = (scale * (_sum_dot(seats, carrier) + bore[0]), scale * (_sum_cross(seats, carrier) + bore[1]))
    return still, (scale * _sum_dot(seats, moves), scale * _sum_cross(seats, moves))


def vector(unit: Unit, fit: Fit, crank: Crank) -> Vector:
    """(C, S) at an eccentric direction of the disc."""
    straight, skew = jnp.real(fit.turning), jnp.imag(fit.turning)
    cosine = jnp.real(fit.still) + (straight * crank.cosine - skew * crank.sine)
    sine = jnp.imag(fit.still) + (skew * crank.cosine + straight * crank.sine)
    if unit.load is not None:
        shifts = unit.joint_shifts(crank)
        cosine, sine = cosine + _sum_dot(fit.seats, shifts), sine + _sum_cross(fit.seats, shifts)
    return len(fit.seats) * unit.radius**2 + cosine, sine


@jax.custom_jvp
def direction(x: jax.Array, y: jax.Array) -> jax.Array:
    """Angle of the vector (x, y); its derivative by multiplications, see `divide`."""
    return arctan2(y, x)


@direction.defjvp
def _direction_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    (x, y), (dx, dy) = primals, tangents
    size = jnp.abs(x) + jnp.abs(y)
    u, v = divide(x, size), divide(y, size)
    inverse = divide(jnp.ones_like(size), size * (u * u + v * v))
    return direction(x, y), (inverse * u) * dy - (inverse * v) * dx


def misfit(unit: Unit, fit: Fit, crank: Crank) -> jax.Array:
    """Two cranks: distance of the pins less that of the bores. More: sqrt(2 sum |residual|^2)."""
    shifts = unit.joint_shifts(crank)
    pins = [  # D
        (x + (a * crank.cosine - b * crank.sine) + dx, y + (a * crank.sine + b * crank.cosine) + dy)
        for (x, y), a, b, (dx, dy) in zip(fit.carrier, fit.along, fit.across, shifts)
    ]
    if len(pins) == 2:
        return stretch(2 * unit.radius, pins[1][0] - pins[0][0], pins[1][1] - pins[0][1]) - fit.bore_excess
    c, s = vector(unit, fit, crank)
    length = jnp.sqrt(c**2 + s**2)
    ahead = c > 0  # within a right angle; beyond, 1 - cos loses no digits
    versine = jnp.where(ahead, s**2 / (length * (length + jnp.where(ahead, c, 0))), 1 - c / length)  # 1 - cos
    sine = s / length  # of the disc's angle
    offsets = [(x - u, y - v) for (x, y), (u, v) in zip(pins, fit.bores)]
    mean = _mean(offsets)
    square = 2 * sum(
        (x - mean[0] + versine * u + sine * v) ** 2 + (y - mean[1] + versine * v - sine * u) ** 2
        for (x, y), (u, v) in zip(offsets, fit.seats)
    )
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def first_order_angle(unit: Unit, k: int, crank: Crank) -> jax.Array:
    """Tangential displacement of the pins against the bores, mean over the cranks, divided by R."""
    turned, parts = 0, unit.parts
    for i, ((x, y), shift) in enumerate(zip(unit.axes, unit.joint_shifts(crank))):
        turned += parts.delta[k][i] * (crank.sine * x - crank.cosine * y)
        turned += unit.eccentricity * parts.psi[i] * (crank.cosine * x + crank.sine * y)
        turned += parts.carrier[i][1] - parts.disc[k][i][1] + (shift[1] * x - shift[0] * y)
    return turned / (len(unit.axes) * unit.radius)


def monotone_angle(vector: Vector) -> jax.Array:
    """Return a number that falls as the discs turn: -1 to 1 up to a right angle of all together, to +-2 beyond.

    Their vectors C + i S were turned one after the other by multiplication, so no angle is needed.
    """
    cosine, sine = vector
    size = jnp.abs(cosine) + jnp.abs(sine)
    beyond = jnp.where(sine >= 0, 2, -2) * size - sine
    return -divide(jnp.where(cosine >= 0, sine, beyond), size)


def product(discs: list[tuple[Vector, Vector]]) -> "Polynomial":
    """Product of the discs' vectors without load, in the direction of the first crank."""
    first, *others = discs
    together = Polynomial(list(first))
    for still, moved in others:
        together = together.times(still, moved)
    return together


class Polynomial(NamedTuple):
    """In a complex variable; numbers are pairs, real and imaginary, which run in vectors."""

    coefficients: list[Vector]  # of ascending powers

    def times(self, still: Vector, turning: Vector) -> "Polynomial":
        """Multiplied by still + turning u."""
        same = [*(times(z, still) for z in self.coefficients), (0, 0)]
        risen = [(0, 0), *(times(z, turning) for z in self.coefficients)]
        return Polynomial([(x + u, y + v) for (x, y), (u, v) in zip(same, risen)])

    def at(self, u: Vector) -> Vector:
        """Value by Horner's rule."""
        x, y = self.coefficients[-1]
        for real, imaginary in self.coefficients[-2::-1]:
            x, y = times((x, y), u)
            x, y = real + x, imaginary + y
        return x, y


def times(first: Vector, second: Vector) -> Vector:
    """Product of two complex numbers."""
    return first[0] * second[0] - first[1] * second[1], first[1] * second[0] + first[0] * second[1]


def angle_of(score: jax.Array) -> jax.Array:
    """Angle of a value of `monotone_angle`."""
    beyond = jnp.abs(score) > 1
    half_turn = jnp.where(beyond, jnp.sign(score), 0)
    within = jnp.where(beyond, score - 2 * half_turn, score)  # beyond a right angle: of the opposite direction
    return arctan2(within, 1 - jnp.abs(within)) + np.pi * half_turn


def _moves(unit: Unit, k: int) -> list[Vector]:
    """Return A and B of each crank: (e + delta) exp(i psi) - e without its cancellation."""
    moves = []
    for delta, psi in zip(unit.parts.delta[k], unit.parts.psi):
        half_sine, half_cosine = sin_cos(psi / 2)
        along = delta * (1 - 2 * half_sine**2) - unit.eccentricity * (2 * half_sine**2)
        moves.append((along, (unit.eccentricity + delta) * (2 * half_sine * half_cosine)))
    return moves


def _cartesian(axis: Vector, polar: Vector) -> Vector:
    """Return a (radial, tangential) vector of the crank at `axis` in x and y."""
    return polar[0] * axis[0] - polar[1] * axis[1], polar[0] * axis[1] + polar[1] * axis[0]


def _complex(real: Array, imaginary: Array) -> jax.Array:
    return jax.lax.complex(*jnp.broadcast_arrays(real, imaginary))


def _mean(points: list[Vector]) -> Vector:
    return sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points)


def _sum_dot(first: list[Vector], second: list[Vector]) -> jax.Array:
    return sum(x * u + y * v for (x, y), (u, v) in zip(first, second))


def _sum_cross(first: list[Vector], second: list[Vector]) -> jax.Array:
    return sum(x * v - y * u for (x, y), (u, v) in zip(first, second))
