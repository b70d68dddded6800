"""One four-bar linkage: two cranks, the disc as coupler, the carrier as frame.

The carrier is at rest, x runs from crank 1 to crank 3, angles are counter-clockwise. All formulas
take deviations from nominal, never the difference of two lengths, so that micrometres on 72 mm keep
their digits in float32.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import LARGEST_ANGLE, sin_cos
from rvjax.base.words import choose, unknown
from rvjax.catalogue import checked
from rvjax.four_bar import closures
from rvjax.records import Array, Record, Scalar, concrete, field, promote, quantity, record
from rvjax.status import SolveInfo, Status, admit, window

ALLOWED = {  # (cranks, branch): closures
    ("phase_locked", "open"): ("newton", "closed_form", "first_order"),
    ("free", "open"): ("newton", "closed_form", "quadratic", "first_order"),
    ("free", "crossed"): ("newton", "closed_form", "quadratic"),
    ("geared", "open"): ("newton", "first_order"),
}


@record
class LinkDeviations(Record):
    """Deviations of one linkage from the parallelogram."""

    crank_1: Scalar = field("m", "length of crank 1, d1", default=0.0)
    coupler: Scalar = field("m", "bore distance in the disc, d2", default=0.0)
    crank_3: Scalar = field("m", "length of crank 3, d3", default=0.0)
    frame: Scalar = field("m", "bore distance in the carrier, d4", default=0.0)
    crank_phase: Scalar = field("rad", "angle of crank 3 minus crank 1, psi; ignored by free cranks", default=0.0)
    frame_angle: Scalar = field("rad", "direction of the carrier bores, b4", default=0.0)
    joint: Array | tuple[Scalar, Scalar] = field(
        "m", "bore centre minus pin centre, crank 3 minus crank 1, (x, y)", shape=(2,), kind="pair", default=(0.0, 0.0)
    )


@record
class Closure(Record):
    """Position of the coupler."""

    coupler_angle: Array = field("rad", "direction of the coupler, b2, from the x axis")
    misfit: Array = field("m", "what the bearings must stretch: bore distance offered minus the disc's")
    gap: Array = field("m", "> 0: length a linkage with free cranks lacks to be assembled")
    info: SolveInfo = field("-", "how the solve ended", kind="record")


@checked
def solve_closure(
    eccentricity: Scalar,
    spacing: Scalar,
    deviations: LinkDeviations,
    *,
    crank_angle: Scalar,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Scalar | None = None,
    closure: str = "newton",
    branch: str = "open",
) -> Closure:
    """Coupler angle of one linkage with deviating links.

    Args:
        eccentricity: nominal length of both cranks, e, () m.
        spacing: nominal length of coupler and frame, l, () m.
        deviations: of the links.
        crank_angle: of crank 1 from the x axis, () rad.
        cranks: "phase_locked" (both geared rigidly to the sun; least-squares position), "free" (crank 3
            follows, the source's model), or "geared" (gears of finite stiffness between the two).
        gear_stiffness_ratio: torsional stiffness of the gear path over half the bearing stiffness times e
            squared, () > 0; for "geared" only.
        closure: "newton" or "closed_form" (both exact), "quadratic" (S2), "first_order".
        branch: "open" (parallelogram) or "crossed" (free cranks only).

    Returns:
        Closure. Status NONFINITE, INVALID_GEOMETRY, NOT_ASSEMBLABLE, MAX_STEPS: the angle is NaN.
        CHANGE_POINT (free cranks in line with the frame) and SINGULAR (fold: the linkage just closes):
        the angle is a root, its derivative is not to be used. `first_order` has no root to lose and
        keeps its value where the linkage cannot be assembled.

    Raises:
        ValueError: a combination of methods that does not exist, or, where every number is concrete, an
            impossible length.
    """
    methods = check_methods(cranks, gear_stiffness_ratio, closure, branch)
    _check_lengths(cranks, eccentricity, spacing, deviations)
    return _solve_closure((eccentricity, spacing, deviations, crank_angle, gear_stiffness_ratio), **methods)


@partial(jax.jit, inline=True, static_argnames=("cranks", "closure", "branch"))
def _solve_closure(numbers: object, **methods: str) -> Closure:
    e, spacing, deviations, angle, ratio = promote(numbers)
    return close(e, spacing, deviations, closures.crank_direction(angle), ratio, **methods)


def check_methods(
    cranks: str, gear_stiffness_ratio: Scalar | None, closure: str, branch: str, *, count: int = 2
) -> dict[str, str]:
    """Return the methods by name.

    Raises:
        ValueError: they do not fit together, or not `count` cranks.
    """
    if count > 2 and cranks != "phase_locked":
        raise ValueError(f"cranks = {cranks!r}: {count} cranks can only be 'phase_locked'")
    choose("cranks", cranks, dict.fromkeys(kind for kind, _ in ALLOWED))
    choose("branch", branch, ("open", "crossed"))
    allowed = ALLOWED.get((cranks, branch), ())
    if not allowed:
        raise ValueError(f"branch = {branch!r}: cranks = {cranks!r} has the open branch only")
    if closure not in allowed:
        where = f"closure = {closure!r}, branch = {branch!r}: cranks = {cranks!r}"
        raise unknown(where, closure, allowed, " has the closures")
    if cranks != "geared" and gear_stiffness_ratio is not None:
        raise ValueError(f"gear_stiffness_ratio: cranks = {cranks!r} has no use for it; it belongs to 'geared'")
    if cranks == "geared" and gear_stiffness_ratio is None:
        raise ValueError("gear_stiffness_ratio: needed for cranks = 'geared'")
    if gear_stiffness_ratio is not None and concrete(gear_stiffness_ratio) and np.any(gear_stiffness_ratio <= 0):
        raise ValueError(f"gear_stiffness_ratio = {quantity(gear_stiffness_ratio, '-')}: must be positive")
    return dict(cranks=cranks, closure=closure, branch=branch)


def _check_lengths(cranks: str, eccentricity: Scalar, spacing: Scalar, deviations: LinkDeviations) -> None:
    """Check concrete lengths; a zero crank is a limit that a status describes."""
    lengths = {
        "spacing": (spacing,),
        "spacing + coupler": (spacing, deviations.coupler),
        "spacing + frame": (spacing, deviations.frame),
    }
    if cranks == "free":
        lengths["eccentricity + crank_1"] = (eccentricity, deviations.crank_1)
        lengths["eccentricity + crank_3"] = (eccentricity, deviations.crank_3)
    for name, parts in lengths.items():
        if concrete(*parts):
            total = sum(np.asarray(part, float) for part in parts)
            if np.any(total < 0) or (name.startswith("spacing") and np.any(total == 0)):
                raise ValueError(f"{name} = {quantity(total, 'm')}: a link must have a positive length")


def close(
    e: jax.Array,
    spacing: jax.Array,
    deviations: LinkDeviations,
    crank: closures.Crank,
    ratio: jax.Array | None,
    *,
    cranks: str,
    closure: str,
    branch: str,
) -> Closure:
    """`solve_closure` on promoted numbers, checked methods and the direction of crank 1."""
    d1, d2, d3, d4 = deviations.crank_1, deviations.coupler, deviations.crank_3, deviations.frame
    psi, b4, gx, gy = deviations.crank_phase, deviations.frame_angle, deviations.joint[0], deviations.joint[1]
    ratio = jnp.ones_like(e) if ratio is None else ratio
    # Fourth powers of the lengths over the spacing are formed on the way: they must not overflow, nor squares vanish.
    smallest, largest = window(e, 0.25)
    lengths = sum(jnp.abs(x) for x in (e, d1, d2, d3, d4, gx, gy))
    finite = lengths < largest * jnp.where(spacing > 0, spacing, 1)
    finite &= (jnp.abs(spacing) < largest) & ((spacing > smallest) | (spacing <= 0)) & jnp.isfinite(ratio)
    finite &= (jnp.abs(psi) < LARGEST_ANGLE) & (jnp.abs(b4) < LARGEST_ANGLE) & crank.finite
    possible = (spacing > 0) & (spacing + d2 > 0) & (spacing + d4 > 0)
    if cranks == "free":
        possible &= (e + d1 > 0) & (e + d3 > 0)
    if cranks == "geared":
        possible &= (e > 0) & (ratio > 0)
        # A lag without an angle: see the bound of `slip` in `geared`.
        finite &= ~possible | (4 * lengths * (lengths + 2 * spacing) < 0.25 * LARGEST_ANGLE * ratio * e**2)
    # A case outside the model is solved as a nominal linkage of unit size.
    refusals = ((~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY))
    numbers = (d1, d2, d3, d4, psi, b4, gx, gy, e, spacing, ratio, lengths)
    numbers, gate = admit(numbers, (0, 0, 0, 0, 0, 0, 0, 0, 0.02, 1, 1, 0.02), *refusals)
    d1, d2, d3, d4, psi, b4, gx, gy, e, l, ratio, lengths = numbers  # noqa: E741
    half_sine, half_cosine = sin_cos(b4 / 2)
    dx = d4 + gx - 2 * (l + d4) * half_sine**2
    dy = 2 * (l + d4) * half_sine * half_cosine + gy
    size = lengths + jnp.abs(dx) + jnp.abs(dy)
    links = closures.Links(e, l, d1, d2, d3, psi, b4, gy, crank.cosine, crank.sine, dx, dy, axial=d4 + gx, size=size)
    seen = closures.view(links)
    if cranks == "free":
        resting = closures.free(links, seen, closure=closure, branch=branch)
    elif cranks == "geared":
        resting = closures.geared(links, ratio, closure=closure)
    else:
        resting = closures.locked(links, closure=closure)
    shown = (resting.angle, resting.misfit, closures.gap(links, seen))
    (angle, misfit, gap), info = gate.close(shown, info=resting.info)
    return Closure(coupler_angle=angle, misfit=misfit, gap=gap, info=info)
