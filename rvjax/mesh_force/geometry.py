"""One case of the roller stage: rollers, their lever arms, interferences and contacts, in units of the case.

Source: Wei et al. 2021, Chin. J. Mech. Eng. 34:84, Eqs. 5-27; the inner gear: `rvjax.geometry`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from rvjax._jax.elementary import sin_cos
from rvjax.designs import CamRollerReducer
from rvjax.errors import CamRollerErrors
from rvjax.geometry import rollers
from rvjax.mesh_force import line_contact
from rvjax.mesh_force.laws import Compliance
from rvjax.records import Array, Scalar


def roller_directions(teeth: int, dtype: DTypeLike) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of 2 pi i / n, i = 0 .. z, each (n,).

    Args:
        teeth: z.
        dtype: of the result.
    """
    count = teeth + 1
    sines = [_sine_of_half_turns(2 * i, count) for i in range(count)]
    cosines = [_sine_of_half_turns(count - 4 * i, 2 * count) for i in range(count)]
    return np.asarray(sines, dtype), np.asarray(cosines, dtype)


def cam_lead(teeth: int, output_angle: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine of psi_i = z theta - 2 pi i / n, i = 0 .. z, each (n,) (Eq. 5).

    Args:
        teeth: z.
        output_angle: theta, () rad.
    """
    sine, cosine = jnp.sin(teeth * output_angle), jnp.cos(teeth * output_angle)
    sines, cosines = roller_directions(teeth, output_angle.dtype)
    return sine * cosines - cosine * sines, cosine * cosines + sine * sines


def _sine_of_half_turns(numerator: int, denominator: int) -> float:
    """sin(pi numerator / denominator), exactly 0 and +-1 where it should be."""
    numerator = (numerator + denominator) % (2 * denominator) - denominator
    if abs(numerator) > denominator / 2:
        numerator = (denominator if numerator > 0 else -denominator) - numerator
    return float(np.sin(np.pi * numerator / denominator))


class Case(NamedTuple):
    """Inputs of the equilibrium; leaves are (), or (cases,) in a batch; `radius_error` also one per roller."""

    eccentricity: jax.Array  # over the link Rj + r
    roller_radius: jax.Array  # over the link
    palmgren: jax.Array  # factor of the contact law "palmgren"
    sine: jax.Array  # of z theta
    cosine: jax.Array
    cam_error: jax.Array  # over r, like the next one
    throw_error: jax.Array
    radius_error: jax.Array  # m: all of a batch are divided where they are read
    radius_unit: jax.Array  # 1 / r; 0 where a case fails a check at the entry
    torque: jax.Array  # of one cam over load unit and eccentricity


class Roller(NamedTuple):
    """One roller, or all of them as in `all_rollers`."""

    arm: jax.Array
    gap: jax.Array  # interference, > 0 loads
    compliance: Compliance
    cage_ratio: jax.Array  # signed


def take_apart(
    design: CamRollerReducer, errors: CamRollerErrors, torque: Array, angle: Array, good: Array
) -> tuple[Case, jax.Array]:
    """Return the case, and the unit of its loads in N.

    Args:
        design: a possible stage, as arrays of one dtype.
        errors: of its parts; radii of rollers any number where `good` is false.
        torque: on the crank, N m.
        angle: of the output, rad.
        good: whether the case passed the checks at the entry.
    """
    r, e = jnp.asarray(design.roller_radius), jnp.asarray(design.eccentricity)
    link = design.cam_radius + r
    unit = line_contact.load_unit(design.young_modulus, design.poisson_ratio, design.roller_length, r)
    sine, cosine = sin_cos(design.gear_teeth * angle)
    case = Case(
        eccentricity=e / link,
        roller_radius=r / link,
        palmgren=3.81 / 4**0.9 * jnp.power(design.roller_length / r, 0.1),
        sine=sine,
        cosine=cosine,
        cam_error=jnp.asarray(errors.cam_radius / r),
        throw_error=jnp.asarray(errors.eccentricity / r),
        radius_error=jnp.asarray(errors.roller_radius),
        radius_unit=jnp.where(good, 1 / r, 0),
        torque=design.cam_share * torque / (unit * e),
    )
    return case, unit


def roller(teeth: int, case: Case, sine: Scalar, cosine: Scalar, radius_error: jax.Array) -> Roller:
    """Compute a roller whose ray has an angle of given sine and cosine to the first one.

    Args:
        teeth: z.
        case: the case.
        sine: of the angle 2 pi i / n, a number, or all of them (n,).
        cosine: likewise.
        radius_error: of the roller, m.
    """
    sin_psi = case.sine * cosine - case.cosine * sine  # (5)
    cos_psi = case.cosine * cosine + case.sine * sine
    place = rollers(case.eccentricity, 1, teeth, sin_psi, cos_psi)
    cage = jnp.abs(place.cage_ratio)
    # (17)-(27) by virtual work: a roller acts at three contacts, the cam at one.
    own = jnp.where(case.radius_unit > 0, radius_error, 0) * case.radius_unit
    gap = case.cam_error + case.throw_error * place.throw + own * (1 + cage + place.gear_ratio)
    compliance = Compliance(
        cage=cage,
        gear=place.gear_ratio,
        cam_radius=1 - case.roller_radius,
        gear_radius=1 + case.roller_radius * place.centre_curvature,  # (10)
        palmgren=case.palmgren,
    )
    return Roller(place.arm, gap, compliance, place.cage_ratio)


def all_rollers(teeth: int, case: Case) -> Roller:
    """Every roller: (n,) for one case, (n, cases) for a batch whose `radius_error` is (n, cases) or (cases,).

    Args:
        teeth: z.
        case: the case, or a batch.
    """
    sines, cosines = roller_directions(teeth, case.sine.dtype)
    if case.sine.ndim:
        sines, cosines = sines[:, None], cosines[:, None]
        case = jax.tree.map(lambda leaf: leaf[None] if leaf.ndim == 1 else leaf, case)
    return roller(teeth, case, sines, cosines, case.radius_error)


def lever(arm: jax.Array) -> jax.Array:
    """Arms without the rounding that a roller at dead centre has instead of none.

    Such a roller carries preload but no torque. A sign that rounding chose would let it turn the crank.

    Args:
        arm: over the eccentricity.
    """
    return jnp.where(jnp.abs(arm) > 64 * float(jnp.finfo(arm.dtype).eps), arm, 0)
