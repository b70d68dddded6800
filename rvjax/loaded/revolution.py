"""Transmission error of a whole reducer along its turn, under load."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.programs import quick
from rvjax._reducer.plausible import checked
from rvjax.cycloidal import CycloidalErrors, CycloidalReducer
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.loaded.instants import Instants, instants
from rvjax.loaded.kinds import admit, check_input
from rvjax.loaded.system import Layout
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, succeeded, worst_of

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
    info: SolveInfo = field("-", "the worst of the angles; steps: all", kind="record")
    largest_output_pin: Array | None = field("N", "largest force of any output pin at any angle", default=None)
    largest_output_pressure: Array | None = field(
        "Pa", "largest Hertzian pressure of any output pin at any angle", default=None
    )


@checked
def revolution(
    design: RVReducer | CycloidalReducer,
    errors: RVErrors | CycloidalErrors,
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
    samples: int, layout: Layout, design: PyTree, errors: PyTree, output_torque: Scalar, turns: Scalar
) -> Revolution:
    read = admit(layout, design, errors, output_torque, turns)
    order = jnp.arange(samples, dtype=read.torque.dtype)
    step = 2 * jnp.pi * design.ratio * read.angle / samples  # `admit` checked the turns in the place of the angle
    # One to three pins of a single-stage drive carry, and others at the next angle: those before are no better start.
    before = np.minimum(2 * np.arange(samples), 2 if layout.links else 0)
    return summary(instants(layout, read, jnp.broadcast_to(read.torque, order.shape), step * order, before))


def summary(found: Instants) -> Revolution:
    """The revolution of equally spaced instants.

    Args:
        found: (n,) of one turn.
    """
    samples = len(found.error)
    whole = worst_of(found.info)
    fine = succeeded(whole.status)
    error = jnp.where(fine, found.error, jnp.nan)
    wave = jnp.fft.fft(jnp.where(fine, error, 0))[:HARMONICS] / samples
    wave = jnp.pad(wave, (0, HARMONICS - len(wave)))
    wave = wave + wave.at[0].set(0)  # X_0 once, all others twice
    return Revolution(
        error=error,
        peak_to_peak=jnp.max(error) - jnp.min(error),
        mean=jnp.mean(error),
        harmonics=jnp.where(fine, wave, jnp.nan),
        **jax.tree.map(lambda load: jnp.where(fine, jnp.max(load), jnp.nan), found.loads._asdict()),
        info=whole.replace(steps=jnp.sum(found.info.steps)),
    )
