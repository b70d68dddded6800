"""A whole crank turn: the transmission error curve and its figures."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.four_bar.reducer import transmission_error
from rvjax.records import Record, field, record
from rvjax.status import SolveInfo, worst


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
        Revolution. One failed angle makes the figures NaN; `info` says why.
    """
    if closure is None:
        closure = "newton" if cranks == "geared" else "closed_form"
    turn = 2 * math.pi / angles * np.arange(angles)

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

    dtype = jnp.result_type(float, *jax.tree.leaves((design.cycloid, design.cranks, errors, output_torque)))
    crank_angle = jnp.asarray(turn, dtype)
    curve = jax.vmap(at)(crank_angle)
    maximum, minimum = jnp.max(curve.error), jnp.min(curve.error)
    orders = (angles + 1) // 2  # below half the sampling rate
    spectrum = jnp.fft.rfft(curve.error)[:orders]
    return Revolution(
        crank_angle=crank_angle,
        error=curve.error,
        misfit=curve.misfit,
        maximum=maximum,
        minimum=minimum,
        peak_to_peak=maximum - minimum,
        mean=jnp.mean(curve.error),
        harmonics=spectrum * np.where(np.arange(orders) == 0, 1, 2).astype(spectrum.dtype) / angles,
        info=SolveInfo(worst(curve.info.status), jnp.max(curve.info.steps), jnp.max(curve.info.residual)),
    )
