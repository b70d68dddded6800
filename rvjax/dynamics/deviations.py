"""Deviations of stiffness, mass and other numbers of a design, for tolerances and what-if questions."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped
from rvjax.records import PyTree, Record, Scalar


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
