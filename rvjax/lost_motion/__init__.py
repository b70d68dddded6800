"""Lost motion."""

from rvjax.lost_motion.reducer import PROFILES, LostMotion, empirical_normal_force, geometric, shaft_tilt
from rvjax.lost_motion.loop import LoopFigures, hysteresis_loop, loop_figures
from rvjax.lost_motion.terms import LostMotionTerms

__all__ = [
    "PROFILES",
    "LoopFigures",
    "LostMotion",
    "LostMotionTerms",
    "empirical_normal_force",
    "geometric",
    "hysteresis_loop",
    "loop_figures",
    "shaft_tilt",
]
