"""Manufacturing errors as displacement excitation: how far each error holds the spring it sits in out of place.

A spring with an error pulls with k (v.q - delta), delta periodic in the output angle theta. For two or more equal
cranks and discs only the mean over the members reaches the rotations, so that eight real signals, one for each
kind of spring, hold all errors: Re sum_n g_n e^{i n theta}, n per output turn. Vectors and pin angles are given
in the frame of `rvjax.loaded`, crank 0 at pi; here crank 0 lies at 0, and they are negated.

Errors of the pins are a series over the turning eccentric. With chi the angle of a pin before the eccentric, the pins
with sin chi < 0 carry the torque of a loaded reducer. Their normal n = (K1 - cos chi, -sin chi) / S gives the share of
the load that each carries, and the displacement of its contact.

Derivation, orders and equation numbers: docs/models/dynamic_error.md.
"""

from collections.abc import Iterable
from fractions import Fraction
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial.legendre import leggauss

from rvjax.base.fields import fit
from rvjax.catalogue import checked
from rvjax.designs import RVReducer, expect
from rvjax.dynamics.assembly import Lumped, admitted, loaded, lump, roots_of_one, waves
from rvjax.dynamics.excitation import constants, in_phase
from rvjax.errors import RVErrors, described, read_by
from rvjax.records import Array, PyTree, Record, Scalar, field, promote, record, text
from rvjax.status import Gate, SolveInfo, Status, at_once, window

SPRINGS = (
    "sun_planet_mesh", "support_radial", "support_tangential",
    "arm_radial", "arm_tangential", "arm_along", "arm_across", "disc_pin_mesh",
)  # fmt: skip
"""Signals of the errors: planets on the sun; cranks in the carrier; journals in the discs, as a mean seen from the
crank and seen from the eccentric; discs on the pins."""

Orders = tuple[Fraction, ...]  # per output turn, ascending


@record
class ErrorExcitation(Record):
    """Effect of the errors of one unit on its springs: delta(theta) = mean + Re sum_n amplitude_n e^{i n theta}.

    theta is the angle of the output, rad; a component is > 0 where the error lengthens what the spring measures.
    """

    order: Array = field("-", "n of each line, per output turn", shape=("orders",))
    amplitude: Array = field("m", "complex amplitude of each line and spring", shape=("orders", "springs"))
    mean: Array = field("m", "constant part, which changes the output angle once and for all", shape=("springs",))
    springs: tuple[str, ...] = text("names of the springs")
    info: SolveInfo = field("-", "CONVERGED, INVALID_GEOMETRY or NONFINITE", kind="record")


class Case(NamedTuple):
    """A unit as given, checked."""

    lumped: Lumped
    pin_circle: Scalar  # radius, () m
    errors: RVErrors
    load_inertia: Scalar  # of what the output drives, () kg m2


class Unit(NamedTuple):
    """Numbers of a reducer and its errors, harmless where they were not finite or not possible."""

    lumped: Lumped
    shortening: jax.Array  # K1, ()
    errors: dict[str, jax.Array]  # by name, full shape or scalar
    gate: Gate


@checked
def error_excitation(design: RVReducer, errors: RVErrors, *, pin_harmonics: int = 8) -> ErrorExcitation:
    """The errors of one unit as excitation of its springs, order by order.

    Args:
        design: a reducer with inertia and stiffness, two or more discs, members alike.
        errors: of its parts. What the mean over equal members cancels
            (sun_runout, ring_centre, orders of series that are no multiple of the members) is exactly zero.
        pin_harmonics: orders m disc_teeth of pin errors are kept for m up to this; all pins alike have none.

    Returns:
        ErrorExcitation, linear in the errors.

    Raises:
        ValueError: one disc, members that differ, errors that do not fit the design, or as `rvjax.dynamics.lump`.
    """
    return _excitation(case_of(design, errors, pin_harmonics), pin_harmonics)


@partial(jax.jit, static_argnums=1)
def _excitation(case: Case, pin_harmonics: int) -> ErrorExcitation:
    unit, _ = read(case)
    orders = error_orders(unit, pin_harmonics)
    amplitude, mean = generators(unit, orders, pin_harmonics)
    order = jnp.asarray([float(n) for n in orders], mean.dtype)
    (order, amplitude, mean), info = unit.gate.close((order, amplitude, mean), info=at_once(mean[0]))
    return ErrorExcitation(order, amplitude, mean, SPRINGS, info)


def case_of(design: RVReducer, errors: RVErrors, pin_harmonics: int, load_inertia: Scalar = 0.0) -> Case:
    """Check a unit whose errors act as eight signals.

    Raises:
        ValueError: see `error_excitation`.
    """
    expect(design, "dynamics", RVReducer)  # errors have the shapes of a whole design
    lumped = symmetric(design)
    if pin_harmonics < 0:
        raise ValueError(f"pin_harmonics = {pin_harmonics}: must be zero or positive")
    axes_of = described(errors, "shape")
    for name in read_by(errors, "dynamics"):
        fit(f"RVErrors.{name}", getattr(errors, name), axes_of.get(name, ()), design.counts)
    for name in described(errors, "series"):
        value = getattr(errors, name)
        if np.ndim(value) == 0 and not isinstance(value, jax.core.Tracer) and value != 0:
            raise ValueError(f"RVErrors.{name} = {value} m: a series needs (orders, 2) coefficients; 0.0 is none")
    return Case(lumped, design.cycloid.pin_circle_radius, errors, load_inertia)


def symmetric(design: RVReducer | Lumped) -> Lumped:
    """The lumped parameters of a reducer whose rotations have constant matrices although its cranks turn.

    Raises:
        ValueError: one disc, members that differ, or as `lump`.
    """
    lumped = lump(design)
    if lumped.discs < 2:
        raise ValueError(f"disc_count = {lumped.discs}: errors as excitation need two or more discs")
    if not lumped.alike:
        raise ValueError("Inertia, Stiffness: errors as excitation need one number in each field, not an array")
    return lumped


def read(case: Case, *conditions: object) -> tuple[Unit, tuple[PyTree, ...]]:
    """Promote everything to one dtype and check it; design, errors and conditions separately, so that a batch of errors
    leaves the design unbatched.

    Args:
        case: of `case_of`.
        *conditions: further numbers that are read.
    """
    lumped, pin_circle = loaded(case.lumped, case.load_inertia), case.pin_circle
    own = {name: getattr(case.errors, name) for name in read_by(case.errors, "dynamics")}
    lumped, pin_circle, own, conditions = promote(lumped, pin_circle, own, conditions)
    lumped, conditions, gate = admitted(lumped, *conditions)
    shortening = lumped.eccentricity * (lumped.disc_teeth + 1) / jnp.where(pin_circle != 0, pin_circle, 1)
    proper = (shortening > 0) & (shortening < 1) & (pin_circle > 0)
    _, largest = window(pin_circle, 0.4)
    finite = jnp.all(jnp.stack([jnp.all(jnp.abs(value) < largest) for value in own.values()]))
    known = jnp.abs(pin_circle) < largest
    refused = ((~known | ~finite, Status.NONFINITE), (known & ~proper, Status.INVALID_GEOMETRY))
    gate = Gate((*gate.refused, *refused))
    own = {name: jnp.where(finite, value, 0) for name, value in own.items()}
    return Unit(lumped, jnp.where(proper, shortening, 0.5), own, gate), conditions


def error_orders(unit: Unit, pin_harmonics: int) -> Orders:
    """All orders that the fields of these shapes can excite: h pins, h sun orders in phase, m disc_teeth in phase."""
    lumped, errors = unit.lumped, unit.errors
    pins, sun = lumped.disc_teeth + 1, sun_order(lumped)
    turning = max(1, *(length(errors[name], -2) for name in ("planet_flank", "disc_flank")))
    orders = {Fraction(h * pins) for h in range(1, turning + 1)}
    orders |= {h * sun for h in in_phase(length(errors["sun_flank"], -2), lumped.cranks)}
    orders |= {Fraction(m * lumped.disc_teeth) for m in ring_harmonics(unit, pin_harmonics)}
    return tuple(sorted(orders))


def sun_order(lumped: Lumped) -> Fraction:
    """Turns of the sun relative to the carrier for one of the output."""
    return Fraction(lumped.planet_teeth * (lumped.disc_teeth + 1), lumped.sun_teeth)


def ring_harmonics(unit: Unit, pin_harmonics: int) -> list[int]:
    """Harmonics m of the ring, orders m disc_teeth, that all discs meet in phase."""
    harmonics = set(in_phase(length(unit.errors["ring_flank"], -2), unit.lumped.discs))
    return sorted(harmonics | set(pin_orders(unit, pin_harmonics)))


def pin_orders(unit: Unit, pin_harmonics: int) -> list[int]:
    """Harmonics m of pin errors; pins alike differ from none only by multiples of their number."""
    orders = in_phase(pin_harmonics, unit.lumped.discs)
    if all(jnp.ndim(unit.errors[name]) == 0 for name in ("pin_offset", "pin_radii")):
        orders = [m for m in orders if m % (unit.lumped.disc_teeth + 1) == 0]
    return orders


def length(value: jax.Array, axis: int) -> int:
    """Entries of a series; a scalar has none."""
    return jnp.shape(value)[axis] if jnp.ndim(value) else 0


def positions(among: Orders, orders: Iterable[Fraction | int]) -> np.ndarray:
    """Index of each of `orders`."""
    return np.array([among.index(Fraction(n)) for n in orders], int)


def generators(unit: Unit, orders: Orders, pin_harmonics: int) -> tuple[jax.Array, jax.Array]:
    """Complex amplitudes (orders, springs) and constants (springs,), Eqs. 4 to 9.

    Args:
        unit: as read.
        orders: that of `error_orders`, or more.
        pin_harmonics: as in `error_excitation`.
    """
    lumped, errors = unit.lumped, unit.errors
    pins, teeth, phase = lumped.disc_teeth + 1, lumped.disc_teeth, jnp.asarray(lumped.disc_phase)
    planets, discs = np.ones(lumped.cranks), waves(lumped.discs, 1)
    like = _complex(phase, phase)
    amplitude = jnp.zeros((len(orders), len(SPRINGS)), like.dtype)

    def add(amplitude: jax.Array, lines: Iterable[Fraction | int], spring: str, values: jax.Array) -> jax.Array:
        lines = list(lines)
        if not lines:
            return amplitude
        return amplitude.at[positions(orders, lines), SPRINGS.index(spring)].add(jnp.reshape(values, (len(lines),)))

    # Eq. 4: what turns with the planets
    runout = 1j * turned(-lumped.pressure_angle) * mean_of(vector(errors["planet_runout"]).conj(), planets)
    amplitude = add(amplitude, [pins], "sun_planet_mesh", runout)
    if many := length(errors["planet_flank"], -2):
        values = jnp.mean(planet_series(unit), axis=0)
        amplitude = add(amplitude, [h * pins for h in range(1, many + 1)], "sun_planet_mesh", values)
    # Eq. 5: teeth of the sun that meet all planets at once
    together = in_phase(length(errors["sun_flank"], -2), lumped.cranks)
    if together:
        values = -vector(errors["sun_flank"])[np.array(together) - 1]
        amplitude = add(amplitude, [h * sun_order(lumped) for h in together], "sun_planet_mesh", values)
    # Eq. 6: journals, carried round by their cranks
    eccentric = np.outer(waves(lumped.discs, 1), waves(lumped.cranks, -1))  # of disc j, seen from crank i
    back = -mean_of(_complex(errors["crank_eccentricity"]), eccentric) * turned(phase)
    amplitude = add(amplitude, [pins], "arm_radial", back.conj())
    amplitude = add(amplitude, [pins], "arm_tangential", 1j * back.conj())
    # Eq. 7: bores, seen from the eccentric
    bore = vector(errors["disc_bore"])
    forth = mean_of(bore, eccentric.conj()) * turned(-phase)
    amplitude = add(amplitude, [pins], "arm_along", forth)
    amplitude = add(amplitude, [pins], "arm_across", -1j * forth)
    # Eq. 8: teeth of the discs, round which the eccentric turns
    centre = 1j * turned(lumped.force_angle) * mean_of(-vector(errors["disc_centre"]), discs.conj()) * turned(-phase)
    amplitude = add(amplitude, [pins], "disc_pin_mesh", centre)
    if many := length(errors["disc_flank"], -2):
        h = list(range(1, many + 1))
        met = jnp.stack([constants(waves(lumped.discs, -n), like) for n in h], axis=1)
        values = jnp.mean(vector(errors["disc_flank"]) * met, axis=0) * turned(-jnp.asarray(h, phase.dtype) * phase)
        amplitude = add(amplitude, [n * pins for n in h], "disc_pin_mesh", values)
    # Eq. 9: the ring, which all discs meet at once
    if together := in_phase(length(errors["ring_flank"], -2), lumped.discs):
        around = turned(-jnp.asarray(together, phase.dtype) * phase)
        values = vector(errors["ring_flank"])[np.array(together) - 1] * around
        amplitude = add(amplitude, [m * teeth for m in together], "disc_pin_mesh", values)
    harmonics = pin_orders(unit, pin_harmonics)
    ring = series(lumped, unit.shortening, np.array([0, *harmonics]), errors["pin_offset"], errors["pin_radii"])
    amplitude = add(amplitude, [m * teeth for m in harmonics], "disc_pin_mesh", ring[1:])

    support = mean_of(vector(errors["carrier_bore"]), planets)
    arm = mean_of(bore, np.ones((lumped.discs, lumped.cranks)))
    along = -mean_of(_complex(errors["crank_eccentricity"]), np.ones((lumped.discs, lumped.cranks))).real
    across = -lumped.eccentricity * jnp.mean(errors["crank_phase"])
    none = jnp.zeros_like(along)
    parts = [none, support.real, support.imag, arm.real, arm.imag, along, across, ring[0].real]
    return amplitude, jnp.stack(parts)


def planet_series(unit: Unit) -> jax.Array:
    """Phasors of each planet's flank series at h pins (cranks, h): -(-1)^h conj c_ih."""
    value = vector(unit.errors["planet_flank"])
    sign = -((-1.0) ** np.arange(1, value.shape[1] + 1))
    return value.conj() * constants(sign, value)[None, :]


def vector(value: jax.Array) -> jax.Array:
    """[x, y], [radial, tangential] or [a, b] as one complex number; a scalar gives both components."""
    return _complex(value, value) if jnp.ndim(value) == 0 else _complex(value[..., 0], value[..., 1])


def mean_of(values: jax.Array, wave: np.ndarray) -> jax.Array:
    """Mean over the members of `values` times a wave of roots of one; () values are those of every member."""
    if values.ndim == 0:
        return values * round(abs(wave.mean()))  # 0 or 1: no rounding is left of what cancels
    return jnp.mean(values * constants(wave, values))


def turned(angle: Scalar) -> jax.Array:
    """e^{i angle}."""
    return _complex(jnp.cos(angle), jnp.sin(angle))


def _complex(real: jax.Array, imaginary: jax.Array | None = None) -> jax.Array:
    return jax.lax.complex(real, jnp.zeros_like(real) if imaginary is None else imaginary)


NODES = 256  # of the quadrature, and one more for each harmonic: K1 = 0.99 to 1e-9, K1 <= 0.95 to rounding


def series(
    lumped: Lumped, shortening: jax.Array, harmonics: np.ndarray, offset: jax.Array, radii: jax.Array
) -> jax.Array:
    """Phasors (harmonics,) of the disc-pin mesh at orders m disc_teeth, Eqs. 10 and 11; harmonic 0 is the constant.

    Args:
        lumped: counts, force angle and disc phase are read.
        shortening: K1, (), between 0 and 1.
        harmonics: m, each zero or a multiple of the discs.
        offset: of the pins, (pins, 2) or () m.
        radii: of the pins, (pins,) or () m.
    """
    pins = lumped.disc_teeth + 1
    nodes, weights = leggauss(NODES + int(harmonics.max()))
    chi = np.pi * (1.5 + nodes / 2)
    cosine, sine = (jnp.asarray(f(chi), shortening.dtype) for f in (np.cos, np.sin))
    size = jnp.sqrt(1 + shortening * shortening - 2 * shortening * cosine)
    normal = -sine / size
    weight = jnp.asarray(weights / 4, shortening.dtype)  # (1/2 pi) integral over (pi, 2 pi)
    share = jnp.cos(lumped.force_angle) * normal / (pins * jnp.sum(weight * normal * normal))  # Eq. 10
    seen = jnp.stack([(shortening * cosine - 1) / size, shortening * normal, jnp.ones_like(size)])
    turn = np.exp(-1j * np.outer(chi, harmonics))
    real, imaginary = (
        jnp.matmul(seen * (share * weight)[None, :], jnp.asarray(part, share.dtype)) for part in (turn.real, turn.imag)
    )

    sign = np.where(harmonics % 2, -1.0, 1.0)  # pin 0 lies at pi
    around = sign[:, None] * roots_of_one(pins, np.outer(harmonics, np.arange(pins)))
    plane = vector(offset)
    sums = jnp.stack([_sum(x, around) for x in (plane.real, plane.imag, radii)])
    phase = jnp.asarray(-harmonics, share.dtype) * lumped.disc_phase
    factor = jnp.asarray(np.where(harmonics == 0, 1.0, 2.0), phase.dtype)
    turned = jax.lax.complex(factor * jnp.cos(phase), factor * jnp.sin(phase))
    return turned * jnp.sum(jax.lax.complex(real, imaginary) * sums, axis=0)  # Eq. 11


def _sum(values: jax.Array, waves: np.ndarray) -> jax.Array:
    """sum_p x_p e^{i m a_p} (harmonics,); pins alike leave multiples of their number."""
    if jnp.ndim(values) == 0:
        exact = np.round(waves.sum(axis=1).real)
        return jax.lax.complex(values * jnp.asarray(exact, values.dtype), jnp.zeros(len(exact), values.dtype))
    return jax.lax.complex(*(jnp.asarray(part, values.dtype) @ values for part in (waves.real, waves.imag)))
