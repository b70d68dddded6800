"""Sensitivity of one amplitude to every number of a design, by automatic differentiation through the solves."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp

from rvjax.choices import choose
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped
from rvjax.dynamics.harmonics import OUTPUTS
from rvjax.dynamics.response import constant_forcing, response
from rvjax.plausible import checked
from rvjax.records import Array, PyTree, Scalar, promote

FORMULAS = {"total": response, "constant_forcing": constant_forcing}


@checked
def log_sensitivities(
    design: RVReducer | Lumped,
    *,
    sun_speed: Scalar,
    output_torque: Scalar,
    stage: str = "planetary",
    harmonics: int = 9,
    outputs: Sequence[str] = OUTPUTS,
    formula: str = "total",
) -> dict[str, jax.Array]:
    """Relative change of each first-order amplitude B for a relative change of each number: (xi / B) dB/dxi.

    Args:
        design: a reducer, whose eccentricity moves the rolling radius of the discs along, or its lumped
            parameters, where the two vary apart.
        sun_speed: () rad/s.
        output_torque: external torque on the output, () N m.
        stage: whose meshes vary: "planetary" or "cycloid".
        harmonics: of the mesh frequency, H.
        outputs: k names from `assemble(design).labels`.
        formula: "total", or "constant_forcing" as Eq. 14 of Yang et al. 2018.

    Returns:
        {field: (H, k) complex}, fields such as "stiffness.sun_support"; the real part is the relative change of
        |B|. Zero for an output that a harmonic does not excite. A field that holds an array adds its axes.

    Raises:
        ValueError: unknown formula, or as `response`.
    """
    choose("formula", formula, FORMULAS)
    return _log_sensitivities(design, sun_speed, output_torque, stage, harmonics, tuple(outputs), formula)


@partial(jax.jit, static_argnums=(3, 4, 5, 6))
def _log_sensitivities(
    design: PyTree,
    sun_speed: Array,
    output_torque: Array,
    stage: str,
    harmonics: int,
    outputs: tuple[str, ...],
    formula: str,
) -> dict[str, jax.Array]:
    design = promote(design)
    conditions = dict(sun_speed=sun_speed, output_torque=output_torque)

    def amplitude(changed: PyTree) -> tuple[jax.Array, jax.Array]:
        found = FORMULAS[formula](changed, **conditions, stage=stage, harmonics=harmonics, outputs=outputs).amplitude
        return found, found

    slopes, value = jax.jacfwd(amplitude, has_aux=True)(design)
    divisor = jnp.where(value == 0, 1, value)
    paths, _ = jax.tree.flatten_with_path(slopes)
    found = {}
    for (path, slope), number in zip(paths, jax.tree.leaves(design)):
        factor = jnp.broadcast_to(number, slope.shape).astype(value.dtype)
        beside = jnp.expand_dims(divisor, range(2, slope.ndim))
        found[jax.tree_util.keystr(path, simple=True, separator=".")] = factor * slope / beside
    return found
