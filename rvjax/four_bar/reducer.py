"""Transmission error of a reducer: every disc on all its cranks, the mean over the discs.

Phase-locked cranks, whatever their number, put each disc where it fits its crank pins best (planar
Procrustes); for two cranks this is the four-bar linkage. Free and geared cranks are linkages.

The position of a disc is the direction of a vector (C, S) that is linear in the cosine and sine of its
crank angle. The coefficients depend on the unit, cosine and sine on the angle only, so that in a batch
of units over shared angles one evaluation is a few multiplications and one atan2 per disc. Axes of
cranks and discs are unrolled for the same reason: a batch sees element-wise arithmetic only.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.designs import CrankStage, CycloidStage, RVReducer
from rvjax.errors import RVErrors
from rvjax.four_bar import closures, forces
from rvjax.four_bar.linkage import Crank, LinkDeviations, check_methods, close, crank_direction
from rvjax.records import Record, broadcast_fields, field, is_concrete, promote, record
from rvjax.status import SolveInfo, Status, first_failure, worst

Vector = tuple[Any, Any]


@record
class TransmissionError(Record):
    """Deviation of the output from the ideal ratio at one crank angle."""

    error: Any = field("rad", "output angle, > 0: carrier ahead; mean over the discs")
    per_disc: Any = field("rad", "the same for each disc alone", shape=("discs",))
    misfit: Any = field("m", "what the bearings must stretch: signed for two cranks, else >= 0", shape=("discs",))
    info: SolveInfo = field("-", "of the worst disc", kind="record")


class Unit(NamedTuple):
    """Numbers of one reducer, finite and possible; lists run over discs [k] and cranks [i]."""

    e: Any  # effective eccentricity
    radius: Any  # of the circle of crank axes
    axes: list[Vector]  # [i] radial unit vectors
    delta: list[list[Any]]  # [k][i] crank eccentricity errors
    psi: list[Any]  # [i] crank phases
    disc: list[list[Vector]]  # [k][i] (radial, tangential)
    carrier: list[Vector]  # [i] (radial, tangential)
    clearance: Any
    load: forces.DiscLoad | None
    stiffness: Any
    finite: Any
    possible: Any


class Placed(NamedTuple):
    """One disc in the carrier frame."""

    angle: Any
    misfit: Any
    info: SolveInfo


def transmission_error(
    design: RVReducer,
    errors: RVErrors,
    *,
    crank_angle: Any,
    output_torque: Any = 0.0,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Any = None,
    closure: str = "newton",
    branch: str = "open",
) -> TransmissionError:
    """Transmission error of the second stage at one crank angle.

    Args:
        design: the reducer; its `cranks.bearing_stiffness` is needed under load.
        errors: of its parts; crank eccentricity and phase, bores, bearing clearance and eccentricity are read.
        crank_angle: eccentric direction of the first disc, () rad; crank i of c stands at pi + 2 pi i / c.
        output_torque: torque the discs exert on the carrier, counter-clockwise, () N m.
        cranks: "phase_locked", "free" or "geared" as in `solve_closure`; the last two for two cranks only.
        gear_stiffness_ratio: as in `solve_closure`; for "geared" only.
        closure: "newton", "closed_form", "quadratic" or "first_order" as in `solve_closure`.
        branch: "open" or "crossed".

    Returns:
        TransmissionError; angles lie between the drawing frames of the parts. Statuses as in `solve_closure`.

    Raises:
        ValueError: a combination of methods that does not exist, errors whose shapes do not fit the design, or
            a load (non-zero or traced) without bearing stiffness.
    """
    check_methods(cranks, gear_stiffness_ratio, closure, branch)
    count, discs = design.cranks.count, design.cycloid.disc_count
    if count > 2 and cranks != "phase_locked":
        raise ValueError(f"cranks = {cranks!r}: {count} cranks can only be 'phase_locked'")
    loaded = not (is_concrete(output_torque) and np.all(np.asarray(output_torque) == 0))
    if loaded and design.cranks.bearing_stiffness is None:
        raise ValueError("CrankStage.bearing_stiffness = None: a load needs it, in N/m")
    numbers = promote(design.cycloid, design.cranks, errors, crank_angle, output_torque, gear_stiffness_ratio)
    cycloid, stage, errors, angle, torque, ratio = numbers
    unit = _unit(design, cycloid, stage, errors, torque if loaded else None)
    first = crank_direction(angle)
    placed = []
    for k in range(discs):
        crank = first.turned(*_exact_direction(2 * k, discs))
        shifts = None if unit.load is None else [_joint_shift(unit, unit.load, crank, i) for i in range(count)]
        if cranks == "phase_locked" and (closure != "first_order" or count > 2):
            placed.append(_fit_disc(unit, k, crank, shifts, closure))
        else:
            placed.append(_link_disc(unit, k, crank, shifts, ratio, cranks=cranks, closure=closure, branch=branch))

    good = unit.finite & unit.possible & first.finite
    angles = [jnp.where(good, -disc.angle, jnp.nan) for disc in placed]
    error = sum(angles) / discs
    infos = jax.tree.map(lambda *leaves: jnp.stack(leaves), *[disc.info for disc in placed])
    status = worst(infos.status)
    overflow = good & (status == Status.CONVERGED) & ~jnp.isfinite(error)
    outside = first_failure(
        (~unit.finite | ~first.finite | overflow, Status.NONFINITE), (~unit.possible, Status.INVALID_GEOMETRY)
    )
    return TransmissionError(
        error=error,
        per_disc=jnp.stack(angles),
        misfit=jnp.stack([jnp.where(good, disc.misfit, jnp.nan) for disc in placed]),
        info=SolveInfo(
            jnp.where(outside == Status.CONVERGED, status, outside), jnp.max(infos.steps), jnp.max(infos.residual)
        ),
    )


def _exact_direction(halves: int, count: int) -> Vector:
    """Cosine and sine of pi * halves / count, exact where they are 0 or +-1."""
    if (2 * halves) % count == 0:
        return ((1, 0), (0, 1), (-1, 0), (0, -1))[(2 * halves // count) % 4]
    return math.cos(math.pi * halves / count), math.sin(math.pi * halves / count)


def _unit(design: RVReducer, cycloid: CycloidStage, stage: CrankStage, errors: RVErrors, torque: Any) -> Unit:
    """Take a reducer apart; a lane with impossible numbers becomes a nominal one, so its derivatives stay finite."""
    names = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance", "eccentricity")
    shaped = broadcast_fields(RVErrors, design.counts, {name: getattr(errors, name) for name in names})
    discs, cranks = range(cycloid.disc_count), range(stage.count)
    delta = [[shaped["crank_eccentricity"][k, i] for i in cranks] for k in discs]
    psi = [shaped["crank_phase"][i] for i in cranks]
    disc = [[(shaped["disc_bore"][k, i, 0], shaped["disc_bore"][k, i, 1]) for i in cranks] for k in discs]
    carrier = [(shaped["carrier_bore"][i, 0], shaped["carrier_bore"][i, 1]) for i in cranks]
    numbers = (delta, psi, disc, carrier, errors.bearing_clearance, errors.eccentricity)

    # Design and load are judged apart from the errors: a batch over errors then leaves them unbatched.
    e, radius, shortening = cycloid.eccentricity, stage.circle_radius, cycloid.shortening_coefficient
    stiffness = radius if torque is None else stage.bearing_stiffness
    torque_ = jnp.zeros_like(e) if torque is None else torque
    finite = jnp.isfinite(e + radius + shortening + stiffness + torque_)
    possible = (radius > 0) & (shortening < 1)
    if torque is not None:
        possible &= (e > 0) & (shortening > 0) & (stiffness > 0)
    good = finite & possible
    e, radius, shortening = (jnp.where(good, x, safe) for x, safe in ((e, 0.02), (radius, 1), (shortening, 0.5)))
    stiffness, torque_ = jnp.where(good, stiffness, 1), jnp.where(good, torque_, 0)
    load = None
    if torque is not None:
        load = forces.disc_load(design, e, shortening, torque_)

    finite &= jnp.isfinite(sum(jax.tree.leaves(numbers)))
    if stage.count == 2:
        possible &= 2 * radius + carrier[0][0] + carrier[1][0] > 0  # l4'
    good = finite & possible
    delta, psi, disc, carrier, clearance, eccentricity = jax.tree.map(lambda x: jnp.where(good, x, 0), numbers)
    return Unit(
        e=e + eccentricity,
        radius=radius,
        axes=[_exact_direction(stage.count + 2 * i, stage.count) for i in cranks],
        delta=delta,
        psi=psi,
        disc=disc,
        carrier=carrier,
        clearance=clearance,
        load=load,
        stiffness=stiffness,
        finite=finite,
        possible=possible,
    )


def _cartesian(axis: Vector, polar: Vector) -> Vector:
    """A (radial, tangential) vector of the crank at `axis` in x and y."""
    return polar[0] * axis[0] - polar[1] * axis[1], polar[0] * axis[1] + polar[1] * axis[0]


def _mean(points: list[Vector]) -> Vector:
    return sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points)


def _joint_shift(unit: Unit, load: forces.DiscLoad, crank: Crank, i: int) -> Vector:
    tangent = -unit.axes[i][1], unit.axes[i][0]
    force = forces.pin_force(load, crank.cosine, crank.sine, tangent, len(unit.axes), unit.radius)
    return forces.joint_shift(force, unit.clearance, unit.stiffness)


def _fit_disc(unit: Unit, k: int, crank: Crank, shifts: list[Vector] | None, closure: str) -> Placed:
    """Phase-locked cranks: least-squares position of disc k on its crank pins.

    A pin stands at R er + D, D = K + A u + B n + d: carrier bore K, crank errors along and across the
    eccentric direction u, joint shift d. The bore stands at Q = R er + q in the disc. Turning Q onto the
    pins, both taken from their means, gives S = sum Q x (pin), C = sum Q . (pin).
    """
    count, radius, axes = len(unit.axes), unit.radius, unit.axes
    cosine, sine = crank.cosine, crank.sine
    bores = [_cartesian(axis, polar) for axis, polar in zip(axes, unit.disc[k])]
    mean = _mean(bores)
    seats = [(radius * ax + (x - mean[0]), radius * ay + (y - mean[1])) for (ax, ay), (x, y) in zip(axes, bores)]  # Q
    carrier = [_cartesian(axis, polar) for axis, polar in zip(axes, unit.carrier)]  # K
    along, across = [], []  # (e + delta) exp(i psi) - e, without the cancellation
    for delta, psi in zip(unit.delta[k], unit.psi):
        half_sine, half_cosine = jnp.sin(psi / 2), jnp.cos(psi / 2)
        versine, sine_psi = 2 * half_sine**2, 2 * half_sine * half_cosine
        along.append(delta * (1 - versine) - unit.e * versine)  # A
        across.append((delta + unit.e) * sine_psi)  # B
    pins = [  # D
        (kx + (a * cosine - b * sine), ky + (a * sine + b * cosine)) for (kx, ky), a, b in zip(carrier, along, across)
    ]

    # sum Q x (A u + B n) and sum Q . (A u + B n), grouped so that the sums over cranks belong to the unit
    straight = sum(a * x + b * y for a, b, (x, y) in zip(along, across, seats))
    skew = sum(b * x - a * y for a, b, (x, y) in zip(along, across, seats))
    s = sum(x * ky - y * kx for (x, y), (kx, ky) in zip(seats, carrier)) - radius * sum(t for _, t in unit.disc[k])
    c = sum(x * kx + y * ky for (x, y), (kx, ky) in zip(seats, carrier)) + radius * sum(r for r, _ in unit.disc[k])
    s = s + (skew * cosine + straight * sine)
    c = (c + count * radius**2) + (straight * cosine - skew * sine)
    if shifts is not None:
        pins = [(x + dx, y + dy) for (x, y), (dx, dy) in zip(pins, shifts)]
        s = s + sum(x * dy - y * dx for (x, y), (dx, dy) in zip(seats, shifts))
        c = c + sum(x * dx + y * dy for (x, y), (dx, dy) in zip(seats, shifts))

    if count == 2:
        offered = closures.stretch(2 * radius, pins[1][0] - pins[0][0], pins[1][1] - pins[0][1])
        misfit = offered - closures.stretch(2 * radius, *_bore_offset(unit, k))
    else:
        misfit = _fit_residual(seats, [(x - bx, y - by) for (x, y), (bx, by) in zip(pins, bores)], s, c)
    if closure == "first_order":
        angle = _first_order_angle(unit, k, crank, shifts)
        return Placed(angle, misfit, closures.at_once(angle))
    size = count * radius**2
    angle, info = closures.direction_angle(c / size, s / size, closure=closure)
    return Placed(angle, misfit, info)


def _fit_residual(seats: list[Vector], offsets: list[Vector], s: Any, c: Any) -> Any:
    """sqrt(2 sum |residual|^2) of a fit by the angle with sine s and cosine c; for two cranks it would be |misfit|."""
    length = jnp.sqrt(s**2 + c**2)
    sine, versine = s / length, s**2 / (length * (length + c))
    mean = _mean(offsets)
    square = sum(
        (x - mean[0] + versine * qx + sine * qy) ** 2 + (y - mean[1] + versine * qy - sine * qx) ** 2
        for (qx, qy), (x, y) in zip(seats, offsets)
    )
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, 2 * square, 1)), 0)


def _first_order_angle(unit: Unit, k: int, crank: Crank, shifts: list[Vector] | None) -> Any:
    """Tangential displacement of the crank pins against the bores, mean over the cranks, by the radius."""
    turned = []
    for i, (x, y) in enumerate(unit.axes):
        along, across = crank.sine * x - crank.cosine * y, crank.cosine * x + crank.sine * y
        tangential = unit.delta[k][i] * along + unit.e * unit.psi[i] * across + unit.carrier[i][1] - unit.disc[k][i][1]
        turned.append(tangential if shifts is None else tangential + shifts[i][1] * x - shifts[i][0] * y)
    return sum(turned) / (len(turned) * unit.radius)


def _bore_offset(unit: Unit, k: int) -> Vector:
    """Vector from bore 1 to bore 3 of a disc on two cranks, less (l, 0)."""
    return unit.disc[k][0][0] + unit.disc[k][1][0], unit.disc[k][0][1] + unit.disc[k][1][1]


def _link_disc(unit: Unit, k: int, crank: Crank, shifts: list[Vector] | None, ratio: Any, **methods: str) -> Placed:
    """Disc k on two cranks as a four-bar linkage."""
    spacing = 2 * unit.radius
    bore_x, bore_y = _bore_offset(unit, k)
    joint_x, joint_y = jnp.zeros_like(bore_x), unit.carrier[0][1] + unit.carrier[1][1]
    if shifts is not None:
        joint_x = joint_x + shifts[1][0] - shifts[0][0]
        joint_y = joint_y + shifts[1][1] - shifts[0][1]
    deviations = LinkDeviations(
        crank_1=unit.delta[k][0],
        crank_3=unit.delta[k][1],
        coupler=closures.stretch(spacing, bore_x, bore_y),
        frame=unit.carrier[0][0] + unit.carrier[1][0],
        crank_phase=unit.psi[1] - unit.psi[0],
        frame_angle=jnp.zeros_like(bore_x),
        joint=(joint_x, joint_y),
    )
    turned = crank.turned(jnp.cos(unit.psi[0]), jnp.sin(unit.psi[0]))
    closed = close(unit.e, spacing, deviations, turned, ratio, **methods)
    return Placed(closed.coupler_angle - jnp.arctan2(bore_y, spacing + bore_x), closed.misfit, closed.info)
