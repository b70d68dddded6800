"""Geometry of an RV reducer without errors: curvature of the flank, room between the parts, size, nominal pressure."""

from rvjax.geometry.figures import Figures, figures
from rvjax.geometry.figures import contact_ratio as contact_ratio
from rvjax.geometry.flank import curvature as curvature
from rvjax.geometry.flank import least_convex_radius as least_convex_radius
from rvjax.geometry.flank import relative_radius as relative_radius

__all__ = ["Figures", "figures"]
