"""Flank and pins of the ring, with the record of the figures: the same for all reducers with cycloid discs."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.designs import Contact, CycloidStage
from rvjax.flank import Ground, modified, relative_radius
from rvjax.records import Array, Record, Scalar, field, record
from rvjax.status import Gate, SolveInfo, Status

PLACES = 2048  # of a pin along a flank, of which the one with the largest value is refined


@record
class Figures(Record):
    """Size, space and nominal load of a design."""

    shortening: Array = field("-", "K1")
    convex_radius: Array = field("m", "least radius of the convex flank; <= 0 is undercut")
    pin_gap: Array = field("m", "between neighbouring pins; < 0 they overlap")
    crank_room: Array | None = field("m", "from the crank axes to the roots of the disc teeth; None: single stage")
    flank_slope: Array = field("-", "largest slope of the harmonics of the profile modification; 0 without them")
    envelope_diameter: Array = field("m", "over the pins of the ring")
    contact_ratio: Array | None = field("-", "of sun and planet, teeth without shift; None: single stage")
    envelope_volume: Array | None = field("m3", "over the pins, along all discs; None without contact")
    pin_pressure: Array | None = field("Pa", "largest of a pin, rigid discs; None without contact")
    mass: Array | None = field("kg", "of all parts that turn; None without inertia")
    info: SolveInfo = field("-", "status", kind="record")
    hole_gap: Array | None = field("m", "between neighbouring holes; < 0 they overlap; None: RV", default=None)
    hole_wall: Array | None = field("m", "of a disc outside the holes; <= 0 they break out; None: RV", default=None)
    hole_pressure: Array | None = field(
        "Pa", "largest of an output pin, rigid discs; None: RV, or without contact", default=None
    )
    eccentric_force: Array | None = field(
        "N", "mean of an eccentric bearing, forces in proportion to the arm; None: RV", default=None
    )


def of_flank(cycloid: CycloidStage, ground: Ground, plain: Array) -> tuple[Array, Array, Array]:
    """Least radius of the convex flank, m, largest slope of its harmonics, and its largest hollow curvature, 1/m.

    An undercut flank has no other radius than that without harmonics.

    Args:
        cycloid: its harmonics.
        ground: flank without them.
        plain: its least convex radius, () m.
    """
    if cycloid.profile_modification is None:
        return plain, jnp.zeros_like(plain), jnp.zeros_like(plain)
    whole = ground._replace(offset=jnp.where(plain > 0, ground.offset, (ground.offset + plain) / 2))

    def along(k: int, psi: Array, given: tuple[Ground, CycloidStage]) -> Array:
        bend, slope = modified(*given, jnp.cos(psi), jnp.sin(psi))
        return (bend, jnp.abs(slope), -bend)[k]

    grid = np.pi / PLACES * np.arange(PLACES + 1)
    bend, slope, hollow = (largest(functools.partial(along, k), grid, (whole, cycloid)) for k in range(3))
    return jnp.where((plain > 0) & (bend > 0), 1 / jnp.where(bend > 0, bend, 1), plain), slope, hollow


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def largest(function: Callable[[Array, object], Array], grid: np.ndarray, given: object) -> Array:
    """Largest value of a function of the lobe angle; its derivative is that at the place of the largest value.

    Args:
        function: of angles (n,) rad and `given`, to values (n,).
        grid: evenly spaced, (n,) rad; its best angle is refined.
        given: what the function has derivatives to.
    """
    return function(_place(function, grid, given)[None], given)[0]


@largest.defjvp
def _largest_jvp(
    function: Callable[[Array, object], Array],
    grid: np.ndarray,
    primals: tuple[jax.Array, ...],
    tangents: tuple[jax.Array, ...],
) -> tuple[Array, Array]:
    place = _place(function, grid, *primals)
    return jax.jvp(lambda given: function(place[None], given)[0], primals, tangents)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _place(function: Callable[[Array, object], Array], grid: np.ndarray, given: object) -> Array:
    """The best of a grid, refined by parabolas."""
    dtype, step = jax.tree.leaves(given)[0].dtype, float(grid[1] - grid[0])
    place = jnp.asarray(grid, dtype)[jnp.argmax(function(jnp.asarray(grid, dtype), given))]
    for width in (step, step / 32):
        low, mid, high = function(place + jnp.asarray([-width, 0, width], dtype), given)
        bow = low - 2 * mid + high
        place += width * jnp.where(bow < 0, jnp.clip((low - high) / (2 * jnp.where(bow < 0, bow, -1)), -1, 1), 0)
    return place


@_place.defjvp
def _place_jvp(
    function: Callable[[Array, object], Array],
    grid: np.ndarray,
    primals: tuple[jax.Array, ...],
    tangents: tuple[jax.Array, ...],
) -> tuple[Array, Array]:
    """Second derivatives of the value need dplace = -df' / f'', from f' = 0."""
    place = _place(function, grid, *primals)

    def rate(place: Array, given: object) -> Array:
        return jax.jvp(lambda psi: function(psi[None], given)[0], (place,), (jnp.ones_like(place),))[1]

    bow = jax.jvp(lambda psi: rate(psi, *primals), (place,), (jnp.ones_like(place),))[1]
    change = jax.jvp(lambda given: rate(place, given), primals, tangents)[1]
    return place, jnp.where(bow < 0, -change / jnp.where(bow < 0, bow, -1), 0)


def pressure(cycloid: CycloidStage, ground: Ground, contact: Contact, disc_torque: Array) -> Array:
    """Largest pressure of a pin, rigid discs; () Pa.

    F = M l/sum l^2 over the loaded pins, l = e zc sin(psi)/S; p^2 = F E/(2 pi L (1 - nu^2) R*). Largest of all
    places of the most loaded pin.
    Pins of another material: 1/(pi L (s1 + s2)) in place of E/(2 pi L (1 - nu^2)), s = (1 - nu^2)/E of either.

    Args:
        cycloid: counts, eccentricity and radius of the pins.
        ground: flank without harmonics.
        contact: of discs and pins.
        disc_torque: of one disc, () N m.
    """
    pins = cycloid.pin_count
    each = max(8, PLACES // pins)

    def squared(psi: Array, given: tuple[CycloidStage, Ground]) -> Array:
        """p^2 with a pin at lobe angles psi (n,), per M E/(2 pi L (1 - nu^2))."""
        cycloid, ground = given
        k1 = jnp.asarray(cycloid.shortening_coefficient)
        angles = psi[:, None] + jnp.asarray(2 * np.pi * np.arange(pins)[None] / pins, k1.dtype)
        size = jnp.sqrt((1 - k1) ** 2 + 4 * k1 * jnp.sin(angles / 2) ** 2)
        lever = jnp.asarray(cycloid.eccentricity) * cycloid.disc_teeth * jnp.maximum(jnp.sin(angles), 0) / size
        bend, _ = modified(ground, cycloid, jnp.cos(psi), jnp.sin(psi))
        return lever[:, 0] / jnp.sum(lever**2, axis=1) / relative_radius(jnp.asarray(cycloid.pin_radius), bend)

    grid = 2 * np.pi / (each * pins) * np.arange(1, each * pins // 2)
    return root(disc_torque * squared_pressure(contact) * largest(squared, grid, (cycloid, ground)))


def squared_pressure(contact: Contact) -> Array:
    """Square of the largest pressure for 1 N and a relative radius of 1 m, Pa/m: 1/(pi L (s1 + s2)), s = (1 - nu^2)/E.

    Args:
        contact: of discs and pins.
    """
    if contact.pin_young_modulus is None:  # 2 s1, in the order of operations of one material
        stiff = contact.young_modulus * contact.face_width / (1 - contact.poisson_ratio**2)
        return jnp.asarray(stiff / (2 * jnp.pi * contact.face_width**2))
    disc, pin = contact.compliances
    return jnp.asarray(1 / (jnp.pi * contact.face_width * (disc + pin)))


def root(square: Array) -> Array:
    """Square root with derivative 0 at 0.

    Args:
        square: () >= 0.
    """
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def of_ring(
    cycloid: CycloidStage, contact: Contact | None, disc_torque: Array, gate: Gate
) -> tuple[dict[str, Any], Array | None, SolveInfo]:
    """Figures of flank and ring, the pressure of the pins, and the status; for `Figures`.

    Args:
        cycloid: admitted numbers.
        contact: of discs and pins; None: no pressure and no volume.
        disc_torque: of the pins on one disc, () N m.
        gate: of all numbers that are read.
    """
    pins, ring, pin = cycloid.pin_count, cycloid.pin_circle_radius, cycloid.pin_radius
    ground = Ground.of(cycloid)
    plain = ground.least_convex(pins)
    convex, steepest, hollow = of_flank(cycloid, ground, plain)
    values: dict[str, Any] = dict(
        shortening=cycloid.shortening_coefficient,
        convex_radius=convex,
        pin_gap=2 * (ring * math.sin(math.pi / pins) - pin),
        flank_slope=steepest,
        envelope_diameter=2 * (ring + pin),
        envelope_volume=None,
    )
    if contact is not None:
        values["envelope_volume"] = math.pi * (ring + pin) ** 2 * cycloid.disc_count * contact.face_width
    values, info = gate.close(values)
    if contact is None:
        return values, None, info
    sharp = convex <= 0
    thin = jnp.where(sharp, (ground.offset + plain) / 2, ground.offset)
    square = pressure(cycloid, ground._replace(offset=thin), contact, disc_torque)
    narrow = hollow * pin >= 1  # no pin fits into a hollow of the harmonics
    return values, *gate.close(square, (sharp, Status.UNDERCUT), (narrow, Status.INVALID_GEOMETRY))


def material(contact: Contact | None) -> list[Scalar]:
    """Numbers of a contact that must be positive.

    Args:
        contact: of discs and pins.
    """
    if contact is None:
        return []
    own = [contact.young_modulus, contact.face_width, 1 - contact.poisson_ratio**2]
    if contact.pin_young_modulus is None or contact.pin_poisson_ratio is None:
        return own
    return [*own, contact.pin_young_modulus, 1 - contact.pin_poisson_ratio**2]


def of_steel(contact: Contact) -> Contact:
    """A contact of ones with the Poisson ratio of steel.

    Args:
        contact: ones.
    """
    other = contact.pin_poisson_ratio
    return contact.replace(poisson_ratio=0.3, pin_poisson_ratio=None if other is None else 0.3 * other)


def harmless(cycloid: CycloidStage) -> CycloidStage:
    """A cycloid stage that exists, in the place of one that does not, with a pin circle radius of 1 m.

    Args:
        cycloid: ones.
    """
    harmonics = None if cycloid.profile_modification is None else jnp.zeros_like(cycloid.profile_modification)
    return cycloid.replace(
        eccentricity=0.5 / cycloid.pin_count,
        pin_radius=0.1 / cycloid.pin_count,
        equidistant_modification=0.0,
        shift_modification=0.0,
        profile_modification=harmonics,
        shortening=None if cycloid.shortening is None else 0.5,
    )
