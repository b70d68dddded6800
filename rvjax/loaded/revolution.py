"""A reducer along its turn: equilibria at several instants, transmission error under load, clearance without load.

An instant has a torque and an input angle; forces of the crank bearings are those of every angle under every torque.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from rvjax._jax.kernels import scan
from rvjax._jax.programs import quick
from rvjax.catalogue import checked
from rvjax.cycloidal import Reducer, ReducerErrors
from rvjax.designs import check_teeth, expect
from rvjax.errors import Errors
from rvjax.loaded.balance import forces
from rvjax.loaded.case import Case, Read, at_output, output_rotation, solve, under
from rvjax.loaded.equilibrium import KINDS, admit, check_input, check_kind, equilibria, kind_of, named_forces, prepare
from rvjax.loaded.newton import Minimum
from rvjax.loaded.system import Layout
from rvjax.records import Array, Design, Record, Scalar, field, record
from rvjax.roots import solved
from rvjax.status import SolveInfo, Status, succeeded, worst_of

Pair = tuple[jax.Array, jax.Array]


Loads = dict[str, Any]
"""Loads of the parts at one instant by the names of `Revolution`, () each; None where a kind has none."""


class Instants(NamedTuple):
    """Results at n instants."""

    error: jax.Array  # rotation of the carrier against the ideal motion, (n,) rad
    loads: Loads  # (n,)
    arm: jax.Array  # (n, d, c, 2) N, crank on disc; 0 where an equilibrium failed or carries nothing
    support: jax.Array  # (n, c, 2) N, crank on carrier; likewise
    info: SolveInfo  # (n,)


def instants(
    layout: Layout, read: Read, torques: jax.Array, input_angles: jax.Array, before: NDArray[np.integer]
) -> Instants:
    """Equilibria one after the other, each from those before.

    Args:
        layout: counts and methods.
        read: finite and possible numbers; its torque and angle are not read.
        torques: of the discs on the carrier, (n,) N m.
        input_angles: of the sun, (n,) rad.
        before: (n,) instants that the start of each follows from: none, the last, or the line through
            the last two.
    """

    def from_start(start: jax.Array, torque: jax.Array, angle: jax.Array) -> tuple[Minimum, SolveInfo]:
        case = prepare(layout, read, jax.lax.stop_gradient(angle)).loaded(torque)
        return solve(layout, read, jax.lax.stop_gradient(case), start)

    def onward(known: Pair, at: tuple[jax.Array, ...]) -> tuple[Pair, tuple[Minimum, SolveInfo]]:
        (last, earlier), (torque, angle, number) = known, at  # NaN where there is none
        start = jnp.where((number == 2) & jnp.isfinite(earlier), 2 * last - earlier, last)
        minima, info = from_start(jnp.where(number == 0, jnp.nan, start), torque, angle)
        here = jnp.where(succeeded(info.status), minima.q, jnp.nan)
        return (here, jnp.where(number == 0, jnp.nan, last)), (minima, info)

    none = jnp.full((layout.unknowns,), jnp.nan, torques.dtype)
    if np.any(before):
        minima, info = solved(scan(onward, (none, none), (torques, input_angles, jnp.asarray(before)))[1])
    else:  # one queue for all instants, so that slow ones are waited for once
        minima, info = solved(jax.vmap(partial(from_start, none))(torques, input_angles))
    measure = jax.checkpoint(partial(_measure, layout), static_argnums=())
    error, loads, arm, support = jax.lax.map(lambda x: measure(read, *x), (torques, input_angles, minima, info.status))
    return Instants(error, loads, arm, support, info)


def _measure(
    layout: Layout, read: Read, torque: jax.Array, angle: jax.Array, minimum: Minimum, status: jax.Array
) -> tuple[jax.Array, Loads, jax.Array, jax.Array]:
    """Error, loads and forces of an instant, with their derivatives."""
    case = prepare(layout, read, angle).loaded(torque)
    q = at_output(layout, case, minimum, status)
    at = forces(layout, case.system, q)
    of_names = named_forces(layout, read, case, at)
    arm, support = of_names.disc_bearing, of_names.support_bearing
    loads: Loads = dict(
        largest_pin=jnp.max(at.pins),
        largest_pressure=jnp.max(under(case.pressure, at.pins)),
        largest_arm_bearing=_largest(arm),
        largest_support_bearing=_largest(support),
        crank_sharing=None if of_names.gear is None else _sharing(of_names.gear),
        disc_sharing=_sharing(jnp.sum(case.lever * at.pins, axis=1)),
        fewest_pins=jnp.sum(at.pins > 0, dtype=at.pins.dtype),
        largest_output_pin=None if of_names.output_pins is None else jnp.max(of_names.output_pins),
        largest_output_pressure=None if of_names.output_pressure is None else jnp.max(of_names.output_pressure),
    )
    arm, support = (jnp.where(status == Status.CONVERGED, force, 0) for force in (arm, support))
    return output_rotation(layout, case, q), loads, arm, support


def _largest(force: jax.Array) -> jax.Array:
    """Length of the longest of some vectors (..., 2)."""
    square = jnp.sum(force * force, axis=-1)
    return jnp.max(jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0))


def _sharing(load: jax.Array) -> jax.Array:
    """Largest of some loads over their mean; 0 where they sum to nothing."""
    total = jnp.abs(jnp.sum(load))
    return jnp.where(total > 0, load.size * jnp.max(jnp.abs(load)) / jnp.where(total > 0, total, 1), 0)


HARMONICS = 5


@record
class Revolution(Record):
    """Transmission error at n input angles, equally spaced from 0 on."""

    error: Array = field("rad", "rotation of the carrier against the ideal motion", shape=("n",))
    peak_to_peak: Array = field("rad", "of the error")
    mean: Array = field("rad", "of the error")
    harmonics: Array = field(
        "rad", "complex amplitudes X_k of order k / turns, error = Re sum X_k e^(2 pi i k j / n)", shape=(HARMONICS,)
    )
    largest_pin: Array = field("N", "largest force of any pin at any angle")
    largest_pressure: Array = field("Pa", "largest Hertzian pressure of any pin at any angle")
    largest_arm_bearing: Array = field("N", "largest force of a crank on a disc at any angle")
    largest_support_bearing: Array = field("N", "largest force of a crank on the carrier at any angle")
    crank_sharing: Array | None = field(
        "-", "most loaded planet over the mean of all, at the worst angle; 0 without torque; None: no planets"
    )
    disc_sharing: Array = field("-", "most loaded disc over the mean of all, at the worst angle; 0 without torque")
    fewest_pins: Array = field("-", "fewest pins that carry, of all discs together, at any angle")
    info: SolveInfo = field("-", "the worst of the angles; steps: all", kind="record")
    largest_output_pin: Array | None = field("N", "largest force of any output pin at any angle", default=None)
    largest_output_pressure: Array | None = field(
        "Pa", "largest Hertzian pressure of any output pin at any angle", default=None
    )


@checked
def revolution(
    design: Reducer,
    errors: ReducerErrors,
    *,
    output_torque: Scalar,
    turns: float | None = None,
    samples: int = 48,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Revolution:
    """Equilibria along the turn of the output; those of an RV reducer start from the line through the two before.

    Args:
        design: as in `equilibrium`.
        errors: as in `equilibrium`.
        output_torque: as in `equilibrium`, () N m.
        turns: of the output, by default one crank turn, 1 / pin_count.
        samples: n, angle j at input angle 2 pi ratio turns j / n.
        contact: as in `equilibrium`.
        carrier: as in `equilibrium`.
        sun: as in `equilibrium`.

    Returns:
        Revolution; all values NaN where one of the equilibria has none.

    Raises:
        ValueError: as `equilibrium`; samples < 1.
    """
    layout = check_input(design, errors, contact, carrier, sun)
    if samples < 1:
        raise ValueError(f"samples = {samples}: must be at least 1")
    turns = 1 / layout.pins if turns is None else turns
    return _revolution(samples, layout, design, errors, output_torque, turns)


@quick(0, 1)
def _revolution(
    samples: int, layout: Layout, design: Reducer, errors: ReducerErrors, output_torque: Scalar, turns: Scalar
) -> Revolution:
    read = admit(layout, design, errors, output_torque, turns)
    order = jnp.arange(samples, dtype=read.torque.dtype)
    step = 2 * jnp.pi * design.ratio * read.angle / samples  # `admit` checked the turns in the place of the angle
    # One to three pins of a single-stage drive carry, and others at the next angle: those before are no better start.
    before = np.minimum(2 * np.arange(samples), 2 if layout.links else 0)
    return summary(instants(layout, read, jnp.broadcast_to(read.torque, order.shape), step * order, before))


def summary(equilibria: Instants, *, spaced: bool = True) -> Revolution:
    """The revolution of some instants.

    Args:
        equilibria: (n,) of one turn.
        spaced: equally; False: mean and harmonics are NaN.
    """
    samples = len(equilibria.error)
    whole = worst_of(equilibria.info)
    fine = succeeded(whole.status)
    error = jnp.where(fine, equilibria.error, jnp.nan)
    wave = jnp.fft.fft(jnp.where(fine, error, 0))[:HARMONICS] / samples
    wave = jnp.pad(wave, (0, HARMONICS - len(wave)))
    wave = wave + wave.at[0].set(0)  # X_0 once, all others twice
    mean = jnp.mean(error)
    if not spaced:
        mean, wave = jnp.full_like(mean, jnp.nan), jnp.full_like(wave, jnp.nan)
    return Revolution(
        error=error,
        peak_to_peak=jnp.max(error) - jnp.min(error),
        mean=mean,
        harmonics=jnp.where(fine, wave, jnp.nan),
        **jax.tree.map(lambda load: jnp.where(fine, jnp.max(load), jnp.nan), equilibria.loads)
        | {"fewest_pins": jnp.where(fine, jnp.min(equilibria.loads["fewest_pins"]), jnp.nan)},
        info=whole.replace(steps=jnp.sum(equilibria.info.steps)),
    )


@record
class Clearance(Record):
    """Clearance along a turn."""

    least: Array = field("m", "least clearance of any pin, discs turned to where it is largest; < 0: the reducer jams")
    at: Array = field("m", "the same at each input angle", shape=("n",))
    info: SolveInfo = field("-", "residual: m, between two bounds of the value", kind="record")


@checked
def clearance(
    design: Reducer,
    errors: ReducerErrors,
    *,
    turns: float | None = None,
    samples: int = 48,
) -> Clearance:
    """Least clearance between flanks and pins along a turn of the output, without load.

    RV reducer: cranks, bearings and bores are ideal; what they take is the `misfit` of the discs. Single-stage drive:
    pins in holes count too, discs sit on their eccentrics, and bearing clearance does not help.

    Args:
        design: involute teeth and cycloid stage are read.
        errors: of pins, ring and discs.
        turns: of the output, by default one crank turn, 1 / pin_count.
        samples: n, angle j at input angle 2 pi ratio turns j / n.

    Returns:
        Clearance. NaN with status NONFINITE (a number that is read is NaN or inf), INVALID_GEOMETRY (K1 outside (0, 1)
        or a radius that is not positive) or UNDERCUT.

    Raises:
        ValueError: another kind of design or of errors, another tooth difference than one, or samples < 1.
    """
    expect(design, "loaded.clearance", *KINDS)
    cycloid = design.cycloid
    check_teeth(cycloid)
    check_kind(design, errors)
    if samples < 1:
        raise ValueError(f"samples = {samples}: must be at least 1")
    return _clearance(samples, 1 / cycloid.pin_count if turns is None else turns, design, errors)


@quick(0, 1)
def _clearance(samples: int, turns: float, design: Design, errors: Errors) -> Clearance:
    (least, each), info = kind_of(design).fit(samples, turns, design, errors)
    return Clearance(least, each, info)


class BearingForces(NamedTuple):
    """At n angles under t torques, in the frame of the ideal carrier; 0 where an equilibrium failed or carries nothing.

    The displacements carry no derivative; they are a start for torques near these.
    """

    arm: jax.Array  # (n, t, d, c, 2) N, crank on disc
    support: jax.Array  # (n, t, c, 2) N, crank on carrier
    info: SolveInfo  # (n, t)
    displacements: jax.Array | None  # (n, t, unknowns), NaN where an equilibrium failed; None: not needed


def bearing_forces(
    layout: Layout,
    read: Read,
    torques: jax.Array,
    input_angles: jax.Array,
    start: jax.Array | None = None,
    *,
    near: bool = False,
) -> BearingForces:
    """Forces of the crank bearings at every angle under every torque: what a bearing life is computed from.

    Args:
        layout: as in `equilibria`.
        read: as in `equilibria`.
        torques: as in `equilibria`.
        input_angles: as in `equilibria`.
        start: as in `equilibria`.
        near: as in `equilibria`.
    """

    def take(case: Case, q: jax.Array, carries: jax.Array) -> tuple[jax.Array, jax.Array]:
        of_names = named_forces(layout, read, case, forces(layout, case.system, q))
        both = of_names.disc_bearing, of_names.support_bearing
        return jax.tree.map(lambda force: jnp.where(carries, force, 0), both)

    solution = equilibria(layout, read, torques, input_angles, take, start, near=near)
    arm, support = solution.taken
    return BearingForces(arm, support, solution.info, solution.displacements)
