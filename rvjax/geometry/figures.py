"""Figures of a design without errors, from closed forms."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.flank import Ground, modified, relative_radius
from rvjax._reducer.plausible import checked
from rvjax.designs import Contact, CycloidStage, InvoluteStage, RVReducer, expect
from rvjax.records import Array, PyTree, Record, Scalar, field, promote, record
from rvjax.status import SolveInfo, Status, admit

PLACES = 2048  # of a pin along a flank, of which the one with the largest value is refined


@record
class Figures(Record):
    """Size, space and nominal load of a design."""

    shortening: Array = field("-", "K1")
    convex_radius: Array = field("m", "least radius of the convex flank; <= 0 is undercut")
    pin_gap: Array = field("m", "between neighbouring pins; < 0 they overlap")
    crank_room: Array = field("m", "from the crank axes to the roots of the disc teeth")
    flank_slope: Array = field("-", "largest slope of the harmonics of the profile modification; 0 without them")
    envelope_diameter: Array = field("m", "over the pins of the ring")
    contact_ratio: Array = field("-", "of sun and planet, teeth without shift")
    envelope_volume: Array | None = field("m3", "over the pins, along all discs; None without contact")
    pin_pressure: Array | None = field("Pa", "largest of a pin, rigid discs; None without contact")
    mass: Array | None = field("kg", "of all parts that turn; None without inertia")
    info: SolveInfo = field("-", "status", kind="record")


@checked
def figures(design: RVReducer, output_torque: Scalar = 0.0) -> Figures:
    """Figures of a design without errors.

    Curvature is that of the flank as ground: an equidistant modification moves it along its normal, a shift
    modification grinds it on another pin circle, harmonics add their own. The pressure is that of rigid discs: the
    force of a pin in proportion to its lever about the disc centre, line contact of pin and flank, the largest value
    while the cranks pass a pitch.

    Args:
        design: involute stage, cycloid stage, cranks, contact and inertia are read.
        output_torque: () N m; its sign does not count.

    Returns:
        Figures. All are NaN with status NONFINITE (a number that is read is NaN or inf) or INVALID_GEOMETRY (K1 outside
        (0, 1), or a length or modulus that must be positive is not). With UNDERCUT only the pressure is NaN.

    Raises:
        ValueError: no RV reducer, or other than one tooth of difference between ring and disc.
    """
    expect(design, "geometry.figures", RVReducer)
    cycloid = design.cycloid
    if cycloid.pin_count != cycloid.disc_teeth + 1:
        raise ValueError(
            f"CycloidStage.pin_count = {cycloid.pin_count}: must be disc_teeth + 1 = {cycloid.disc_teeth + 1}"
        )
    contact = design.contact and design.contact.replace(pin_stiffness=None, pin_support=None)
    read = design.involute, cycloid, design.cranks.replace(bearing_stiffness=None), contact, _masses(design)
    return _figures((*read, output_torque))


def _masses(design: RVReducer) -> list[Any] | None:
    """Masses of all rotating parts."""
    inertia, cranks = design.inertia, (design.cranks.count,)
    if inertia is None:
        return None
    sizes = {"sun": (), "planet": cranks, "crank": cranks, "disc": (design.cycloid.disc_count,), "output": ()}
    return [jnp.broadcast_to(getattr(inertia, f"{part}_mass"), size) for part, size in sizes.items()]


@partial(jax.jit, inline=True)
def _figures(read: PyTree) -> Figures:
    read = promote(read)
    gears, cycloid, cranks, contact, masses, torque = read
    k1, circle = cycloid.shortening_coefficient, cranks.circle_radius
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(read)]))
    positive = [cycloid.eccentricity, cycloid.pin_circle_radius, cycloid.pin_radius, circle]
    positive += [gears.module, gears.centre_distance, gears.sun_base_radius, gears.planet_base_radius]
    positive += [] if contact is None else [contact.young_modulus, contact.face_width, 1 - contact.poisson_ratio**2]
    possible = (k1 > 0) & (k1 < 1) & jnp.all(jnp.stack(positive) > 0) & (jnp.cos(gears.pressure_angle) > 0)
    checks = (~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY)
    (gears, cycloid, cranks, contact, masses, torque), gate = admit(read, _harmless(read), *checks)

    k1, pins, circle = cycloid.shortening_coefficient, cycloid.pin_count, cranks.circle_radius
    ring, pin = cycloid.pin_circle_radius, cycloid.pin_radius
    ground = Ground.of(cycloid)
    plain = ground.least_convex(pins)
    convex, steepest, hollow = _of_flank(cycloid, ground, plain)
    found: dict[str, Any] = dict(
        shortening=k1,
        convex_radius=convex,
        pin_gap=2 * (ring * math.sin(math.pi / pins) - pin),
        crank_room=ring - pin - cycloid.eccentricity - circle,
        flank_slope=steepest,
        envelope_diameter=2 * (ring + pin),
        contact_ratio=contact_ratio(gears),
        envelope_volume=None,
        mass=None if masses is None else sum(map(jnp.sum, masses)),
    )
    if contact is not None:
        found["envelope_volume"] = math.pi * (ring + pin) ** 2 * cycloid.disc_count * contact.face_width
    found, info = gate.close(found)
    pressure, sharp = None, convex <= 0
    if contact is not None:
        thin = jnp.where(sharp, (ground.offset + plain) / 2, ground.offset)
        share = cycloid.disc_teeth / (cycloid.disc_count * (pins + gears.sun_teeth / gears.planet_teeth))
        square = _pressure(cycloid, ground._replace(offset=thin), contact, jnp.abs(torque) * share)
        narrow = hollow * pin >= 1  # no pin fits into a hollow of the harmonics
        pressure, info = gate.close(square, (sharp, Status.UNDERCUT), (narrow, Status.INVALID_GEOMETRY))
    return Figures(**found, pin_pressure=pressure, info=info)


def _harmless(read: PyTree) -> PyTree:
    """A reducer that exists, in the place of one that does not."""
    gears, cycloid, _, contact, *_ = ones = jax.tree.map(jnp.ones_like, read)
    harmonics = None if cycloid.profile_modification is None else jnp.zeros_like(cycloid.profile_modification)
    cycloid = cycloid.replace(
        eccentricity=0.5 / cycloid.pin_count,
        pin_radius=0.1 / cycloid.pin_count,
        equidistant_modification=0.0,
        shift_modification=0.0,
        profile_modification=harmonics,
        shortening=None if cycloid.shortening is None else 0.5,
    )
    gears = gears.replace(sun_base_radius=0.3, planet_base_radius=0.6, pressure_angle=0.35)
    return gears, cycloid, ones[2], contact and contact.replace(poisson_ratio=0.3), *ones[4:]


def contact_ratio(gears: InvoluteStage) -> Array:
    """Transverse contact ratio of sun and planet at their centre distance, tips of standard height."""
    bases = jnp.stack([jnp.asarray(gears.sun_base_radius), jnp.asarray(gears.planet_base_radius)])
    tips = gears.module * jnp.asarray(np.array([gears.sun_teeth, gears.planet_teeth]) / 2 + 1, bases.dtype)
    square = tips**2 - bases**2
    path = jnp.sum(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0))
    # a0 sin(alpha_w), with a0 cos(alpha_w) the sum of the base radii
    line = gears.centre_distance**2 - jnp.sum(bases) ** 2
    path -= jnp.where(line > 0, jnp.sqrt(jnp.where(line > 0, line, 1)), 0)
    return path / (gears.module * jnp.pi * jnp.cos(gears.pressure_angle))


def _of_flank(cycloid: CycloidStage, ground: Ground, plain: Array) -> tuple[Array, Array, Array]:
    """Least radius of the convex flank, m, largest slope of its harmonics, and its largest hollow curvature, 1/m.

    `plain` is the radius without harmonics; an undercut flank has no other.
    """
    if cycloid.profile_modification is None:
        return plain, jnp.zeros_like(plain), jnp.zeros_like(plain)
    whole = ground._replace(offset=jnp.where(plain > 0, ground.offset, (ground.offset + plain) / 2))

    def along(psi: Array) -> tuple[Array, Array, Array]:
        bend, slope = modified(whole, cycloid, jnp.cos(psi), jnp.sin(psi))
        return bend, jnp.abs(slope), -bend

    step = np.pi / PLACES
    grid = jnp.asarray(step * np.arange(PLACES + 1), plain.dtype)

    def largest(k: int) -> Array:
        return along(_largest(lambda psi: along(psi)[k], grid, step))[k]

    bend, slope, hollow = map(largest, range(3))
    return jnp.where((plain > 0) & (bend > 0), 1 / jnp.where(bend > 0, bend, 1), plain), slope, hollow


def _largest(function: Callable[[Array], Array], grid: Array, step: float) -> Array:
    """Place where a function of the lobe angle is largest: the best of a grid, refined by parabolas."""
    place = jax.lax.stop_gradient(grid[jnp.argmax(function(grid))])
    for width in (step, step / 32):
        low, mid, high = jax.lax.stop_gradient(function(place + jnp.asarray([-width, 0, width], grid.dtype)))
        bow = low - 2 * mid + high
        place += width * jnp.where(bow < 0, jnp.clip((low - high) / (2 * jnp.where(bow < 0, bow, -1)), -1, 1), 0)
    return place


def _pressure(cycloid: CycloidStage, ground: Ground, contact: Contact, disc_torque: Array) -> Array:
    """Largest pressure of a pin, rigid discs; () Pa.

    F = M l/sum l^2 over the loaded pins, l = e zc sin(psi)/S; p^2 = F E/(2 pi L (1 - nu^2) R*). The best of a grid of
    places of the most loaded pin is refined by parabolas through its neighbours; the derivative is that at the place.
    """
    pins, k1 = cycloid.pin_count, jnp.asarray(cycloid.shortening_coefficient)
    dtype, pin = k1.dtype, jnp.asarray(cycloid.pin_radius)
    each = max(8, PLACES // pins)

    def squared(psi: Array) -> Array:
        """p^2 with a pin at lobe angles psi (n,), per M E/(2 pi L (1 - nu^2))."""
        angles = psi[:, None] + jnp.asarray(2 * np.pi * np.arange(pins)[None] / pins, dtype)
        size = jnp.sqrt((1 - k1) ** 2 + 4 * k1 * jnp.sin(angles / 2) ** 2)
        lever = jnp.asarray(cycloid.eccentricity) * cycloid.disc_teeth * jnp.maximum(jnp.sin(angles), 0) / size
        bend, _ = modified(ground, cycloid, jnp.cos(psi), jnp.sin(psi))
        return lever[:, 0] / jnp.sum(lever**2, axis=1) / relative_radius(pin, bend)

    step = 2 * np.pi / (each * pins)
    place = _largest(squared, jnp.asarray(step * np.arange(1, each * pins // 2), dtype), step)
    load = disc_torque * contact.young_modulus / (2 * jnp.pi * contact.face_width * (1 - contact.poisson_ratio**2))
    square = load * squared(place[None])[0]
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
