"""Rated life of the crank bearings of a reducer as built, from the forces of the loaded equilibrium.

ISO 281 (rating, life), ISO 76 (static), ISO/TS 16281 (laminae): docs/models/life.md.
"""

from rvjax.life.bearing import BearingLife, bearing_life
from rvjax.life.causes import (
    first_failures as first_failures,
    force_orders as force_orders,
    phase_shares as phase_shares,
)
from rvjax.life.duty import Duty
from rvjax.life.kinds import crank_order as crank_order
from rvjax.life.rated import RatedTorque, rated_torque
from rvjax.life.rating import Rating, rating
from rvjax.life.ratings import dynamic_rating, static_rating

__all__ = [
    "BearingLife",
    "Duty",
    "RatedTorque",
    "Rating",
    "bearing_life",
    "dynamic_rating",
    "rated_torque",
    "rating",
    "static_rating",
]
