"""Free angle of the output, input locked, when the load reverses; its output in studies."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from rvjax._jax.elementary import nonnegative
from rvjax.base.words import choose
from rvjax.catalogue import RV_20E, checked
from rvjax.designs import CycloidStage, RVReducer, expect
from rvjax.errors import RVErrors, read_by
from rvjax.lost_motion.terms import (
    FLANK_TERMS,
    STEPS,
    Flank,
    LostMotionTerms,
    Teeth,
    Unit,
    contributions,
    first_order_minimum,
    minimum,
)
from rvjax.outputs import KNOWN_ERROR, Cases, Description, Output, Solved, Way, condition
from rvjax.records import Array, Record, Scalar, field, promote, record
from rvjax.status import SolveInfo, Status, admit, converged, window
from rvjax.units import um

READINGS = ("consistent", "as_printed")
PROFILES = ("first_order", "closed_form", "contact")


@record
class LostMotion(Record):
    """Lost motion of one unit at its output."""

    total: Array = field("rad", "free angle; < 0 is interference (preload)")
    play: Array = field("rad", "max(0, total); at 0 with the slopes of the total")
    terms: LostMotionTerms = field("-", "every contribution", kind="record")
    valid: Array = field("-", "true where the status is CONVERGED", kind="integer")
    info: SolveInfo = field("-", "steps and slope left are those of the contact search", kind="record")


@checked
def geometric(
    design: RVReducer,
    errors: RVErrors,
    *,
    reading: str = "consistent",
    profile: str = "first_order",
    tilt: Scalar = 0.0,
    centre_shift: Scalar = 0.0,
    normal_force: Scalar | None = None,
) -> LostMotion:
    """Lost motion from involute stage, cycloid stage and crank bearings (Liu et al. 2022, Eq. 21).

    Args:
        design: the reducer; involute stage and cycloid stage are read.
        errors: of its parts; bearing clearance, the eccentricity of discs and cranks alike, and every
            error of pins, disc profile and base tangent are read.
        reading: "consistent" puts every term in radians; "as_printed" follows Eq. 16, 17 and 21 to the
            letter, including its errors of units and brackets, to reproduce the published value.
        profile: "first_order", the sum of the paper; "closed_form", the first-order minimum over the flank, with
            K1 in proportion to the eccentricity, error included; "contact", the exact minimum over the flank, with
            K1 = e z_p / r_p even where the design overrides it.
        tilt: of the input shaft, beta, rad; see `shaft_tilt`.
        centre_shift: radial displacement of sun against planet, a1, m.
        normal_force: mesh force on the planet, N, from which "as_printed" reads a pressure angle (Eq. 11) with
            an inertia calibrated for the RV-20E; without it the pressure angle is that of the design.

    Returns:
        LostMotion. `total`, `play` and terms are NaN with status NONFINITE (a number that is read is NaN or inf),
        INVALID_GEOMETRY (K1 outside (0, 1), a radius, force or cosine that must be positive is not, or deviations so
        large that no point of the flank reaches the pins), and, for "closed_form" and "contact", NOT_ASSEMBLABLE
        (tooth tips or roots interfere at any angle) or MAX_STEPS.
        With PRESSURE_ANGLE (Eq. 11 gives a cosine above 1) they are kept, but `valid` is false.

    Raises:
        ValueError: unknown reading or profile; "as_printed" with another profile than "first_order"; normal_force
            with "consistent"; a flank profile for other than one tooth of difference; no more pins than teeth.
    """
    _check_methods(design, reading, profile, normal_force)
    numbers = (design.involute, design.cycloid, errors, tilt, centre_shift, normal_force)
    return _geometric(numbers, reading=reading, profile=profile)


@partial(jax.jit, inline=True, static_argnames=("reading", "profile"))
def _geometric(numbers: object, *, reading: str, profile: str) -> LostMotion:
    involute, cycloid, parts, tilt, shift, force = promote(numbers)
    counts = (involute.sun_teeth, involute.planet_teeth, cycloid.disc_teeth, cycloid.pin_count)
    teeth = Teeth(*map(float, counts))
    unit = Unit(
        alpha=involute.pressure_angle if force is None else None,
        force=force,
        a0=involute.centre_distance,
        a1=shift,
        r1=involute.sun_radius,
        e=cycloid.eccentricity,
        rp=cycloid.pin_circle_radius,
        given_k1=None if profile == "contact" else cycloid.shortening,
        equidistant=cycloid.equidistant_modification - _profile_at_contact(cycloid),
        shift=cycloid.shift_modification,
        tilt=tilt,
    )
    # Terms are at most of second order in lengths over the smallest radius: that must not overflow either.
    smallest = jnp.minimum(jnp.minimum(unit.e, unit.rp), jnp.minimum(unit.r1, unit.a0 + unit.a1))
    smallest = jnp.where(smallest > 0, smallest, 1)
    of_unit, of_parts = jax.tree.leaves(unit), [getattr(parts, name) for name in read_by(parts, "lost_motion")]
    # Where only terms are summed, design and errors are checked separately: the design stays unbatched.
    apart = profile == "first_order"
    alone = RVErrors() if apart else parts
    possible = (~_possible(unit, alone, teeth, profile), Status.INVALID_GEOMETRY)
    if apart:
        unit, gate = admit(unit, _harmless(teeth, unit), (~_finite(of_unit, smallest), Status.NONFINITE), possible)
        parts, gate = admit(parts, 0, (~_finite(of_parts, smallest), Status.NONFINITE), after=gate)
    else:
        refused = (~_finite(of_unit + of_parts, smallest), Status.NONFINITE), possible
        unit, gate = admit(unit, _harmless(teeth, unit), *refused)
        parts, gate = admit(parts, 0, after=gate)

    terms, cosine = contributions(unit, parts, teeth, reading)
    values = vars(terms)
    total = sum(values.values())
    found_wrong = [(cosine > 1, Status.PRESSURE_ANGLE)]
    steps, residual = 0, jnp.zeros_like(total)
    if profile != "first_order":
        flank = _flank(unit, parts, teeth, profile)
        assembles = flank.d <= flank.D  # else tooth tips or roots interfere at any rotation
        found_wrong += [(~assembles, Status.NOT_ASSEMBLABLE)]
        flank = flank._replace(D=jnp.where(assembles, flank.D, 0), d=jnp.where(assembles, flank.d, 0))
        if profile == "contact":
            found = minimum(flank)
            of_flank, steps, residual = found.play, STEPS, found.slope
            found_wrong += [(~found.reaches, Status.INVALID_GEOMETRY), (~found.converged, Status.MAX_STEPS)]
        else:
            of_flank = first_order_minimum(flank)
        replaced = sum(values[name] for name in FLANK_TERMS)
        total = of_flank + sum(value for name, value in values.items() if name not in FLANK_TERMS)
        terms = terms.replace(contact_remainder=of_flank - replaced)

    of_search = converged(residual, steps)
    (total, terms), info = gate.close((total, terms), *found_wrong, info=of_search)
    return LostMotion(total, nonnegative(total), terms, info.status == Status.CONVERGED, info)


@checked
@jax.jit
def shaft_tilt(deflection: Scalar, length: Scalar) -> jax.Array:
    """Tilt of a shaft from its radial deflection over a length: arcsin(Y / L), Liu et al. 2022, Eq. 1.

    Args:
        deflection: Y, () m, signed.
        length: L, () m, positive.

    Returns:
        Tilt, () rad with the sign of the deflection; NaN where |deflection| > length.
    """
    deflection, length = promote(deflection, length)
    possible = (jnp.abs(deflection) <= length) & (length > 0)
    tilt = jnp.arcsin(jnp.where(possible, deflection, 0) / jnp.where(possible, length, 1))  # Eq. 1
    return jnp.where(possible, tilt, jnp.nan)


def _check_methods(design: RVReducer, reading: str, profile: str, normal_force: Scalar | None) -> None:
    expect(design, "lost_motion.geometric", RVReducer)
    choose("reading", reading, READINGS)
    choose("profile", profile, PROFILES)
    if reading == "as_printed" and profile != "first_order":
        raise ValueError(f"profile = {profile!r}: reading 'as_printed' has the sum of terms only, 'first_order'")
    if reading == "consistent" and normal_force is not None:
        raise ValueError("normal_force: only reading 'as_printed' derives a pressure angle from a force")
    if design.cycloid.profile_modification is not None and (reading, profile) != ("consistent", "first_order"):
        raise ValueError(
            f"profile = {profile!r}, reading = {reading!r}: CycloidStage.profile_modification is read by reading "
            "'consistent' with 'first_order' only"
        )
    difference = design.cycloid.pin_count - design.cycloid.disc_teeth
    if profile != "first_order" and difference != 1:
        raise ValueError(f"profile = {profile!r}: needs one pin more than disc teeth, not {difference}")
    if difference < 1:
        raise ValueError(
            f"CycloidStage.pin_count = {design.cycloid.pin_count}: must exceed disc_teeth = {design.cycloid.disc_teeth}"
        )


def _profile_at_contact(cycloid: CycloidStage) -> Scalar:
    """Material of the profile modification where pins touch first: cos(psi) = K1, the least of S/sin(psi)."""
    if cycloid.profile_modification is None:
        return 0.0
    waves = [1.0, cycloid.shortening_coefficient]  # cos(f psi)
    for _ in range(3):
        waves.append(2 * waves[1] * waves[-1] - waves[-2])
    return jnp.stack(waves[1:]) @ jnp.broadcast_to(cycloid.profile_modification, (4,))


def _finite(numbers: list[jax.Array], smallest: jax.Array) -> jax.Array:
    """True if all are finite, and their squares over the smallest radius: a NaN or an infinity survives the sum."""
    read = jax.lax.stop_gradient(_stored(sum(jnp.abs(x) for x in numbers) / smallest))
    return read < window(read, 0.5)[1]


@jax.custom_jvp
def _stored(x: jax.Array) -> jax.Array:
    """x >= 0; where there is a derivative, stored.

    XLA does not repeat a costly operation, as the square root, in every kernel that needs its result: else each of
    the twelve sums of a gradient would read all errors. A value alone is found in one kernel, in one pass.
    """
    return x


@_stored.defjvp
def _stored_jvp(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
    (x,), (dx,) = primals, tangents
    return jnp.square(jnp.sqrt(x)), jnp.zeros_like(dx)


def _possible(unit: Unit, parts: RVErrors, teeth: Teeth, profile: str) -> jax.Array:
    """False where a length, force or cosine that must be positive is not, or K1 lies outside (0, 1)."""
    contact_angle = jnp.cos(unit.alpha) if unit.force is None else unit.force
    positive = [unit.e, unit.rp, unit.r1, unit.a0 + unit.a1, contact_angle]
    between = [unit.k1(teeth)]
    if profile != "first_order":
        flank = _flank(unit, parts, teeth, profile)
        positive += [flank.e, flank.ring, flank.ring + flank.d]
        between += [flank.k]
    possible = jnp.abs(unit.tilt) < jnp.pi / 2
    for value in positive + between:
        possible = possible & (value > 0)
    for value in between:
        possible = possible & (value < 1)
    return possible


def _harmless(teeth: Teeth, like: Unit) -> Unit:
    """Numbers on which every formula is finite: K1 = 1/2, nothing modified; None where `like` has it."""
    safe = Unit(
        alpha=0.0, force=1.0, a0=1.0, a1=0.0, r1=1.0, e=1.0, rp=2 * teeth.zp, given_k1=0.5,
        equidistant=0.0, shift=0.0, tilt=0.0,
    )  # fmt: skip
    return Unit(*(None if given is None else value for given, value in zip(like, safe)))


def _flank(unit: Unit, parts: RVErrors, teeth: Teeth, profile: str) -> Flank:
    """Flank as ground and pins as they are: every profile and pin deviation in the two lengths D and d."""
    e = unit.e + parts.eccentricity
    D = unit.equidistant + parts.equidistant_modification - parts.pin_radius + parts.pin_hole_clearance / 2
    d = unit.shift + parts.shift_modification - parts.pin_circle_radius
    ring = unit.rp + parts.pin_circle_radius
    k = e * teeth.zp / (ring + d) if profile == "contact" else unit.k1(teeth) * e / unit.e
    return Flank(e, ring, k, D, d, teeth.zc)


@dataclass(frozen=True)
class LostMotionConditions:
    """Method of the free angle."""

    lost_motion_profile: str = condition("first_order", "of the backlash between flanks and pins", choices=PROFILES)


def _lost_motion(design: RVReducer, errors: RVErrors, conditions: LostMotionConditions) -> Solved:
    result = geometric(design, errors, profile=conditions.lost_motion_profile)
    return result.total, result.info.status


FLANK = dict(  # Table 9 of Liu et al. 2022
    bearing_clearance=(0.0, 1 * um),
    eccentricity=(-5 * um, 5 * um),
    pin_circle_radius=(-10 * um, 10 * um),
    pin_radius=(-4 * um, 4 * um),
    pin_hole_clearance=(0.0, 5 * um),
    pin_position=(-5 * um, 5 * um),
    disc_runout=(0.0, 15 * um),
    disc_cumulative_pitch=(0.0, 19 * um),
    equidistant_modification=(-1 * um, 1 * um),
    shift_modification=(-3 * um, 3 * um),
    base_tangent_upper=(-31 * um, 3 * um),
    base_tangent_lower=(-31 * um, 3 * um),
)


def _cases(quick: bool) -> Sequence[Cases]:
    return [
        Cases(
            name="lost_motion",
            case="unit of the RV-20E with K1 = e z_p / r_p",
            outputs={"lost_motion": "rad"},
            design=RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=None)),
            errors=FLANK,
            conditions={},
            torque=None,
            ways=tuple(Way(name.replace("_", " "), dict(lost_motion_profile=name)) for name in PROFILES),
            batch=4096,
            calls=2 if quick else 9,
        )
    ]


DESCRIPTION = Description(
    name="lost_motion",
    design=RVReducer,
    conditions=LostMotionConditions,
    outputs={
        "lost_motion": Output(
            "rad",
            "free angle of the output, < 0: interference",
            _lost_motion,
            below_zero="interference, no backlash; teeth and bearings are preloaded by this angle",
            exact="bench_lost_motion",
            least=KNOWN_ERROR,
        )
    },
    cases=_cases,
    unknown="contact sequence (signed contributions are summed); load and deformation",
)
