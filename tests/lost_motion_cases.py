"""Shared pieces of the lost-motion tests: the compiled model, a design whose K1 follows from its lengths."""

import jax

from rvjax.catalogue import RV_20E
from rvjax.lost_motion import geometric

solve = jax.jit(geometric, static_argnames=("reading", "profile"))
TRUE_K1 = jax.tree.map(lambda x: x, RV_20E).replace(cycloid=RV_20E.cycloid.replace(shortening=None))


def cycloid(design, **changes):
    """A design with another second stage."""
    return design.replace(cycloid=design.cycloid.replace(**changes))
