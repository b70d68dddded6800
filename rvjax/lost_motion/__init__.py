"""Lost motion of an RV reducer: the free angle of its output, input locked, when the load reverses.

`geometric` adds up the backlash of involute stage, cycloid stage and crank bearings, every contribution by
name. Positive is backlash, negative interference; both the signed `total` and `play` = max(0, total)
are reported. `hysteresis_loop` computes the hysteresis curve from the backlash, `loop_figures` its values.

Source: Liu et al. 2022, Mech. Sci. 13, 855, doi 10.5194/ms-13-855-2022 (RV-20E). Its published total of
0.5467 arcmin rests on terms in radians added to terms in arcmin: with one unit throughout its own tables
give 1.757 arcmin. `reading="as_printed"` keeps the input errors and returns 0.5487 arcmin; 0.5467 itself comes
back only with a `normal_force` through an inertia calibrated to that end, and then needs a pressure angle
of cosine 1.019. The rise with tilt in its Table 10 is explained by none of its equations: at a given force
tilt and centre shift move the total by less than 6e-5 arcmin. `published.rv20e` has a fit to that table.

Three levels of flank backlash. Measured on 100,000 units of the RV-20E, errors uniform in the bands of Table 9,
K1 derived from eccentricity, pins and pin circle; one busy core, float64:

    ===========  =====================  =========  =======  =========================================
    profile      arcmin off, rms (max)  ns a unit  compile  use
    ===========  =====================  =========  =======  =========================================
    first_order  5.4e-3 (2.6e-2)        6-8        0.2 s    allocation, Monte Carlo; the paper's sum
    closed_form  1.5e-4 (2.8e-4)        6-8        0.2 s    best value: reports parts that do not fit
    contact      0                      1500-2500  3 s      proof, and large modifications
    ===========  =====================  =========  =======  =========================================

The sum is wrong where the two flank minima part (s D < d < D, with D and d the differences of pin radius and
pin circle radius between the pins that ground the disc and those it runs in) and ignores d > D, where tips or
roots interfere at any rotation: a third of these units cannot be assembled without deformation, which
"closed_form" and "contact" report as NOT_ASSEMBLABLE. Both are lower bounds over the crank angle; a ring of
forty pins lies up to half a percent above. In float32 the sum is good to 6e-6 arcmin plus 3e-6 of its terms.

Not modelled: elasticity, carrier bearings, centre-distance backlash of the involute stage, undercut of the flank.
"""

from rvjax.lost_motion.loop import LoopFigures, hysteresis_loop, loop_figures
from rvjax.lost_motion.outputs import LostMotion, geometric, shaft_tilt
from rvjax.lost_motion.terms import LostMotionTerms

__all__ = ["LoopFigures", "LostMotion", "LostMotionTerms", "geometric", "hysteresis_loop", "loop_figures", "shaft_tilt"]
