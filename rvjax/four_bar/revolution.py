"""A whole crank turn: the transmission error curve and its figures."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.designs import RVReducer
from rvjax.elementary import arctan2, divide
from rvjax.errors import RVErrors
from rvjax.four_bar.closures import Crank, at_once
from rvjax.four_bar.extremes import extremes_over_turn
from rvjax.four_bar.fit import fit, misfit, vector
from rvjax.four_bar.linkage import check_methods
from rvjax.four_bar.reducer import check_crank_count, transmission_error
from rvjax.four_bar.unit import Unit, take_apart
from rvjax.records import Record, field, record
from rvjax.status import SolveInfo, Status, worst


@record
class Revolution(Record):
    """Transmission error over one crank turn; the output makes `pin_count` of them in a carrier turn."""

    crank_angle: Any = field("rad", "uniform, from zero", shape=("angles",))
    error: Any = field("rad", "output angle, > 0: carrier ahead", shape=("angles",))
    misfit: Any = field("m", "of each disc", shape=("angles", "discs"))
    maximum: Any = field("rad", "largest error")
    minimum: Any = field("rad", "smallest error")
    peak_to_peak: Any = field("rad", "maximum less minimum")
    mean: Any = field("rad", "mean error")
    largest_misfit: Any = field("m", "largest |misfit| over angles and discs")
    harmonics: Any = field("rad", "X[h], complex: error = Re sum X[h] exp(i h crank_angle)", shape=("orders",))
    info: SolveInfo = field("-", "of the worst angle", kind="record")


def revolution(
    design: RVReducer,
    errors: RVErrors,
    *,
    angles: int = 64,
    output_torque: Any = 0.0,
    cranks: str = "phase_locked",
    gear_stiffness_ratio: Any = None,
    closure: str | None = None,
    branch: str = "open",
) -> Revolution:
    """Transmission error over one crank turn.

    Args:
        design: as in `transmission_error`.
        errors: as in `transmission_error`.
        angles: number of uniform crank angles, static; 48 or more for a smooth curve.
        output_torque: as in `transmission_error`.
        cranks: as in `transmission_error`.
        gear_stiffness_ratio: as in `transmission_error`.
        closure: as in `transmission_error`; by default "closed_form", "newton" where there is none.
        branch: as in `transmission_error`.

    Returns:
        Revolution. One failed angle makes the figures NaN; `info` says why. Figures that are not used cost
        nothing under `jax.jit`. A large batch runs fastest with the units on the last axis of every error,
        `jax.vmap(..., in_axes=-1)`: its derivatives then are assembled from contiguous rows.

    Raises:
        ValueError: as in `transmission_error`.
    """
    if closure is None:
        closure = "newton" if cranks == "geared" else "closed_form"
    check_crank_count(design, cranks)
    check_methods(cranks, gear_stiffness_ratio, closure, branch)
    (unit,) = take_apart(design, errors, output_torque)
    crank_angle = jnp.asarray(2 * np.pi / angles * np.arange(angles), unit.radius.dtype)

    def at(angle: jax.Array) -> Any:
        return transmission_error(
            design,
            errors,
            crank_angle=angle,
            output_torque=output_torque,
            cranks=cranks,
            gear_stiffness_ratio=gear_stiffness_ratio,
            closure=closure,
            branch=branch,
        )

    curve = jax.vmap(at)(crank_angle)
    if cranks == "phase_locked" and closure == "closed_form":
        maximum, minimum, largest_misfit = _extremes(unit, angles)
        status = jnp.where(jnp.isfinite(maximum - minimum), unit.status, int(Status.NONFINITE))
        status = jnp.where(unit.status == Status.INVALID_GEOMETRY, unit.status, status)
        info = at_once(maximum).replace(status=status)
    else:
        maximum, minimum = jnp.max(curve.error), jnp.min(curve.error)
        largest_misfit = jnp.max(jnp.abs(curve.misfit))
        info = SolveInfo(worst(curve.info.status), jnp.max(curve.info.steps), jnp.max(curve.info.residual))
    spectrum = jnp.fft.rfft(curve.error)[: (angles + 1) // 2]  # orders below half the sampling rate
    return Revolution(
        crank_angle=crank_angle,
        error=curve.error,
        misfit=curve.misfit,
        maximum=maximum,
        minimum=minimum,
        peak_to_peak=maximum - minimum,
        mean=jnp.mean(curve.error),
        largest_misfit=largest_misfit,
        harmonics=spectrum * np.where(np.arange(len(spectrum)) == 0, 1, 2).astype(spectrum.dtype) / angles,
        info=info,
    )


def _extremes(unit: Unit, angles: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Largest and smallest error and largest |misfit| of phase-locked cranks, without the curve."""
    discs = range(len(unit.disc))

    def error(parts: Any, first: Crank) -> jax.Array:
        unit, fits = parts
        vectors = [vector(unit, fits[k], unit.disc_crank(k, first)) for k in discs]
        return -jnp.mean(jnp.stack([arctan2(sine, cosine) for cosine, sine in vectors]))

    def most_misfit(parts: Any, first: Crank) -> jax.Array:
        unit, fits = parts
        return jnp.max(jnp.stack([jnp.abs(misfit(unit, fits[k], unit.disc_crank(k, first))) for k in discs]))

    parts = (unit, [fit(unit, k) for k in discs])
    most, least = extremes_over_turn(
        error,
        parts,
        angles,
        score=_quotient,
        back=lambda quotient: _angle(quotient) / len(discs),
        together=64 if unit.load is None and len(discs) <= 2 else 4,  # one kernel, where the program stays small
    )
    largest, _ = extremes_over_turn(
        most_misfit,
        parts,
        angles,
        score=lambda parts: functools.partial(most_misfit, parts),
        back=lambda largest: largest,
        together=4,
    )
    good = unit.finite & unit.possible
    return (
        jnp.where(good, most, jnp.nan),
        jnp.where(good, least, jnp.nan),
        jnp.where(good, largest, jnp.nan),
    )


def _quotient(parts: Any) -> Callable[[Crank], jax.Array]:
    """A number that falls as the discs turn: -1 to 1 up to a right angle of all together, to +-2 beyond.

    Their vectors C + i S are turned one after the other by multiplication, so no angle is needed. Without a load
    each is still + turning u with the crank's direction u, and their product a polynomial in u.
    """
    unit, fits = parts
    discs = range(len(unit.disc))
    scale = 1 / (len(fits[0].seats) * unit.radius**2)  # vectors near 1, however many are multiplied
    product = [(jnp.ones_like(unit.radius), jnp.zeros_like(unit.radius))]
    if unit.load is None:
        for k in discs:
            still = (1 + scale * jnp.real(fits[k].still), scale * jnp.imag(fits[k].still))
            turning = Crank(scale * jnp.real(fits[k].turning), scale * jnp.imag(fits[k].turning))
            turning = unit.disc_crank(k, turning)
            risen = [(0, 0), *(_times(z, turning) for z in product)]
            product = [(x + u, y + v) for (x, y), (u, v) in zip([*(_times(z, still) for z in product), (0, 0)], risen)]

    def quotient(first: Crank) -> jax.Array:
        cosine, sine = product[-1]
        for x, y in product[-2::-1]:  # Horner
            u, v = _times((cosine, sine), first)
            cosine, sine = x + u, y + v
        if unit.load is not None:
            for k in discs:
                c, s = vector(unit, fits[k], unit.disc_crank(k, first))
                cosine, sine = _times((cosine, sine), (scale * c, scale * s))
        size = jnp.abs(cosine) + jnp.abs(sine)
        beyond = jnp.where(sine >= 0, 2, -2) * size - sine
        return -divide(jnp.where(cosine >= 0, sine, beyond), size)

    return quotient


def _times(first: Any, second: Any) -> tuple[Any, Any]:
    """Product of two complex numbers as pairs."""
    return first[0] * second[0] - first[1] * second[1], first[1] * second[0] + first[0] * second[1]


def _angle(quotient: jax.Array) -> jax.Array:
    """The angle that a quotient stands for."""
    beyond = jnp.abs(quotient) > 1
    half_turn = jnp.where(beyond, jnp.sign(quotient), 0)
    within = jnp.where(beyond, quotient - 2 * half_turn, quotient)  # beyond a right angle: of the opposite direction
    return arctan2(within, 1 - jnp.abs(within)) + np.pi * half_turn
