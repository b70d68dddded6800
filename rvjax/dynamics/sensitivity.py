"""Sensitivity of one amplitude to every number of a design, by automatic differentiation through the solves.

Deviations of stiffness, mass and other numbers of a design, for tolerances and what-if questions.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import jax
import jax.numpy as jnp

from rvjax._reducer.plausible import checked
from rvjax.base.words import choose
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped
from rvjax.dynamics.harmonics import OUTPUTS
from rvjax.dynamics.response import constant_forcing, response
from rvjax.records import Array, PyTree, Record, Scalar, promote


def with_deviations(design: RVReducer | Lumped, deviations: Mapping[str, PyTree]) -> PyTree:
    """Return a design some of whose numbers deviate by a share of themselves: x (1 + deviation).

    The names serve as names of tolerances: `monte_carlo(lambda d: f(with_deviations(design, d)),
    {"stiffness.disc_pin_mesh": Tolerance.symmetric(0.1)}, ...)`.

    Args:
        design: a reducer, or its lumped parameters.
        deviations: {field: deviation}, fields such as "stiffness.disc_pin_mesh" or "inertia.planet_mass"; a scalar
            for all members alike, or an array of the shape of the field, one for each member.

    Raises:
        ValueError: a name that is no number of this design.
    """
    for name, deviation in deviations.items():
        design = _replaced(design, name.split("."), name, deviation)
    return design


def _replaced(part: PyTree, path: list[str], name: str, deviation: Scalar) -> PyTree:
    value = getattr(part, path[0], None) if isinstance(part, Record) else None
    if len(path) > 1 and isinstance(value, Record):
        return part.replace(**{path[0]: _replaced(value, path[1:], name, deviation)})
    numbers = jax.tree_util.tree_flatten_with_path(part)[0] if isinstance(part, Record) else []
    names = [key[0].name for key, _ in numbers if len(key) == 1]
    if len(path) > 1 or path[0] not in names:
        raise ValueError(f"deviations: {name!r} is no number of this design; {type(part).__name__} has {names}")
    # A float stays one: its dtype then follows the other numbers.
    value, deviation = (x if isinstance(x, float) else jnp.asarray(x) for x in (value, deviation))
    return part.replace(**{path[0]: value * (1 + deviation)})


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
