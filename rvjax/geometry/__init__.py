"""Geometry of a reducer without errors: flanks and their outlines, space, size, nominal pressure."""

from rvjax.flank import curvature as curvature, least_convex_radius as least_convex_radius
from rvjax.geometry.inner_gear import (
    ToothProfile as ToothProfile,
    largest_roller_radius as largest_roller_radius,
    rollers as rollers,
    tooth_profile as tooth_profile,
    undercut_margin as undercut_margin,
)
from rvjax.geometry.outline import PARTS as PARTS, Circle, Outline, flank_along as flank_along, outline
from rvjax.geometry.outline_files import DRAWINGS as DRAWINGS, layer as layer
from rvjax.geometry.outputs import Figures, contact_ratio as contact_ratio, figures
from rvjax.geometry.ring import material as material, squared_pressure as squared_pressure

__all__ = ["Circle", "Figures", "Outline", "figures", "outline"]
