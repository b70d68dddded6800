"""Rated life of the crank bearings of a reducer as built, from the forces of the loaded equilibrium.

ISO 281 (rating, life), ISO 76 (static), ISO/TS 16281 (laminae): docs/models/life.md.
"""

from rvjax.life.bearing import BearingLife, bearing_life
from rvjax.life.damage import dynamic_rating, magnitude as magnitude, static_rating
from rvjax.life.duty import Duty, TurnPlan as TurnPlan
from rvjax.life.machine import (
    check_alone as check_alone,
    check_places as check_places,
    shared as shared,
    tapered as tapered,
)
from rvjax.life.rated import (
    Evaluated as Evaluated,
    RatedTorque,
    Root as Root,
    implicit_root as implicit_root,
    rated_torque,
)
from rvjax.life.rating import (
    Rating,
    crank_order as crank_order,
    first_failures as first_failures,
    force_orders as force_orders,
    phase_shares as phase_shares,
    rating,
)

__all__ = ["BearingLife", "Duty", "RatedTorque", "Rating", "bearing_life", "dynamic_rating", "rated_torque", "rating"]
__all__ += ["static_rating"]
