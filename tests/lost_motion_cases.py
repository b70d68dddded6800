"""Shared pieces of the lost-motion tests: the compiled model, a design whose K1 follows from its lengths."""

import jax
import numpy as np

from rvjax.catalogue import RV_20E
from rvjax.lost_motion import geometric

_solve = jax.jit(geometric, static_argnames=("reading", "profile"))
TRUE_K1 = jax.tree.map(lambda x: x, RV_20E).replace(cycloid=RV_20E.cycloid.replace(shortening=None))


def cycloid(design, **changes):
    """A design with another second stage."""
    return design.replace(cycloid=design.cycloid.replace(**changes))


def numbers(tree, dtype=float):
    """Every number as an array of one precision, so that tests share programs."""
    return jax.tree.map(lambda x: np.asarray(x, dtype), tree)


def solve(design, errors, *, tilt=0.0, centre_shift=0.0, normal_force=None, dtype=float, **options):
    """The compiled model, with every number traced."""
    design, errors, given = numbers((design, errors, dict(tilt=tilt, centre_shift=centre_shift)), dtype)
    if normal_force is not None:
        given["normal_force"] = np.asarray(normal_force, dtype)
    options = dict(reading="consistent", profile="first_order") | options  # left out, it would be another program
    return jax.tree.map(np.asarray, _solve(design, errors, **given, **options))
