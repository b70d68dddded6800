"""Transmission error of a whole reducer along its turn, under load."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.compile_cache import quick
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.balance import balance, forces
from rvjax.loaded.equilibrium import Case, judge, placed, prepare, pressures
from rvjax.loaded.inputs import Read, admit, check_input
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout
from rvjax.plausible import checked
from rvjax.records import Array, Record, Scalar, field, record
from rvjax.status import SolveInfo, succeeded, worst_of

Pair = tuple[jax.Array, jax.Array]
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
    crank_sharing: Array = field("-", "most loaded planet over the mean of all, at the worst angle; 0 without torque")
    disc_sharing: Array = field("-", "most loaded disc over the mean of all, at the worst angle; 0 without torque")
    info: SolveInfo = field("-", "the worst of the angles; steps: all", kind="record")


@checked
def revolution(
    design: RVReducer,
    errors: RVErrors,
    *,
    output_torque: Scalar,
    turns: float | None = None,
    samples: int = 48,
    contact: str = "hertz",
    carrier: str = "fixed",
    sun: str = "fixed",
) -> Revolution:
    """Equilibria along the turn of the output, each from the line through the two before.

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
    return _revolution(layout, samples, design, errors, output_torque, 1 / layout.pins if turns is None else turns)


@quick(0, 1)
def _revolution(
    layout: Layout, samples: int, design: RVReducer, errors: RVErrors, output_torque: Scalar, turns: Scalar
) -> Revolution:
    read = admit(layout, design, errors, output_torque, turns)
    step = 2 * jnp.pi * design.ratio * read.angle / samples  # `admit` checked the turns in the place of the angle

    def onward(known: Pair, j: jax.Array) -> tuple[Pair, tuple[Found, SolveInfo]]:
        last, before = known  # NaN where there is none
        start = jnp.where(jnp.isfinite(before), 2 * last - before, last)
        case = prepare(layout, read, jax.lax.stop_gradient(step * j)).loaded(read.torque)
        case = jax.lax.stop_gradient(case)
        found = balance(layout, case.system, start)
        info = judge(read, case, found)
        return (jnp.where(succeeded(info.status), found.q, jnp.nan), last), (found, info)

    order = jnp.arange(samples, dtype=read.torque.dtype)
    none = jnp.full((layout.unknowns,), jnp.nan, order.dtype)
    _, (found, infos) = jax.lax.scan(onward, (none, none), order)
    measure = jax.checkpoint(partial(_measure, layout), static_argnums=())
    error, loads = jax.lax.map(lambda x: measure(read, step, *x), (order, found, infos.status))
    whole = worst_of(infos)
    fine = succeeded(whole.status)
    error = jnp.where(fine, error, jnp.nan)
    wave = jnp.fft.fft(jnp.where(fine, error, 0))[:HARMONICS] / samples
    wave = jnp.pad(wave, (0, HARMONICS - len(wave)))
    wave = wave + wave.at[0].set(0)  # X_0 once, all others twice
    return Revolution(
        error=error,
        peak_to_peak=jnp.max(error) - jnp.min(error),
        mean=jnp.mean(error),
        harmonics=jnp.where(fine, wave, jnp.nan),
        **{name: jnp.where(fine, jnp.max(load), jnp.nan) for name, load in loads._asdict().items()},
        info=whole.replace(steps=jnp.sum(infos.steps)),
    )


class Loads(NamedTuple):
    """Forces on the parts at one angle; fields as in `Revolution`."""

    largest_pin: jax.Array
    largest_pressure: jax.Array
    largest_arm_bearing: jax.Array
    largest_support_bearing: jax.Array
    crank_sharing: jax.Array
    disc_sharing: jax.Array


def _measure(
    layout: Layout, read: Read, step: jax.Array, j: jax.Array, found: Found, status: jax.Array
) -> tuple[jax.Array, Loads]:
    """Error and loads of angle j, with their derivatives."""
    case: Case = prepare(layout, read, step * j).loaded(read.torque)
    q = placed(layout, case, found, status)
    pins, flanks, bearings = forces(layout, case.system, q)
    square = jnp.sum(bearings * bearings, axis=-1)
    carried = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
    loads = Loads(
        largest_pin=jnp.max(pins),
        largest_pressure=jnp.max(pressures(case, pins)),
        largest_arm_bearing=jnp.max(carried[: -layout.cranks]),
        largest_support_bearing=jnp.max(carried[-layout.cranks :]),
        crank_sharing=_sharing(flanks[:, 0] - flanks[:, 1]),
        disc_sharing=_sharing(jnp.sum(case.lever * pins, axis=1)),
    )
    return q[layout.carried] / read.design.cranks.circle_radius, loads


def _sharing(load: jax.Array) -> jax.Array:
    """Largest of some loads over their mean; 0 where they sum to nothing."""
    total = jnp.abs(jnp.sum(load))
    return jnp.where(total > 0, load.size * jnp.max(jnp.abs(load)) / jnp.where(total > 0, total, 1), 0)
